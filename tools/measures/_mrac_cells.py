"""One steering actuator of `mrac`: with both laws, constant and drifting, MRAC off, with p = 0 and with p tuned."""

from __future__ import annotations

import shutil
import tempfile
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tools.measures import _steering_drift
from tools.measures._envelope import with_controller
from tools.measures._ledger import Ledger, meaning
from tools.measures._rig import Rig, standing
from tunefree_hil.bench import Bench, load, model_of, parameters_of
from tunefree_hil.bench.batch import Batch, Job
from tunefree_hil.config.dump import to_toml
from tunefree_hil.jobs.identity import resolved_toml
from tunefree_hil.jobs.tune.evaluators import grade_of
from tunefree_hil.tune.baselines import make_first_trial
from tunefree_hil.tune.space import Space, resolve_space
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.study import Evaluation, open_study
from tunefree_hil.tune.trial_loop import run_trials

SCENARIO = "serpentine"
METRICS = {"lateral_peak": "lateral_err_peak", "lateral_rms_harsh": "lateral_err_std_harsh"}
PEAK_SCALE_M = 0.5  # the metric is a share of it
PLAIN, ROBUST = "mrac", "mrac_robust"  # laws: parts of control/inner
LAWS = (PLAIN, ROBUST)
# What is added to the actuator until the end of the last bend, about as much as it has on the data sheet.
OVER_S = 15.6
DRIFTS: dict[str, dict[str, float]] = {
    "constant": {},
    "dead time": {"delay_s": 0.05, "over_s": OVER_S},
    "lag": {"lag_s": 0.08, "over_s": OVER_S},
    "gain": {"gain_change": -0.2, "over_s": OVER_S},
}
EFFECT = f"{_steering_drift.__file__}:EFFECT"
OFF, FIXED, ALONE, TUNED = "off", "p0", "p0_tuned", "tuned"
T_REF = "mrac.t_ref_s"
Row = dict[str, Any]  # {parameters, t_ref_s, and by OFF, FIXED, ALONE, TUNED: {lateral_peak, lateral_rms_harsh, ...}}


class Cell(NamedTuple):
    """One actuator with one law: a job of a worker. drifts: names of DRIFTS."""

    bench: str
    folder: str
    dead_time_s: float
    lag_s: float
    trials: int
    seed: int
    law: str = PLAIN
    drifts: tuple[str, ...] = tuple(DRIFTS)


def work_cell(job: Cell) -> dict[str, Any]:
    """{dead_time_s, lag_s, law, drifts: {name: Row}}."""
    bench = with_controller(load(job.bench), inner=job.law)
    ledger = Ledger(Path(job.folder), f"cell-{job.law}-{job.dead_time_s}-{job.lag_s}")
    with tempfile.TemporaryDirectory() as folder:
        model = write_model(bench, Path(folder) / "model", job.dead_time_s, job.lag_s)
        depends = {
            **standing(bench, str(model), [bench.scenarios[SCENARIO]]),
            "what": "mrac cell",
            "trials": job.trials,
            "seed": job.seed,
            "drifts": {name: DRIFTS[name] for name in job.drifts},
            "effect": meaning(Path(_steering_drift.__file__).read_text(encoding="utf-8")),
        }
        known = ledger.find(depends)
        if known is not None:
            return known
        with Batch(bench, str(model), extra_effects=(EFFECT,), threads=1) as batch:
            found = {name: _compare(job, CellDrives(bench, batch, name), depends["identity"]) for name in job.drifts}
    cell = {"dead_time_s": job.dead_time_s, "lag_s": job.lag_s, "law": job.law, "drifts": found}
    return ledger.keep(depends, cell)


class CellDrives:
    """Drives of SCENARIO with one drift, as plain data."""

    def __init__(self, bench: Bench, batch: Batch, drift: str) -> None:
        self.bench = bench
        self.scenario = bench.scenarios[SCENARIO]
        self._batch = batch
        self._effects = {EFFECT: DRIFTS[drift]} if DRIFTS[drift] else {}

    def __call__(self, chosen: Mapping[str, float]) -> dict[str, Any]:
        """Drive the bench's parameters with `chosen` in their place."""
        job = Job(parameters_of(self.bench, chosen), self.scenario, effects=self._effects)
        (driven,) = self._batch.drive([job])
        return as_row(grade_of(driven, self.scenario).as_data())


def as_row(grade: Mapping[str, Any]) -> dict[str, Any]:
    """What a drive is compared by; the peak in m."""
    metrics = {name: grade["metrics"][metric] for name, metric in METRICS.items()}
    metrics["lateral_peak"] = PEAK_SCALE_M * (metrics["lateral_peak"] or 0.0)
    return {**metrics, **{key: grade[key] for key in ("score", "outcome", "replans")}}


def _compare(job: Cell, drive: CellDrives, identity: str) -> Row:
    """Two searches: T_ref and p, and T_ref alone with p = 0, which is as free in what is not adaptation.

    The shipped law with p = 0 is refused (no Lyapunov function); gamma = 0 stops the same product of the two.
    """
    space = resolve_space("mrac", [])
    no_adaptation = {"mrac.gamma": 0.0}
    searched = _tune(job, space, drive, identity, {})
    alone = _tune(job, Space(tuple(axis for axis in space.axes if axis.name == T_REF)), drive, identity, no_adaptation)
    return {
        "parameters": searched,
        "t_ref_s": alone[T_REF],
        OFF: drive({"mrac.enable": 0.0}),
        FIXED: drive(searched | no_adaptation),
        ALONE: drive(alone | no_adaptation),
        TUNED: drive(searched),
    }


def _tune(job: Cell, space: Space, drive: CellDrives, identity: str, held: Mapping[str, float]) -> dict[str, float]:
    settings = StudySettings(space, job.seed, drive.bench.spec.tune.sampler, identity, make_first_trial(space))

    def evaluate(searched: dict[str, float]) -> Evaluation:
        found = drive(searched | dict(held))
        return Evaluation(found["score"], {SCENARIO: found})

    with tempfile.TemporaryDirectory() as folder, open_study(Path(folder) / "study.db", settings) as study:
        return min(run_trials(study, job.trials, evaluate), key=lambda trial: trial.score).parameters


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


def is_same_over_the_bus(bench_file: str, folder: str, cell: Mapping[str, Any]) -> bool:
    """Whether the tuned drive of a constant cell has the same score and errors over the bus, to the bit."""
    bench, row = with_controller(load(bench_file), inner=cell["law"]), cell["drifts"]["constant"]
    with tempfile.TemporaryDirectory() as place:
        model = write_model(bench, Path(place) / "model", cell["dead_time_s"], cell["lag_s"])
        file = Path(place) / "bench.toml"  # the nodes read the law in it
        file.write_text(resolved_toml(bench), encoding="utf-8")
        bench = load(file)
        with Rig(bench, str(model), [SCENARIO], Ledger(Path(folder), "bus")) as rig:
            found = rig.evaluate(parameters_of(bench, row["parameters"]))
    return as_row(found["scenarios"][SCENARIO]) == row[TUNED]
