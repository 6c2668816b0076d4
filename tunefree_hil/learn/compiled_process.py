"""A process in which kernels are compiled, for fits that need millions of plant steps.

    with Worker() as worker:
        result = yield from worker.call("tunefree_hil.learn.physics.fit", "fit", windows, start)

What kernels are is settled at import (TUNEFREE_JIT), so the fit runs in a process of its own. It ends with this one.
"""

from __future__ import annotations

import importlib
import inspect
import threading
from collections.abc import Generator
from types import TracebackType
from typing import Any, NamedTuple, Self

from tunefree_hil.base.errors import PeerGone, TunefreeError
from tunefree_hil.base.pipes import Helper, Loss, send, serve

COMPILED = {"TUNEFREE_JIT": "1"}  # the environment of the process beside ours
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # a tall thin J'J gains nothing by more
LOSS = Loss("fit", "the process that fits", "fit_lost", "run the same command again")


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
    """The process; started at the first call, and at the next one after it was lost."""

    def __init__(self) -> None:
        self._helper: Helper | None = None
        self._ended = False
        self._starting = threading.Lock()

    def call(self, module: str, function: str, *args: Any) -> Generator[Any, None, Any]:
        """Run a module-level function there; its arguments and all that it gives must be picklable.

        Where the function is a generator, what it yields is yielded here as it comes. Returns its result. Raises the
        function's own TunefreeError, and PeerGone with the end of what the process printed where it is lost.
        """
        try:
            helper = self._started()
            helper.say((module, function, args))
            while (answer := Answer(*helper.hear())).kind == "progress":
                yield answer.value
        except BaseException:  # lost, interrupted, or nobody will hear the rest: it cannot be asked again
            self.close()
            raise
        if answer.kind == "error":
            raise answer.value
        return answer.value

    def result(self, module: str, function: str, *args: Any) -> Any:
        """The same, for who does not want to hear of the progress."""
        calling = self.call(module, function, *args)
        while True:
            try:
                next(calling)
            except StopIteration as end:
                return end.value

    def close(self) -> None:
        """End the process; the next call starts another."""
        helper, self._helper = self._helper, None
        if helper is not None:
            helper.close()

    def end(self) -> None:
        """End the process for good: a call that another thread is about to make starts none any more, which nobody
        would end.
        """
        with self._starting:
            self._ended = True
        self.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end()

    def _started(self) -> Helper:
        with self._starting:
            if self._ended:
                raise PeerGone(LOSS.peer, f"{LOSS.subject} was ended", code=LOSS.code, hint=LOSS.hint)
            if self._helper is None:
                self._helper = Helper("tunefree_hil.learn.compiled_process", {**ONE_THREAD, **COMPILED}, LOSS)
            return self._helper


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
