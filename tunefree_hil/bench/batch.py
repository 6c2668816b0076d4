"""The compiled batch of a bench: many drives at once, bit for bit those of the bus.

    with Batch(bench, model, extra_effects=("steer_gain",)) as batch:
        driven = batch.drive([Job(values, scenario), Job(values, scenario, effects={"steer_gain": {"gain_frac": 1.1}})])

The drives run in a separate process with TUNEFREE_JIT=batch (read at import), which ends with this one.
It compiles once for each structure: vehicle folder, kind of plant, names of effects, controller parts, delays.
Parameters, scenarios, seeds and values of effects are data.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

from tunefree_hil.base.pipes import Helper, Loss
from tunefree_hil.bench.batch_worker import packed
from tunefree_hil.bench.load import Bench
from tunefree_hil.bench.parallel import Driven
from tunefree_hil.bench.simulator import Job

__all__ = ["Batch", "Driven", "Job"]

COMPILED = {"TUNEFREE_JIT": "batch"}  # environment of the batch process
LOSS = Loss(
    "batch",
    "the batch's process",
    "batch_lost",
    "the same command with the bus drives the same drives: leave out --backend batch",
)


class Batch:
    """Drives of a bench and a model (default: the bench's own). Raises InputError for a bench that cannot be built.

    extra_effects: names of effects after those of model and bench file, neutral unless a Job gives them values.
    threads: None is one a core. The first `drive` waits for the compiler, or loads the kernels from the user's cache.
    """

    def __init__(
        self, bench: Bench, model: str = "", *, extra_effects: Sequence[str] = (), threads: int | None = None
    ) -> None:
        self._helper = Helper("tunefree_hil.bench.batch_worker", COMPILED, LOSS)
        try:
            self._ask((packed(bench), model or bench.spec.model, tuple(extra_effects), threads))
        except BaseException:
            self.close()
            raise

    def drive(self, jobs: Sequence[Job], *, columns: bool = False) -> list[Driven]:
        """The drives, in the order of `jobs`; columns=True keeps their recordings.

        Raises InputError for a job that cannot be built, PeerGone when the process has ended.
        """
        return self._ask((list(jobs), columns)) if jobs else []

    def close(self) -> None:
        """End the process."""
        self._helper.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _ask(self, message: Any) -> Any:
        answer = self._helper.ask(message)
        if isinstance(answer, Exception):
            raise answer
        return answer
