"""The compiled batch of a bench: many drives at once, bit for bit those of the bus (design D1).

    with Batch(bench, model, extra_effects=("steer_gain",)) as batch:
        driven = batch.drive([Job(values, scenario), Job(values, scenario, effects={"steer_gain": {"gain_frac": 1.1}})])

The drives run in a process of its own that is started with TUNEFREE_JIT=batch (what kernels are is settled at import)
and ends with this one. It compiles once for each structure: vehicle folder, kind of plant, names of effects, controller
parts, delays. Parameters, scenarios, seeds and values of effects are data.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from types import TracebackType
from typing import Any, BinaryIO, Self, cast

from tunefree_hil.base.errors import PeerGone
from tunefree_hil.base.pipes import receive, send
from tunefree_hil.bench.batch_worker import packed
from tunefree_hil.bench.fleet import Driven
from tunefree_hil.bench.load import Bench
from tunefree_hil.bench.simulator import Job

__all__ = ["Batch", "Driven", "Job"]

COMPILED = {"TUNEFREE_JIT": "batch"}  # the environment of the process beside ours
LAST_LINES = 12  # of what the process printed, where it dies
END_S = 5.0


class Batch:
    """Drives of a bench and a model (default: the bench's own). Raises InputError for what cannot be built.

    extra_effects: names of effects behind those of model and bench file, neutral unless a Job gives them values.
    threads: None is one a core. The first `drive` waits for the compiler, or reads what it left in the user's cache.
    """

    def __init__(
        self, bench: Bench, model: str = "", *, extra_effects: Sequence[str] = (), threads: int | None = None
    ) -> None:
        self._words = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tunefree_hil.bench.batch_worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._words,
            env={**os.environ, **COMPILED},
        )
        try:
            self._ask((packed(bench), model or bench.spec.model, tuple(extra_effects), threads))
        except BaseException:
            self.close()
            raise

    def drive(self, jobs: Sequence[Job], *, columns: bool = False) -> list[Driven]:
        """The drives, in the order of `jobs`; columns=True keeps their recordings.

        Raises InputError for a job that cannot be built, PeerGone where the process is lost.
        """
        return self._ask((list(jobs), columns)) if jobs else []

    def close(self) -> None:
        """End the process."""
        process = self._process
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

    def _ask(self, message: Any) -> Any:
        requests, answers = cast(BinaryIO, self._process.stdin), cast(BinaryIO, self._process.stdout)
        try:
            send(requests, message)
            answer = receive(answers)
        except (EOFError, BrokenPipeError) as error:
            raise self._lost() from error
        except KeyboardInterrupt:
            self._process.kill()  # half an answer may be under way: nobody can ask it again
            raise
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _lost(self) -> PeerGone:
        self._process.wait(END_S)
        self._words.seek(0)
        lines = self._words.read().decode(errors="replace").strip().splitlines()[-LAST_LINES:]
        said = "\n    ".join(["", *lines]) if lines else ""
        return PeerGone(
            "batch",
            f"the batch's process has ended ({self._process.returncode}){said}",
            code="batch_lost",
            hint="the same command with the bus drives the same drives: leave out --backend batch",
        )
