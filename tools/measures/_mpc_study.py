"""The searches of `tools/measure mpc`: one bench with two controllers, each with its own parameters."""

from __future__ import annotations

import tempfile
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tools.measures._ledger import Ledger
from tools.measures._rig import Rig, standing
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.config.dump import to_toml
from tunefree_hil.control.parameters import SETS, BoxChoice
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors, select_first_vector
from tunefree_hil.tune.baselines import make_first_trial
from tunefree_hil.tune.space import Space, resolve_space
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.study import Evaluation, open_study
from tunefree_hil.tune.trial_loop import run_trials

MPC, LQR = "mpc", "lqr_preview"
CONTROLLERS = (MPC, LQR)
LQR_PARTS = {"lateral": "lqr_preview", "longitudinal": "pid_preview"}
LQR_PARAMETERS = [name for name in SETS["complete"] if not name.startswith("mrac.")]


class MpcStudy(NamedTuple):
    """What a call of the measure searches. files: the bench file by controller."""

    files: dict[str, str]
    folder: str  # of the ledger
    scenarios: tuple[str, ...]
    verify_scenarios: tuple[str, ...]
    trials: int


class Search(NamedTuple):
    """One study: a job of a worker."""

    study: MpcStudy
    controller: str
    seed: int


def write_benches(bench: Path, folder: Path) -> dict[str, str]:
    """The bench file of each controller: the given one, and its copy with LQR and PID and the same scenarios."""
    data = tomllib.loads(bench.read_text(encoding="utf-8"))
    data["controller"] = {**data["controller"], **LQR_PARTS}
    data["controller"].pop("parameters", None)
    data["tune"] = {**data["tune"], "parameters": [{"name": name} for name in LQR_PARAMETERS]}
    places = folder / "scenarios"  # a name is looked for beside the bench file first
    places.mkdir(parents=True, exist_ok=True)
    for name, scenario in load(bench).scenarios.items():
        (places / f"{name}.toml").write_bytes(Path(scenario.path).read_bytes())
    path = folder / f"{bench.stem}_{LQR}.toml"
    part = path.with_suffix(".part")
    part.write_text(to_toml(data), encoding="utf-8")
    part.replace(path)
    return {MPC: str(bench), LQR: str(path)}


def space_of(bench: Bench) -> Space:
    """The space of a bench file, the parameters of the table with their wider box."""
    return resolve_space(bench.spec.tune.set, bench.spec.tune.parameters, box=BoxChoice.DEFAULT, file=bench.file)


def search(job: Search) -> dict[str, Any]:
    """Run or go on with one study: {controller, seed, score, parameters, trials}."""
    study, bench = job.study, load(job.study.files[job.controller])
    ledger = Ledger(Path(study.folder), f"{job.controller}-{job.seed}")
    identity = standing(bench, bench.spec.model, [bench.scenarios[name] for name in study.scenarios])["identity"]
    space = space_of(bench)
    first = make_first_trial(space, select_first_vector(compute_baseline_vectors(bench)))
    settings = StudySettings(
        space=space, seed=job.seed, sampler=bench.spec.tune.sampler, bench_hash=identity, first=first
    )
    with (
        tempfile.TemporaryDirectory() as folder,
        Rig(bench, bench.spec.model, study.scenarios, ledger) as rig,
        open_study(Path(folder) / "study.db", settings) as database,
    ):

        def evaluate(values: Mapping[str, float]) -> Evaluation:
            scored = rig.evaluate(parameters_of(bench, values))
            return Evaluation(scored["score"], scored["scenarios"])

        for _ in run_trials(database, study.trials, evaluate):
            pass
        best = min(database.trials(), key=lambda trial: trial.score)
        return {
            "controller": job.controller,
            "seed": job.seed,
            "score": best.score,
            "parameters": best.parameters,
            "trials": len(database.trials()),
        }


def judge(study: MpcStudy, controller: str, chosen: Mapping[str, float]) -> dict[str, Any]:
    """{search, verify}: a vector on the model of the search and on the verify model. chosen: beside the manual set."""
    bench, ledger = load(study.files[controller]), Ledger(Path(study.folder), f"{controller}-judged")
    values = parameters_of(bench, {**select_first_vector(compute_baseline_vectors(bench)), **chosen})
    judged = {}
    for name, model, scenarios in (
        ("search", bench.spec.model, study.scenarios),
        ("verify", bench.spec.verify_model, study.verify_scenarios),
    ):
        with Rig(bench, model, scenarios, ledger) as rig:
            judged[name] = rig.evaluate(values)
    return judged
