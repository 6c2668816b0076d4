"""Guided collection from an empty map to a full one, over the bus in lockstep."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable
from hashlib import sha256
from pathlib import Path
from typing import Any

from tools.measures._ledger import FOLDER, Ledger, code_hash, meaning
from tools.measures._summary import machine, rounded
from tunefree_hil.base.events import Event
from tunefree_hil.config.load import load_bench, load_model, load_vehicle
from tunefree_hil.jobs.collect.collect import collect
from tunefree_hil.jobs.options.records import CollectOptions

VALUE = "simulated minutes of driving until a collection over the bus has filled every cell, mkz_bywire"
FIRST = "bench_configs/mkz_steer.toml"  # its vehicle is the value
PACKAGE = Path(__file__).resolve().parents[2] / "tunefree_hil"


def measure(
    benches: str = "", quota_s: float = 10.0, area_m: float = 400.0, seed: int = 1, folder: str = FOLDER
) -> dict[str, Any]:
    """One collection a bench file, driven on its verify model; the first is the value. Cut off, it goes on.

    benches: with commas between; '' for one of each vehicle.

    Time beyond the envelope is speed, lateral acceleration, steering rate and area together, noise of the sensors
    included. wall_s is of all calls that drove, with the compilation of the vehicle where it was not kept.
    """
    before, ledger = machine(), Ledger(Path(folder) / "collect")
    rows = {
        name: _collected(Path(name), quota_s, area_m, seed, ledger)
        for name in (benches.split(",") if benches else one_of_each())
    }
    first = next(iter(rows.values()))
    detail = {"machine": before, "quota_s": quota_s, "area_m": area_m, "benches": rows}
    value = first["simulated_min"] if not first["missing"] else float("nan")
    return {"value": value, "unit": "min", "n": 1, "low": None, "high": None, "detail": rounded(detail)}


def one_of_each() -> list[str]:
    """FIRST, and the first bench file of every other vehicle."""
    found = {load_bench(FIRST).vehicle: FIRST}
    for path in sorted((PACKAGE.parent / "bench_configs").glob("*.toml")):
        found.setdefault(load_bench(path).vehicle, str(path))
    return list(found.values())


def _collected(bench: Path, quota_s: float, area_m: float, seed: int, ledger: Ledger) -> dict[str, Any]:
    depends = {"what": bench.stem, "quota_s": quota_s, "area_m": area_m, "seed": seed, **_standing(bench)}
    known = ledger.find(depends)
    if known is not None:
        return known
    out = ledger.folder / f"{bench.stem}-{depends['files'][:8]}-{quota_s:g}-{area_m:g}-{seed}"
    asked = CollectOptions(bench, bus="tfhub", out=out, quota_s=quota_s, area_m=area_m, seed=seed)
    started, wall = time.monotonic(), out / "wall.txt"
    try:
        last = _watched(collect(asked))
    finally:
        earlier_s = float(wall.read_text()) if wall.is_file() else 0.0
        if out.is_dir():
            wall.write_text(f"{earlier_s + time.monotonic() - started:.1f}")
    cover = json.loads((out / "coverage.json").read_text())
    row = {
        "simulated_min": last["simulated_s"] / 60.0,
        "cells_full": last["cells_full"],
        "cells_wanted": last["cells_wanted"],
        "missing": last["missing"],
        "beyond_envelope_s": last["beyond_envelope_s"],
        "drives": len(cover["drives"]),
        "wall_s": float(wall.read_text()),
        "logs": last["logs"],
    }
    return ledger.keep(depends, row)


def _watched(events: Iterable[Event]) -> dict[str, Any]:
    """Says how far it is; the data of the last event."""
    last: dict[str, Any] = {}
    for event in events:
        if event.kind in ("progress", "warning"):
            print(event.message, flush=True)
        last = event.data
    return last


def _standing(bench: Path) -> dict[str, str]:
    """What the drives depend on beside the options: vehicle, model, code."""
    spec = load_bench(bench)
    vehicle, model = load_vehicle(spec.vehicle, bench), load_model(spec.verify_model or spec.model, bench)
    planner = "".join(meaning(path.read_text()) for path in sorted((PACKAGE / "collect").glob("*.py")))
    files = sha256((vehicle.hash + model.hash + planner + code_hash()).encode()).hexdigest()
    return {"files": files}
