"""A process in which kernels are compiled, for fits that need millions of plant steps.

    with Worker() as worker:
        result = yield from worker.call("tunefree_hil.learn.physics", "fit", windows, start)

What kernels are is settled at import (TUNEFREE_JIT), so the fit runs in a process of its own. It ends with this one.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import os
import subprocess
import sys
import tempfile
from collections.abc import Generator
from types import TracebackType
from typing import Any, BinaryIO, NamedTuple, Self, cast

from tunefree_hil.base.errors import PeerGone, TunefreeError
from tunefree_hil.base.pipes import receive, send, serve

COMPILED = {"TUNEFREE_JIT": "1"}  # the environment of the process beside ours
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # a tall thin J'J gains nothing by more
LAST_LINES = 12  # of what the process printed, where it dies
END_S = 5.0


class Asked(NamedTuple):
    """A call: the module's function, and what it is called with."""

    module: str
    function: str
    args: tuple[Any, ...]


class Answer(NamedTuple):
    """kind: 'progress' (what a generator yields), 'result' (the last), 'error' (of base/errors.py)."""

    kind: str
    value: Any


class Worker:
    """The process; started at the first call."""

    def __init__(self) -> None:
        self._words: Any = None
        self._process: subprocess.Popen[bytes] | None = None

    def call(self, module: str, function: str, *args: Any) -> Generator[Any, None, Any]:
        """Run a module-level function there; its arguments and all that it gives must be picklable.

        Where the function is a generator, what it yields is yielded here as it comes. Returns its result. Raises the
        function's own TunefreeError, and PeerGone with the end of what the process printed where it is lost.
        """
        self._say(Asked(module, function, args))
        while True:
            answer = self._hear()
            if answer.kind == "progress":
                try:
                    yield answer.value
                except GeneratorExit:
                    self.close()  # nobody will hear the rest
                    raise
            elif answer.kind == "result":
                return answer.value
            else:
                raise answer.value

    def result(self, module: str, function: str, *args: Any) -> Any:
        """The same, for who does not want to hear of the progress."""
        calling = self.call(module, function, *args)
        while True:
            try:
                next(calling)
            except StopIteration as end:
                return end.value

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is None:
            return
        if process.poll() is None:
            process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(END_S)
        for pipe in (process.stdin, process.stdout, self._words):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _started(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            self._words = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tunefree_hil.learn.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._words,
                env={**os.environ, **ONE_THREAD, **COMPILED},
            )
        return self._process

    def _say(self, asked: Asked) -> None:
        try:
            send(cast(BinaryIO, self._started().stdin), tuple(asked))
        except BrokenPipeError as error:
            raise self._lost() from error

    def _hear(self) -> Answer:
        try:
            return Answer(*receive(cast(BinaryIO, self._started().stdout)))
        except EOFError as error:
            raise self._lost() from error
        except BaseException:
            self.close()  # half an answer may be under way: nobody can ask it again
            raise

    def _lost(self) -> PeerGone:
        process = self._started()
        process.wait(END_S)
        self._words.seek(0)
        lines = self._words.read().decode(errors="replace").strip().splitlines()[-LAST_LINES:]
        said = "\n    ".join(["", *lines]) if lines else ""
        message = f"the process that fits has ended ({process.returncode}){said}"
        self.close()
        return PeerGone("fit", message, code="fit_lost", hint="run the same command again")


def answers_to(asked: Asked) -> Generator[Answer, None, None]:
    """Make the call: progress as it comes, then the one last answer."""
    try:
        made = getattr(importlib.import_module(asked.module), asked.function)(*asked.args)
        while inspect.isgenerator(made):
            try:
                yield Answer("progress", next(made))
            except StopIteration as end:
                made = end.value
        yield Answer("result", made)
    except TunefreeError as error:
        yield Answer("error", error)


def main() -> None:
    """Serve until the input ends."""
    todo, answers = serve()
    while True:
        for answer in answers_to(Asked(*todo.get())):
            send(answers, tuple(answer))


if __name__ == "__main__":
    main()
