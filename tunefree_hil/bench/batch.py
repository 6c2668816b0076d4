"""The compiled batch of a bench: many drives at once, bit for bit those of the bus (docs/reference/design.md).

    with Batch(bench, model, extra_effects=("steer_gain",)) as batch:
        driven = batch.drive([Job(values, scenario), Job(values, scenario, effects={"steer_gain": {"gain_frac": 1.1}})])

The drives run in a process of its own that is started with TUNEFREE_JIT=batch (what kernels are is settled at import)
and ends with this one. It compiles once for each structure: vehicle folder, kind of plant, names of effects, controller
parts, delays. Parameters, scenarios, seeds and values of effects are data.
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

COMPILED = {"TUNEFREE_JIT": "batch"}  # the environment of the process beside ours
LOSS = Loss(
    "batch",
    "the batch's process",
    "batch_lost",
    "the same command with the bus drives the same drives: leave out --backend batch",
)


class Batch:
    """Drives of a bench and a model (default: the bench's own). Raises InputError for what cannot be built.

    extra_effects: names of effects behind those of model and bench file, neutral unless a Job gives them values.
    threads: None is one a core. The first `drive` waits for the compiler, or reads what it left in the user's cache.
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

        Raises InputError for a job that cannot be built, PeerGone where the process is lost.
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
