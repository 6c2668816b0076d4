"""From an unknown vehicle to verified gains: how long each stage takes, and what it gains on the vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tools.measures._ledger import FOLDER, code_hash
from tools.measures._summary import machine, rounded
from tools.measures.collect import one_of_each
from tunefree_hil.base.events import Event
from tunefree_hil.config.load import load_bench
from tunefree_hil.jobs.commission.commission import commission
from tunefree_hil.jobs.commission.plan import NAMES
from tunefree_hil.jobs.options.records import CommissionOptions
from tunefree_hil.jobs.run_folder import read_json

VALUE = "wall minutes of all stages of `commission`, the slower vehicle"


def measure(
    benches: str = "", set_name: str = "", trials: int = 0, quota_s: float = 10.0, minutes: float = 0.0,
    seed: int = 1, folder: str = FOLDER,
) -> dict[str, Any]:  # fmt: skip
    """One commission a bench file ('': one of each vehicle), each in a folder of this code; cut off, it goes on.

    gain: the winner's score on the vehicle over scenarios that no search saw, as a share of the best manual one.
    """
    before = machine()
    names = benches.split(",") if benches else one_of_each()
    rows = {}
    for name in names:
        asked = CommissionOptions(
            load_bench(name).vehicle, Path(name), Path(folder) / "commission" / code_hash()[:12] / Path(name).stem,
            set_name or None, trials or None, quota_s=quota_s, minutes=minutes or None, seed=seed,
        )  # fmt: skip
        rows[name] = _commissioned(asked)
    slowest = max(row["minutes"] for row in rows.values())
    detail = {"machine": before, "benches": rows}
    return {"value": slowest, "unit": "min", "n": len(rows), "low": None, "high": None, "detail": rounded(detail)}


def _commissioned(asked: CommissionOptions) -> dict[str, Any]:
    assert asked.out is not None
    last = Event("result", "", {})
    for event in commission(asked):
        if event.kind == "result":
            last = event
        elif event.kind == "note":
            print(event.message, flush=True)
    record = read_json(asked.out / "commission.json")
    stages = {name: record["spent_s"].get(name, 0.0) / 60.0 for name in NAMES}
    scores = record["stages"].get("verify", {}).get("result", {}).get("scores", {})
    manual = {name: score for name, score in scores.items() if name != "tuned"}
    return {
        "minutes": sum(stages.values()),
        "stages_min": stages,
        "sentence": last.data.get("sentence", ""),
        "stopped": record.get("stopped", {}).get("reason", ""),
        "scores": scores,
        "gain": scores["tuned"] / min(manual.values()) if manual else None,
        "report": last.data.get("report", ""),
    }
