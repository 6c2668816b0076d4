"""The compiled batch of a bench: many drives at once, bit for bit those of the bus (design D1).

    with Batch(bench, model, extra_effects=("steer_gain",)) as batch:
        driven = batch.drive([Job(values, scenario), Job(values, scenario, effects={"steer_gain": {"gain_frac": 1.1}})])

The drives run in a process of its own that is started with TUNEFREE_JIT=1 (kernels are compiled at import or never) and
ends with this one. It compiles once for each structure: vehicle folder, kind of plant, names of effects, controller
parts, delays. Parameters, scenarios, seeds and values of effects are data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import NamedTuple, Self

from tunefree_hil.bench.load import Bench
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.score import ScenarioGrade


class Job(NamedTuple):
    """One drive. values: a complete vector by name; seed: None is the scenario's own noise seed.

    effects: values for the batch's `extra_effects`, by name; what is left out is neutral.
    """

    values: Mapping[str, float]
    scenario: ScenarioSpec
    seed: int | None = None
    effects: Mapping[str, Mapping[str, float]] = {}  # noqa: RUF012 - never mutated


class Driven(NamedTuple):
    """How a drive went. ticks: rows driven; error: '' when it was driven to its end, else the error's name.

    grade: None for an error of the bench (see `jobs/harvest.py` DRIVEN). recording: only where asked for.
    """

    grade: ScenarioGrade
    ticks: int
    error: str
    recording: Recording | None = None
    hash: str | None = None


class Batch:
    """Drives of a bench and a model (default: the bench's own). Raises InputError for what cannot be built.

    extra_effects: names of effects behind those of model and bench file, neutral unless a Job gives them values.
    threads: None is one a core.
    """

    def __init__(
        self, bench: Bench, model: str = "", *, extra_effects: Sequence[str] = (), threads: int | None = None
    ) -> None: ...

    def drive(self, jobs: Sequence[Job], *, columns: bool = False) -> list[Driven]:
        """The drives, in the order of `jobs`; columns=True keeps their recordings."""
        ...

    def close(self) -> None:
        """End the process."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
