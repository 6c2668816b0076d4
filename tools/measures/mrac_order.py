"""What the order of MRAC's reference model brings, over what a steering actuator may be (serpentine, as `mrac`).

Each order is driven on the same grid of T_ref and p, with the clamp of a study; the controller knows the data sheet's
actuator only. The readings are the best scores of an order over those of order 1.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tools.measures._envelope import with_controller
from tools.measures._mrac_cells import SCENARIO, as_row, write_model
from tools.measures._side_by_side import side_by_side
from tools.measures._summary import machine, rounded, summary
from tools.measures.mrac import DEAD_TIMES_S, LAGS_S
from tunefree_hil.bench import load, parameters_of
from tunefree_hil.bench.batch import Batch, Job
from tunefree_hil.jobs.tune.evaluators import grade_of

VALUE = "best score of a reference model of order 3 / of order 1, serpentine, median of 12 steering actuators"
ORDERS = (1, 2, 3, 4)
T_REFS_S = (0.03, 0.045, 0.06, 0.09, 0.12, 0.18, 0.26)
RATES = (1e-4, 1e-3, 1e-2, 1e-1)


class OrderCell(NamedTuple):
    """One actuator and order: a job of a worker."""

    bench: str
    dead_time_s: float
    lag_s: float
    order: int


def measure(cells: int = 12, workers: int = 2, bench: str = "bench_configs/mkz_steer.toml") -> dict[str, Any]:
    """cells: the first so many actuators of the grid of dead time and lag."""
    before = machine()
    actuators = [(dead_s, lag_s) for dead_s in DEAD_TIMES_S for lag_s in LAGS_S][:cells]
    jobs = [OrderCell(bench, dead_s, lag_s, order) for dead_s, lag_s in actuators for order in ORDERS]
    rows = []
    for row in side_by_side(drive_cell, jobs, workers):
        rows.append(row)
        print(f"mrac_order {len(rows)} of {len(jobs)}", file=sys.stderr, flush=True)
    found = {(row["dead_time_s"], row["lag_s"], row["order"]): row for row in rows}
    ratios = {
        order: [found[*one, order]["best"]["score"] / found[*one, 1]["best"]["score"] for one in actuators]
        for order in ORDERS
    }
    detail = {
        "machine": before,
        "grid": len(T_REFS_S) * len(RATES),
        "orders": {order: describe_order([found[*one, order] for one in actuators], ratios[order]) for order in ORDERS},
        "cells": rows,
    }
    return summary(ratios[3], "of the best score of order 1", rounded(detail))


def drive_cell(job: OrderCell) -> dict[str, Any]:
    """Off, the shipped values with MRAC on, and every point of the grid."""
    bench = with_controller(load(job.bench), mrac_order=job.order)
    scenario, points = bench.scenarios[SCENARIO], [(t_ref_s, p) for t_ref_s in T_REFS_S for p in RATES]
    shipped = {"mrac.enable": 1.0, "mrac.t_ref_s": 0.09, "mrac.p": 1e-4, "mrac.clamp_s": 0.08}
    sets = [{"mrac.enable": 0.0}, shipped, *({"mrac.t_ref_s": t_ref_s, "mrac.p": p} for t_ref_s, p in points)]
    with tempfile.TemporaryDirectory() as folder:
        model = write_model(bench, Path(folder) / "model", job.dead_time_s, job.lag_s)
        with Batch(bench, str(model), threads=1) as batch:
            driven = batch.drive([Job(parameters_of(bench, values), scenario) for values in sets])
    off, on, *grid = [as_row(grade_of(one, scenario).as_data()) for one in driven]
    best = min(range(len(grid)), key=lambda i: grid[i]["score"])
    return {
        **job._asdict(),
        "off": off,
        "shipped": on,
        "best": {**grid[best], "t_ref_s": points[best][0], "p": points[best][1]},
        "better_than_off": sum(row["score"] < off["score"] for row in grid),
    }


def describe_order(rows: list[dict[str, Any]], ratios: list[float]) -> dict[str, Any]:
    """Medians over the actuators: peaks in m, and how many points of the grid are better than MRAC off."""
    return {
        "best_over_order_1": [float(np.median(ratios)), min(ratios), max(ratios)],
        "shipped_over_off": float(np.median([row["shipped"]["score"] / row["off"]["score"] for row in rows])),
        "peak_m": {
            key: float(np.median([row[key]["lateral_peak"] for row in rows])) for key in ("off", "shipped", "best")
        },
        "better_than_off": float(np.median([row["better_than_off"] for row in rows])),
    }
