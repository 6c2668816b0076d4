"""A bench that scores vectors, over the bus or in one process, and remembers what it has scored."""

from __future__ import annotations

import itertools
import os
import shutil
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from tools.measures._in_process import InProcess
from tools.measures._ledger import Ledger, code_hash
from tunefree_hil.bench import Bench, is_heavy
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.grade.score import FINISHED, combine
from tunefree_hil.jobs.harvest import evaluation_of
from tunefree_hil.jobs.identity import identity_of
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.session import Session
from tunefree_hil.jobs.track import Track

_numbers = itertools.count()  # one worker opens several benches, one after the other


class Rig:
    """Use it in a `with`. The processes start with the first vector that the ledger does not know.

    Its episodes are written to `<ledger's folder>/rig-<pid>-<model>`, which is taken away when all went well: what the
    nodes said stays there when the bench failed. over_bus=False steps the same nodes in one process: the same frames
    (_tuning.py compares the winners' hashes), three times as fast.
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
        self._one: InProcess | None = None
        self._track: Track | None = None
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
            depends["over"] = "one process"
            known = self.ledger.find(depends)
        if known is not None:
            return known
        if not self.over_bus:
            return self.ledger.keep(depends, self._in_process(values))
        track = self._track or self._start()
        started = time.monotonic()
        evaluation = evaluation_of(track.drive_all(values, self.scenarios, 0, keep=False))
        result = {
            "score": evaluation.score,
            "scenarios": evaluation.scenarios,
            "seconds": time.monotonic() - started,
        }
        return self.ledger.keep(depends, result)

    def _in_process(self, values: Mapping[str, float]) -> dict[str, Any]:
        started = time.monotonic()
        one = self._one = self._one or InProcess(self.bench, self.model)
        found = {scenario.name: one.grade(scenario, values) for scenario in self.scenarios}
        scenarios = {name: {**grade._asdict(), "frame_hash": hashed} for name, (grade, hashed) in found.items()}
        score = combine([grade for grade, _ in found.values()])
        return {"score": score, "scenarios": scenarios, "seconds": time.monotonic() - started}

    def _start(self) -> Track:
        run = RunFolder(self.folder, {})
        session = Session(
            Path(self.bench.file),
            run.words(),
            session=f"measure-{os.getpid()}-{next(_numbers)}",
            model=self.model,
            jitted_ecu=is_heavy(self.bench, self.model),
        )
        self._track = Track(self._open.enter_context(session), self.bench, run)
        self._open.callback(self._track.close)
        return self._track


def standing(bench: Bench, model: str, scenarios: Sequence[ScenarioSpec]) -> dict[str, str]:
    """All that a score depends on, but the vector: files and code."""
    identity = identity_of(bench, model, scenarios)["identity"]
    return {"identity": identity, "model": Path(model).name, "code": code_hash()}


def failed(scenarios: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Scenarios not driven to their end."""
    return [name for name, drive in scenarios.items() if drive["outcome"] != FINISHED]


def replans(scenarios: Mapping[str, Mapping[str, Any]]) -> int:
    """Re-plans over all scenarios."""
    return sum(int(drive["replans"]) for drive in scenarios.values())
