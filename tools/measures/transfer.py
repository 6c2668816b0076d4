"""Do gains that are good on the learned plant hold on the vehicle? Ranks of random sets, and winners of both searches.

Everything is graded by the compiled batch, which gives the bus's numbers: on each plant that was learned from the logs
of `collect`, and on the vehicle itself (the verify model), which shares no physics with any of them. Both with the map
that was learned from the same logs, as `commission` has it.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace as with_values
from scipy.stats import spearmanr

from tools.measures._ledger import FIGURES, FOLDER, Ledger
from tools.measures._rig import Rig, failed
from tools.measures._summary import RESAMPLES, machine, rounded
from tools.measures._unseen import ended
from tools.measures.collect import one_of_each
from tools.measures.figures.transfer import TransferGrades, draw_transfer
from tools.measures.freerun import learned, learned_in
from tools.measures.map import logs_in
from tools.measures.parity import parameter_sets
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bench.batch import Batch
from tunefree_hil.figures.style import save
from tunefree_hil.jobs.learn.map import map_logs
from tunefree_hil.jobs.learn.options import MapOptions
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors
from tunefree_hil.jobs.tune.robustness import drive_slower_car
from tunefree_hil.tune.baselines import make_first_trial
from tunefree_hil.tune.robust_winner import rank_trials
from tunefree_hil.tune.space import resolve_space
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.study import Evaluation, open_study
from tunefree_hil.tune.trial import ScoredStudy, Trial
from tunefree_hil.tune.trial_loop import run_trials

VALUE = "Spearman correlation of grades, hybrid plant and vehicle, of random sets that finish on both; lower vehicle"
NAME, SET = "transfer", "complete"
BEST = 50
DRAWN = "drawn_"


class Wanted(NamedTuple):
    """What `measure` was asked for."""

    sets: int
    trials: int
    kinds: tuple[str, ...]
    searched: tuple[str, ...]
    trainings: int
    minutes: float
    folder: Path


class Graded(NamedTuple):
    """Scores of the sets in their order, and whether all drives of each were driven to their end."""

    score: np.ndarray
    finished: np.ndarray


def measure(
    seeds: int = 3,
    sets: int = 200,
    trials: int = 100,
    kinds: str = "hybrid,lstm,paper",
    benches: str = "",
    searched: str = "physics,hybrid",
    trainings: int = 0,
    minutes: float = 0.0,
    folder: str = FOLDER,
    figures: str = FIGURES,
) -> dict[str, Any]:
    """seeds: of trainings, sets and searches. sets: random ones beside the manual. kinds: learned, beside the physics.

    searched: the plants on which gains are tuned, beside the vehicle itself. trainings: 0 a training a seed; else so
    many in all, taken in turn by the seeds. n counts seeds; low and high are those of the lower vehicle over its seeds.
    All is kept in `folder`: it goes on.
    """
    before = machine()
    asked = Wanted(sets, trials, tuple(kinds.split(",")), tuple(searched.split(",")), trainings, minutes, Path(folder))
    rows = {
        name: [_one(load(name), seed, asked) for seed in range(1, seeds + 1)]
        for name in (benches.split(",") if benches else one_of_each())
    }
    values = {name: [row["kinds"]["hybrid"]["finished"]["rho"] for row in some] for name, some in rows.items()}
    pictured = {Path(name).stem: _pictured(some) for name, some in rows.items()}
    save(draw_transfer(pictured), Path(figures) / f"{NAME}.png")
    lower = min(values, key=lambda name: float(np.median(values[name])))
    for row in (row for some in rows.values() for row in some):
        del row["grades"]
    detail = {"machine": before, "benches": rows, "medians": {name: float(np.median(v)) for name, v in values.items()}}
    found = values[lower]
    return {
        "value": float(np.median(found)), "unit": "Spearman", "n": len(found), "low": min(found), "high": max(found),
        "detail": rounded(detail),
    }  # fmt: skip


def _one(bench: Bench, seed: int, asked: Wanted) -> dict[str, Any]:
    """One vehicle and one seed: ranks on every plant, and winners graded on the vehicle."""
    place = asked.folder / NAME / Path(bench.file).stem
    ledger = Ledger(place / "grades")
    logs = logs_in("", str(asked.folder), bench.vehicle.name)
    training = (seed - 1) % asked.trainings + 1 if asked.trainings else seed
    models = learned(bench, logs, learned_in(str(asked.folder), bench, logs), asked.kinds, training, asked.minutes, 0.0)
    bench = _with_map(bench, logs, place / f"map-{training}")
    vectors = parameter_sets(bench, asked.sets + len(compute_baseline_vectors(bench)), seed)
    drawn = {name: values for name, values in vectors.items() if name.startswith(DRAWN)}
    vehicle = bench.spec.verify_model
    truth = _graded(bench, vehicle, drawn, ledger)
    found, grades = {}, {"": truth}
    for name, model in models.items():
        grades[name] = _graded(bench, model.folder, drawn, ledger)
        found[name] = correlations(grades[name], truth, seed)
        words = found[name]["finished"]
        _say(f"{place.name}, seed {seed}, {name}: {words['rho']:.3f} of {words['n']} sets that finish on both")
    winners = {name: _tuned(bench, models[name].folder, asked.trials, seed, ledger) for name in asked.searched}
    winners["vehicle"] = _tuned(bench, vehicle, asked.trials, seed, ledger)
    scores = _scores(bench, vehicle, winners | compute_baseline_vectors(bench), ledger)
    manual = min(compute_baseline_vectors(bench), key=lambda name: scores[name])
    return {
        "seed": seed,
        "training": training,
        "kinds": found,
        "grades": grades,
        "on_vehicle": scores,
        "tuned_of_tuned_on_vehicle": {name: scores[name] / scores["vehicle"] for name in asked.searched},
        "tuned_of_manual": {name: scores[name] / scores[manual] for name in winners},
        "manual": manual,
    }


def _pictured(rows: Sequence[Mapping[str, Any]]) -> dict[str, TransferGrades]:
    """All seeds' sets together, by kind; rho: the seeds' median."""
    found = {}
    for kind in rows[0]["kinds"]:
        rho = float(np.median([row["kinds"][kind]["finished"]["rho"] for row in rows]))
        model, vehicle = (np.concatenate([row["grades"][name].score for row in rows]) for name in (kind, ""))
        found[kind] = TransferGrades(model, vehicle, rho)
    return found


def _with_map(bench: Bench, logs: Sequence[Path], place: Path) -> Bench:
    """The bench with the map of the same logs."""
    path = place / "calibration.npz"
    if not path.is_file():
        place.mkdir(parents=True, exist_ok=True)
        ended(map_logs(MapOptions(logs, bench.vehicle.folder, place)))
    controller = with_values(bench.spec.controller, calibration=str(path.resolve()))
    return replace(bench, spec=with_values(bench.spec, controller=controller))


def _graded(bench: Bench, model: str, vectors: Mapping[str, Mapping[str, float]], ledger: Ledger) -> Graded:
    scores, finished = [], []
    with Rig(bench, model, bench.spec.scenarios, ledger, over_bus=False) as rig:
        for values in vectors.values():
            found = rig.evaluate(values)
            scores.append(found["score"])
            finished.append(not failed(found["scenarios"]))
    return Graded(np.array(scores), np.array(finished))


def _scores(bench: Bench, model: str, vectors: Mapping[str, Mapping[str, float]], ledger: Ledger) -> dict[str, float]:
    found = _graded(bench, model, vectors, ledger).score
    return dict(zip(vectors, map(float, found), strict=True))


def correlations(model: Graded, vehicle: Graded, seed: int) -> dict[str, dict[str, float]]:
    """Spearman's rho with its 95 % bootstrap interval: of sets that finish on both, of all, of the vehicle's best."""
    both = model.finished & vehicle.finished
    best = np.argsort(vehicle.score, kind="stable")[:BEST]
    rows = {"finished": np.flatnonzero(both), "all": np.arange(len(both)), f"best_{BEST}": best}
    return {name: _rho(model.score[some], vehicle.score[some], seed) for name, some in rows.items()}


def _rho(one: np.ndarray, other: np.ndarray, seed: int) -> dict[str, float]:
    if len(one) < 3 or np.ptp(one) == 0.0 or np.ptp(other) == 0.0:
        return {"rho": float("nan"), "n": len(one), "low": float("nan"), "high": float("nan")}
    rng = np.random.default_rng(seed)
    drawn = [_rank(one[some], other[some]) for some in rng.integers(0, len(one), (RESAMPLES // 4, len(one)))]
    low, high = (float(edge) for edge in np.nanpercentile(drawn, [2.5, 97.5]))
    return {"rho": _rank(one, other), "n": len(one), "low": low, "high": high}


def _rank(one: np.ndarray, other: np.ndarray) -> float:
    if np.ptp(one) == 0.0 or np.ptp(other) == 0.0:
        return float("nan")
    found: Any = spearmanr(one, other)
    return float(found.statistic)


def _tuned(bench: Bench, model: str, trials: int, seed: int, ledger: Ledger) -> dict[str, float]:
    """The winner of a search of SET on a model; trials that the ledger knows cost nothing."""
    space = resolve_space(SET, [], file=bench.file)
    settings = StudySettings(space, seed, bench.spec.tune.sampler, "transfer", make_first_trial(space))
    with (
        tempfile.TemporaryDirectory() as folder,
        Rig(bench, model, bench.spec.scenarios, ledger, over_bus=False) as rig,
        open_study(Path(folder) / "study.db", settings) as study,
    ):

        def evaluate(searched: dict[str, float]) -> Evaluation:
            scored = rig.evaluate(parameters_of(bench, searched))
            return Evaluation(scored["score"], scored["scenarios"])

        for _ in run_trials(study, trials, evaluate):
            pass
        best = _held(bench, model, study)
    _say(f"{Path(model).name}, seed {seed}: {best.score:.4f} after {trials} trials")
    return parameters_of(bench, best.parameters)


def _held(bench: Bench, model: str, study: ScoredStudy) -> Trial:
    """The winner as `tune` chooses it: the best that holds in a slower car (jobs/tune/robustness.py)."""
    searched = replace(bench, spec=with_values(bench.spec, model=model))
    with Batch(searched) as batch:
        driving = drive_slower_car(batch, searched, study, {})
        while True:
            try:
                next(driving)
            except StopIteration as end:
                return rank_trials(study.trials(), end.value)[0]


def _say(words: str) -> None:
    print(words, file=sys.stderr, flush=True)
