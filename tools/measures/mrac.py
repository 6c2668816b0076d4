"""What MRAC is worth on the serpentine, over what a steering actuator may be (paper, Fig. 9 and Table IV)."""

from __future__ import annotations

import shutil
import sys
import tempfile
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace as with_values

from tools.measures._drift import BIAS, drift
from tools.measures._in_process import InProcess
from tools.measures._ledger import FIGURES, FOLDER, Ledger
from tools.measures._rig import Rig, standing
from tools.measures._side_by_side import side_by_side
from tools.measures._summary import machine, rounded, summary
from tunefree_hil.bench import Bench, load, model_of, parameters_of
from tunefree_hil.config.dump import to_toml
from tunefree_hil.tune.baselines import make_first_trial
from tunefree_hil.tune.space import resolve_space
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.study import Evaluation, open_study
from tunefree_hil.tune.trial_loop import run_trials

VALUE = "lateral peak with tuned MRAC / without, serpentine, median of 12 steering actuators"
NAME, SCENARIO = "mrac", "serpentine"
DEAD_TIMES_S = (0.05, 0.10, 0.15)
LAGS_S = (0.077, 0.12, 0.17, 0.25)
PAPER = {"lateral_peak": -0.6016, "lateral_rms_harsh": -0.3892}  # Table IV: changes on the road
METRICS = {"lateral_peak": "lateral_err_peak", "lateral_rms_harsh": "lateral_err_std_harsh"}
OFF, FIXED, TUNED = "off", "p0", "tuned"
STRONGEST = {"mrac.t_ref_s": 0.09, "mrac.p": 0.1}  # the upper edge of p's box: what may drift soonest


class Cell(NamedTuple):
    """One actuator: a job of a worker."""

    bench: str
    folder: str
    dead_time_s: float
    lag_s: float
    trials: int
    seed: int


class Straight(NamedTuple):
    """One long drive: a job of a worker."""

    bench: str
    folder: str
    label: str
    searched: dict[str, float]
    bias: dict[str, float]
    minutes: int
    dead_zone: float | None = None  # None: the bench file's


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
    """Of each actuator: MRAC off; tuned (T_ref and p, a study of `trials`); p = 0 at the same T_ref.

    The cells are driven in one process, which gives the frames of the bus (detail: same_frames_over_the_bus). Then
    `minutes` straight on with noise and offsets, with the parameters tuned for the data sheet's actuator and with the
    largest p of the box, that one without offsets and the tuned one without the dead zone too; 0 leaves this out. Goes
    on when called again.
    """
    before, own = machine(), str(Path(folder) / NAME)
    grid = [(dead, lag) for dead in DEAD_TIMES_S for lag in LAGS_S]
    grid.sort(key=lambda one: one != (0.10, 0.077))  # the data sheet's first
    jobs = [Cell(bench, own, dead, lag, trials, seed) for dead, lag in grid[:cells]]
    found = []
    for cell in side_by_side(work_cell, jobs, workers):
        found.append(cell)
        print(_words(cell), file=sys.stderr, flush=True)
    found.sort(key=lambda cell: (cell["dead_time_s"], cell["lag_s"]))
    sheet = next(cell for cell in found if (cell["dead_time_s"], cell["lag_s"]) == (0.10, 0.077))
    tuned = sheet["parameters"]
    ratios = [_ratio(cell, TUNED, "lateral_peak") for cell in found]
    detail = {
        "machine": before,
        "trials": trials,
        "change": {name: _changes(found, name) for name in METRICS},
        "data_sheet_actuator": {name: _ratio(sheet, TUNED, name) - 1.0 for name in METRICS},
        "paper": PAPER,
        "better_than_off": sum(ratio < 1.0 for ratio in ratios),
        "better_than_p0": sum(cell[TUNED]["lateral_peak"] < cell[FIXED]["lateral_peak"] for cell in found),
        "same_frames_over_the_bus": _over_the_bus(bench, own, sheet),
        "cells": found,
        "figure": _figure(found, ratios, figures),
    }
    if minutes:
        straights = [
            Straight(bench, own, TUNED, tuned, BIAS, minutes),
            Straight(bench, own, "strongest", STRONGEST, BIAS, minutes),
            Straight(bench, own, "strongest, no offsets", STRONGEST, {}, minutes),
            Straight(bench, own, "tuned, no dead zone", tuned, BIAS, minutes, 0.0),
        ]
        detail["straight"] = dict(side_by_side(work_straight, straights, workers))
    return summary(ratios, "of the peak without MRAC", rounded(detail))


def work_cell(job: Cell) -> dict[str, Any]:
    """One actuator: {dead_time_s, lag_s, parameters, off, p0, tuned: {lateral_peak, lateral_rms_harsh, score, ...}}."""
    bench = load(job.bench)
    ledger = Ledger(Path(job.folder), f"cell-{job.dead_time_s}-{job.lag_s}")
    with tempfile.TemporaryDirectory() as folder:
        model = write_model(bench, Path(folder) / "model", job.dead_time_s, job.lag_s)
        depends = {
            **standing(bench, str(model), [bench.scenarios[SCENARIO]]),
            "what": "mrac cell",
            "trials": job.trials,
            "seed": job.seed,
        }
        known = ledger.find(depends)
        if known is not None:
            return known
        drive = _Drives(bench, model)
        searched = _tune(job, bench, drive, depends["identity"], Path(folder))
        # The shipped law with p = 0 is refused (no Lyapunov function); gamma = 0 stops the same product of the two.
        vectors = {
            OFF: parameters_of(bench, {"mrac.enable": 0.0}),
            FIXED: parameters_of(bench, searched | {"mrac.gamma": 0.0}),
            TUNED: parameters_of(bench, searched),
        }
        grades = {label: drive(values) for label, values in vectors.items()}
    line = {"dead_time_s": job.dead_time_s, "lag_s": job.lag_s, "parameters": searched}
    return ledger.keep(depends, line | grades)


class _Drives:
    """Serpentines in one process on one model, as plain data."""

    def __init__(self, bench: Bench, model: Path) -> None:
        self.scenario = bench.scenarios[SCENARIO]
        self.bench = InProcess(bench, str(model))

    def __call__(self, values: Mapping[str, float]) -> dict[str, Any]:
        graded, hashed = self.bench.grade(self.scenario, values)
        metrics = {name: graded.metrics[metric] for name, metric in METRICS.items()}
        metrics["lateral_peak"] = 0.5 * (metrics["lateral_peak"] or 0.0)  # m: the metric is a share of 0.5 m
        return {**metrics, "score": graded.score, "outcome": graded.outcome, "replans": graded.replans, "hash": hashed}


def _tune(job: Cell, bench: Bench, drive: _Drives, identity: str, folder: Path) -> dict[str, float]:
    space = resolve_space("mrac", [])
    settings = StudySettings(space, job.seed, bench.spec.tune.sampler, identity, make_first_trial(space))

    def evaluate(searched: dict[str, float]) -> Evaluation:
        found = drive(parameters_of(bench, searched))
        return Evaluation(found["score"], {SCENARIO: found})

    with open_study(folder / "study.db", settings) as study:
        return min(run_trials(study, job.trials, evaluate), key=lambda trial: trial.score).parameters


def work_straight(job: Straight) -> tuple[str, dict[str, Any]]:
    """(label, how Kx and Kr moved)."""
    bench = load(job.bench)
    if job.dead_zone is not None:
        controller = with_values(bench.spec.controller, mrac_dead_zone=job.dead_zone)
        bench = replace(bench, spec=with_values(bench.spec, controller=controller))
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


def write_model(
    bench: Bench, folder: Path, dead_time_s: float, lag_s: float, bias: Mapping[str, float] | None = None
) -> Path:
    """A copy of the bench's model with another steering actuator, and with offset sensors where `bias` is given."""
    shutil.copytree(model_of(bench, bench.spec.model).folder, folder)
    path = folder / "model.toml"
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    data["actuators"]["steer"] |= {"dead_time_s": dead_time_s, "lag_s": lag_s}
    if bias:
        data["bias"] = {**data.get("bias", {}), **bias}
    path.write_text(to_toml(data), encoding="utf-8")
    return folder


def _over_the_bus(bench_file: str, folder: str, cell: Mapping[str, Any]) -> bool:
    """Whether the tuned serpentine of a cell has the same frames over the bus."""
    bench = load(bench_file)
    with tempfile.TemporaryDirectory() as text:
        model = write_model(bench, Path(text) / "model", cell["dead_time_s"], cell["lag_s"])
        with Rig(bench, str(model), [SCENARIO], Ledger(Path(folder), "bus")) as rig:
            found = rig.evaluate(parameters_of(bench, cell["parameters"]))
    return found["scenarios"][SCENARIO]["frame_hash"] == cell[TUNED]["hash"]


def _ratio(cell: Mapping[str, Any], label: str, name: str) -> float:
    return cell[label][name] / cell[OFF][name]


def _changes(cells: list[dict[str, Any]], name: str) -> dict[str, list[float]]:
    """[least, median, most] of tuned / off - 1 and of p0 / off - 1."""
    found = {label: np.array([_ratio(cell, label, name) - 1.0 for cell in cells]) for label in (FIXED, TUNED)}
    return {
        label: [float(part) for part in (values.min(), np.median(values), values.max())]
        for label, values in found.items()
    }


def _words(cell: Mapping[str, Any]) -> str:
    peaks = ", ".join(f"{label} {cell[label]['lateral_peak']:.3f} m" for label in (OFF, FIXED, TUNED))
    at = ", ".join(f"{name} {value:.3g}" for name, value in cell["parameters"].items())
    return f"dead time {cell['dead_time_s']} s, lag {cell['lag_s']} s: lateral peak {peaks}; {at}"


def _figure(cells: list[dict[str, Any]], ratios: list[float], figures: str) -> str:
    from tools.measures.figures.cells import CellAxis, draw_cells
    from tunefree_hil.figures.style import save

    panels = {}
    for label, title in ((FIXED, "reference model only (p = 0)"), (TUNED, "tuned T_ref and p")):
        values = np.full((len(DEAD_TIMES_S), len(LAGS_S)), np.nan)
        for cell in cells:
            place = DEAD_TIMES_S.index(cell["dead_time_s"]), LAGS_S.index(cell["lag_s"])
            values[place] = _ratio(cell, label, "lateral_peak")
        panels[title] = values
    better = sum(ratio < 1.0 for ratio in ratios)
    title = f"Lateral peak of the serpentine, of that without MRAC: tuned is lower in {better} of {len(ratios)}"
    title += f" (median {float(np.median(ratios)):.2f})"
    sides = CellAxis("steer dead time (s)", DEAD_TIMES_S), CellAxis("steer lag (s)", LAGS_S)
    return str(save(draw_cells(panels, *sides, title), Path(figures) / "mrac.png"))
