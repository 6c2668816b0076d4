"""What MRAC is worth on the serpentine, over what a steering actuator may be (paper, Fig. 9 and Table IV).

Two laws, the paper's and the robust one, with actuators that stay as they are and with ones whose dead time, lag or
gain drifts within the drive. The controller knows the data sheet's actuator. Whether adaptation itself adds anything is
judged against p = 0 with a reference model that was searched as long.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tools.measures._drift import BIAS, drift
from tools.measures._envelope import with_controller
from tools.measures._ledger import FIGURES, FOLDER, Ledger
from tools.measures._mrac_cells import (
    ALONE,
    DRIFTS,
    FIXED,
    LAWS,
    METRICS,
    OFF,
    PLAIN,
    ROBUST,
    TUNED,
    Cell,
    is_same_over_the_bus,
    work_cell,
    write_model,
)
from tools.measures._rig import standing
from tools.measures._side_by_side import side_by_side
from tools.measures._summary import machine, rounded, summary
from tunefree_hil.bench import load, parameters_of
from tunefree_hil.grade.requirements.verdict import CRITERIA

VALUE = "lateral peak with tuned MRAC / without, serpentine, median of 12 steering actuators"
NAME = "mrac"
DEAD_TIMES_S = (0.05, 0.10, 0.15)
LAGS_S = (0.077, 0.12, 0.17, 0.25)
DATA_SHEET = (0.10, 0.077)
CONSTANT = "constant"
PAPER = {"lateral_peak": -0.6016, "lateral_rms_harsh": -0.3892}  # Table IV: changes on the road
STRONGEST = {"mrac.t_ref_s": 0.09, "mrac.p": 0.1}  # the upper edge of p's box: what may drift soonest


class Straight(NamedTuple):
    """One long drive: a job of a worker."""

    bench: str
    folder: str
    label: str
    searched: dict[str, float]
    bias: dict[str, float]
    minutes: int
    dead_zone: float | None = None  # None: the bench file's
    law: str = PLAIN


def measure(
    trials: int = 30,
    cells: int = 12,
    minutes: int = 30,
    workers: int = 2,
    seed: int = 1,
    bench: str = "bench_configs/mkz_steer.toml",
    folder: str = FOLDER,
    figures: str = FIGURES,
) -> dict[str, Any]:
    """Of each actuator, law and drift: MRAC off; tuned (T_ref and p, a study of `trials`); p = 0 at the same T_ref, and
    at one that a study of its own found.

    The cells are driven in the batch (detail: same_over_the_bus). Then `minutes` straight on with noise and offsets,
    with the parameters tuned for the data sheet's actuator and with the largest p of the box, the paper's law also
    without offsets and without the dead zone; 0 leaves this out. Goes on when called again.
    """
    before, own = machine(), str(Path(folder) / NAME)
    grid = [(dead, lag) for dead in DEAD_TIMES_S for lag in LAGS_S]
    grid.sort(key=lambda one: one != DATA_SHEET)  # the data sheet's first
    jobs = [Cell(bench, own, dead, lag, trials, seed, law) for dead, lag in grid[:cells] for law in LAWS]
    found = []
    for cell in side_by_side(work_cell, jobs, workers):
        found.append(cell)
        print(f"{NAME} {len(found)} of {len(jobs)}: {describe_cell(cell)}", file=sys.stderr, flush=True)
    found.sort(key=lambda cell: (LAWS.index(cell["law"]), cell["dead_time_s"], cell["lag_s"]))
    sheet = {cell["law"]: cell for cell in found if (cell["dead_time_s"], cell["lag_s"]) == DATA_SHEET}
    constant = rows_of(found, PLAIN, CONSTANT)
    adaptation = compare_adaptation(found)
    detail = {
        "machine": before,
        "trials": trials,
        "change": {name: _changes(constant, name) for name in METRICS},
        "data_sheet_actuator": {
            law: {name: _ratio(cell["drifts"][CONSTANT], TUNED, OFF, name) - 1.0 for name in METRICS}
            for law, cell in sheet.items()
        },
        "paper": PAPER,
        "adaptation": adaptation,
        "verdict": adaptation_verdict(adaptation),
        "same_over_the_bus": {law: is_same_over_the_bus(bench, own, cell) for law, cell in sheet.items()},
        "cells": found,
        "figures": [_draw_cells(found, figures), _draw_adaptation(found, figures)],
    }
    if minutes:
        tuned = {law: cell["drifts"][CONSTANT]["parameters"] for law, cell in sheet.items()}
        detail["straight"] = dict(side_by_side(work_straight, _straights(bench, own, tuned, minutes), workers))
    return summary([_ratio(row, TUNED, OFF) for row in constant], "of the peak without MRAC", rounded(detail))


def _straights(bench: str, own: str, tuned: Mapping[str, dict[str, float]], minutes: int) -> list[Straight]:
    return [
        Straight(bench, own, TUNED, tuned[PLAIN], BIAS, minutes),
        Straight(bench, own, "strongest", STRONGEST, BIAS, minutes),
        Straight(bench, own, "strongest, no offsets", STRONGEST, {}, minutes),
        Straight(bench, own, "tuned, no dead zone", tuned[PLAIN], BIAS, minutes, 0.0),
        Straight(bench, own, "robust, tuned", tuned[ROBUST], BIAS, minutes, law=ROBUST),
        Straight(bench, own, "robust, strongest", STRONGEST, BIAS, minutes, law=ROBUST),
    ]


def work_straight(job: Straight) -> tuple[str, dict[str, Any]]:
    """(label, how Kx and Kr moved)."""
    bench = with_controller(load(job.bench), inner=job.law)
    if job.dead_zone is not None:
        bench = with_controller(bench, mrac_dead_zone=job.dead_zone)
    ledger = Ledger(Path(job.folder), f"straight-{job.label.replace(', ', '-').replace(' ', '-')}")
    with tempfile.TemporaryDirectory() as folder:
        model = write_model(bench, Path(folder) / "model", 0.10, 0.077, job.bias)
        depends = {**standing(bench, str(model), []), "what": "straight", "searched": job.searched,
                   "minutes": job.minutes}  # fmt: skip
        known = ledger.find(depends)
        if known is None:
            moved = drift(bench, model, parameters_of(bench, job.searched), job.minutes)
            known = ledger.keep(depends, {"parameters": job.searched, "bias": job.bias, **moved})
    return job.label, known


def rows_of(cells: Sequence[Mapping[str, Any]], law: str, drifting: str) -> list[Mapping[str, Any]]:
    """One row for each actuator."""
    return [cell["drifts"][drifting] for cell in cells if cell["law"] == law]


def compare_adaptation(cells: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """By law, by drift: lateral peaks and scores over the actuators as [least, median, most] of a ratio.

    adds: whether p lowers the median peak below that of p = 0 with its own T_ref by more than what a gain must be.
    """
    return {law: {name: _adaptation(rows_of(cells, law, name)) for name in DRIFTS} for law in LAWS}


def _adaptation(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    peaks = {
        f"{one}_of_{other}": [_ratio(row, one, other) for row in rows]
        for one, other in ((TUNED, OFF), (ALONE, OFF), (FIXED, OFF), (TUNED, FIXED), (TUNED, ALONE))
    }
    against = peaks[f"{TUNED}_of_{ALONE}"]
    return {
        **{name: _range(values) for name, values in peaks.items()},
        f"score_{TUNED}_of_{ALONE}": _range([_ratio(row, TUNED, ALONE, "score") for row in rows]),
        "lower_peak": sum(ratio < 1.0 for ratio in against),
        "n": len(rows),
        "failed": {label: sum(row[label]["outcome"] != "finished" for row in rows) for label in (OFF, ALONE, TUNED)},
        "adds": bool(np.median(against) < 1.0 - CRITERIA.gain_margin),
    }


def adaptation_verdict(adaptation: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> str:
    """A sentence for each law: where adaptation lowers the median peak, and where it adds nothing."""
    sentences = []
    for law, drifts in adaptation.items():
        adds = [name for name, one in drifts.items() if one["adds"]]
        nothing = [name for name, one in drifts.items() if not one["adds"]]
        parts = [f"lowers the peak with: {', '.join(adds)}"] if adds else []
        parts += [f"adds nothing over p = 0 with: {', '.join(nothing)}"] if nothing else []
        sentences.append(f"{law}: adaptation {'; '.join(parts)}")
    return ". ".join(sentences)


def _ratio(row: Mapping[str, Any], one: str, other: str, name: str = "lateral_peak") -> float:
    return row[one][name] / row[other][name]


def _range(values: Sequence[float]) -> list[float]:
    """[least, median, most]."""
    return [float(part) for part in np.quantile(values, [0.0, 0.5, 1.0])]


def _changes(rows: Sequence[Mapping[str, Any]], name: str) -> dict[str, list[float]]:
    """[least, median, most] of p0 / off - 1 and of tuned / off - 1; a drive that ended early may have no harsh part."""
    known = [row for row in rows if all(row[label][name] for label in (OFF, FIXED, TUNED))]
    return {label: _range([_ratio(row, label, OFF, name) - 1.0 for row in known]) for label in (FIXED, TUNED) if known}


def describe_cell(cell: Mapping[str, Any]) -> str:
    """A line for a person."""
    peaks = [
        f"{name} " + ", ".join(f"{label} {row[label]['lateral_peak']:.3f} m" for label in (OFF, ALONE, TUNED))
        for name, row in cell["drifts"].items()
    ]
    return f"{cell['law']}, dead time {cell['dead_time_s']} s, lag {cell['lag_s']} s: {'; '.join(peaks)}"


def _draw_cells(cells: Sequence[Mapping[str, Any]], figures: str) -> str:
    from tools.measures.figures.cells import CellAxis, draw_cells
    from tunefree_hil.figures.style import save

    panels = {}
    for label, title in ((ALONE, "reference model only (p = 0)"), (TUNED, "tuned T_ref and p")):
        values = np.full((len(DEAD_TIMES_S), len(LAGS_S)), np.nan)
        for cell in (cell for cell in cells if cell["law"] == PLAIN):
            place = DEAD_TIMES_S.index(cell["dead_time_s"]), LAGS_S.index(cell["lag_s"])
            values[place] = _ratio(cell["drifts"][CONSTANT], label, OFF)
        panels[title] = values
    ratios = [_ratio(row, TUNED, OFF) for row in rows_of(cells, PLAIN, CONSTANT)]
    better = sum(ratio < 1.0 for ratio in ratios)
    title = f"Lateral peak of the serpentine, of that without MRAC: tuned is lower in {better} of {len(ratios)}"
    title += f" (median {float(np.median(ratios)):.2f})"
    sides = CellAxis("steer dead time (s)", DEAD_TIMES_S), CellAxis("steer lag (s)", LAGS_S)
    return str(save(draw_cells(panels, *sides, title), Path(figures) / "mrac.png"))


def _draw_adaptation(cells: Sequence[Mapping[str, Any]], figures: str) -> str:
    from tools.measures.figures.adaptation import draw_adaptation
    from tunefree_hil.figures.style import save

    rows = {
        f"{'robust' if law == ROBUST else 'plain'}, {name}": [
            _ratio(row, TUNED, ALONE) for row in rows_of(cells, law, name)
        ]
        for name in DRIFTS
        for law in LAWS
    }
    return str(save(draw_adaptation(rows), Path(figures) / "mrac_adaptation.png"))
