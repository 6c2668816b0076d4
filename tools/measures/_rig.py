"""A bench that scores vectors, over the bus or in the compiled batch, and remembers what it has scored."""

from __future__ import annotations

import itertools
import os
import shutil
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from tools.measures._ledger import Ledger, code_hash
from tunefree_hil.bench import Bench, is_heavy
from tunefree_hil.bench.batch import Batch
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.grade.score import FINISHED
from tunefree_hil.jobs.identity import compute_identity
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.running.episode_results import evaluation_from_episodes
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession
from tunefree_hil.jobs.running.trial_driver import TrialDriver
from tunefree_hil.jobs.tune.evaluators import BatchEvaluator, VectorCandidate
from tunefree_hil.tune.trial import Evaluation

_numbers = itertools.count()  # one worker opens several benches, one after the other


class Rig:
    """Use it in a `with`. The processes start with the first vector that the ledger does not know.

    Its episodes are written to `<ledger's folder>/rig-<pid>-<model>`, which is taken away when all went well: what the
    nodes said stays there when the bench failed. over_bus=False drives in the compiled batch, a hundred times as fast:
    the same numbers (`parity` compares all of them, _tuning.py the winners' grades).
    """

    def __init__(
        self, bench: Bench, model: str, scenarios: Sequence[str], ledger: Ledger, *, over_bus: bool = True
    ) -> None:
        self.bench = bench
        self.model = model
        self.scenarios = [bench.scenarios[name] for name in scenarios]
        self.ledger = ledger
        self.depends = {**standing(bench, model, self.scenarios), "what": "evaluation"}
        self.folder = ledger.folder / f"rig-{os.getpid()}-{Path(model).name}"
        self.over_bus = over_bus
        self._batch: BatchEvaluator | None = None
        self._track: TrialDriver | None = None
        self._open = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._open.close()
        if kind is None or issubclass(kind, KeyboardInterrupt):
            shutil.rmtree(self.folder, ignore_errors=True)

    def evaluate(self, values: Mapping[str, float]) -> dict[str, Any]:
        """{score, scenarios: grades by name, seconds} of a complete vector over all scenarios."""
        depends = {**self.depends, "values": dict(values)}
        known = self.ledger.find(depends)
        if known is None and not self.over_bus:
            depends["over"] = "batch"
            known = self.ledger.find(depends)
        if known is not None:
            return known
        started = time.monotonic()
        evaluation = self._over_bus(values) if self.over_bus else self._in_batch(values)
        result = {
            "score": evaluation.score,
            "scenarios": evaluation.scenarios,
            "seconds": time.monotonic() - started,
        }
        return self.ledger.keep(depends, result)

    def _over_bus(self, values: Mapping[str, float]) -> Evaluation:
        track = self._track or self._start()
        return evaluation_from_episodes(track.drive_scenarios(values, self.scenarios, 0, keep=False))

    def _in_batch(self, values: Mapping[str, float]) -> Evaluation:
        if self._batch is None:
            batch = self._open.enter_context(Batch(self.bench, self.model))
            self._batch = BatchEvaluator(batch, self.bench, self.scenarios, batch_size=1)
        (evaluation,) = self._batch.evaluate([VectorCandidate(0, values)])
        return evaluation

    def _start(self) -> TrialDriver:
        run = RunFolder(self.folder, {})
        session = BenchSession(
            Path(self.bench.file),
            run.node_output(),
            BenchLaunch(
                session=f"measure-{os.getpid()}-{next(_numbers)}",
                model=self.model,
                jitted_ecu=is_heavy(self.bench, self.model),
            ),
        )
        self._track = TrialDriver(self._open.enter_context(session), self.bench, run)
        self._open.callback(self._track.close)
        return self._track


def standing(bench: Bench, model: str, scenarios: Sequence[ScenarioSpec]) -> dict[str, str]:
    """All that a score depends on, but the vector: files and code."""
    identity = compute_identity(bench, model, scenarios)["identity"]
    return {"identity": identity, "model": Path(model).name, "code": code_hash()}


def failed(scenarios: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Scenarios not driven to their end."""
    return [name for name, drive in scenarios.items() if drive["outcome"] != FINISHED]


def replans(scenarios: Mapping[str, Mapping[str, Any]]) -> int:
    """Re-plans over all scenarios."""
    return sum(int(drive["replans"]) for drive in scenarios.values())
