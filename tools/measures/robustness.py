"""Roads of a thousand fresh ones on which the winner of `make tune` fails, in many cars, manual sets beside it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from tools.measures._ledger import FOLDER, code_hash
from tools.measures._summary import machine, rounded
from tunefree_hil.base.events import Event
from tunefree_hil.config.load import load_bench
from tunefree_hil.jobs.drive import new_session_name
from tunefree_hil.jobs.options.records import TuneOptions
from tunefree_hil.jobs.robustness.options import DEFAULT_CARS, DEFAULT_ROADS, RobustnessOptions
from tunefree_hil.jobs.robustness.sweep import sweep_roads
from tunefree_hil.jobs.run_folder import open_run
from tunefree_hil.jobs.tune.tune import tune

VALUE = "percent of 1,000 fresh roads on which the winner of `make tune` loses stability or misses a requirement"


def measure(
    run: str = "", bench: str = "bench_configs/mkz_envelope.toml", trials: int = 0, roads: str = DEFAULT_ROADS,
    public: int = 0, cars: int = DEFAULT_CARS, seed: int = 1, model: str = "", scheduler: str = "",
    folder: str = FOLDER,
) -> dict[str, Any]:  # fmt: skip
    """The sweep of a finished tune ('': of one that is made here with the bench file); cut off, it goes on.

    The value has the exact 95 % interval. detail: every set of gains, families, causes, and drives/s where it drove.
    public: 1 for the 229 public roads too. model: '' for the verify model of the bench.
    """
    before = machine()
    tuned = Path(run) if run else _tuned_run(Path(bench), trials, Path(folder) / "robustness" / code_hash()[:12])
    options = RobustnessOptions(tuned, roads, bool(public), seed, cars, model or None, scheduler=scheduler)
    rates: list[float] = []
    result = _follow(sweep_roads(options), rates)
    winner = result["sets"]["tuned"]["roads"]
    detail = {"machine": before, "run": str(tuned), "out": result["out"], "sentence": result["sentence"]}
    detail |= {key: result[key] for key in ("model", "roads", "cars", "drives", "undrivable_roads", "every_set_fails")}
    detail |= {"drives_per_s": float(np.median(rates)) if rates else None}
    detail |= {"sets": result["sets"], "worst": result["worst"]}
    share = 100.0 * winner["failed"] / max(winner["n"], 1)
    low, high = 100.0 * winner["low"], 100.0 * winner["high"]
    return {"value": share, "unit": "%", "n": winner["n"], "low": low, "high": high, "detail": rounded(detail)}


def _tuned_run(bench: Path, trials: int, root: Path) -> Path:
    """A finished tune of the bench file in `root`; one that was cut off goes on."""
    wanted = trials or load_bench(bench).tune.trials
    for path in sorted(root.glob("*/run.json"), reverse=True):
        made = open_run(path.parent)
        asked = made.record.get("options", {}).get("trials")
        if made.record.get("complete") and made.record.get("bench") == str(bench) and asked == wanted:
            return path.parent
    options = TuneOptions(bench, trials or None, verify=False, out=root, session=new_session_name())
    return Path(_follow(tune(options), [])["run"])


def _follow(events: Iterable[Event], rates: list[float]) -> dict[str, Any]:
    """Show the events, keep the rates of driving, and return the data of the result."""
    data: dict[str, Any] = {}
    for event in events:
        if event.kind == "result":
            data = event.data
        else:
            print(event.message, flush=True)
        if "drives_per_s" in event.data:
            rates.append(event.data["drives_per_s"])
    return data
