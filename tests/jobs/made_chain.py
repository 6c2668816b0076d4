"""A commission whose stages are stand-ins."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.commission import commission as module
from tunefree_hil.jobs.commission import plan as plans
from tunefree_hil.jobs.commission.commission import STAGES, commission
from tunefree_hil.jobs.commission.plan import FOLDERS, NAMES, CommissionPlan
from tunefree_hil.jobs.options.records import CommissionOptions


def judged(mean_m: float | None, n: int = 100, kind: str = "hybrid", ground: str = "level") -> dict[str, Any]:
    """What `learn` says of a plant that is so far off after 10 s; n: of 100 starts that the physics came through."""
    rows = {name: {"position_m": {"n": count, "mean": mean, "p95": mean}} for name, count, mean in (
        (kind, n, mean_m), ("physics", 100, 3.0),
    )}  # fmt: skip
    return {"kind": kind, "free_run": {name: {ground: {"starts": 100, "10": row}} for name, row in rows.items()}}


RESULTS: dict[str, dict[str, Any]] = {
    "collect": {"cells_full": 9, "cells_wanted": 10, "sentence": "9 of 10"},
    "learn": {"sentence": "learned", **judged(2.0)},
    "tune": {"sentence": "found", "outside": {"share": 0.02}},
    "verify": {"sentence": "0.3 -> 0.2", "holds": True, "scores": {"tuned": 0.2, "as_shipped": 0.3}},
}


class Chain:
    """Stages that write what they were called for.

    results: what each comes to; dies, refuses: the one that is cut off, or that raises.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.called: list[str] = []
        self.results = {name: dict(RESULTS.get(name, {"sentence": name})) for name in NAMES}
        self.dies = self.refuses = ""
        stages = tuple(one._replace(run=self._stage(one.name)) for one in STAGES)
        monkeypatch.setattr(module, "STAGES", stages)

    def _stage(self, name: str) -> Any:
        def run(plan: CommissionPlan) -> Iterator[Event]:
            self.called.append(name)
            yield Event("progress", "at work", {"done": 1, "total": 2})
            yield Event("warning", f"{name} is doubtful")
            if self.dies == name:
                raise KeyboardInterrupt
            if self.refuses == name:
                raise InputError("too little straight driving", key="LOG")
            (plan.folder / FOLDERS[name][0]).mkdir(exist_ok=True) if name != "verify" else None
            yield Event("result", "", self.results[name])

        return run

    def run(self, asked: CommissionOptions) -> dict[str, Any]:
        """The data of the result."""
        return list(commission(asked))[-1].data


@pytest.fixture
def chain(monkeypatch: pytest.MonkeyPatch) -> Chain:
    monkeypatch.setattr(plans, "_require_stages", lambda *_: None)  # it reads a bench over and over
    return Chain(monkeypatch)


@pytest.fixture
def asked(tmp_path: Path) -> CommissionOptions:
    return CommissionOptions("mkz_bywire", Path("bench_configs/mkz_steer.toml"), tmp_path / "c")


def record(asked: CommissionOptions) -> dict[str, Any]:
    assert asked.out is not None
    return json.loads((asked.out / "commission.json").read_text())
