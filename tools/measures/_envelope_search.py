"""Searches of the measures over the whole envelope: that of `tune --backend batch`, and one on the vehicle itself.

The first is the job's own search, robustness check and choice, with its functions, so its winner is that of the
command. What the command does more, to drive its winner over the bus, changes no number (`parity`).
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from tools.measures._envelope import Progress, limits_on_vehicle, on_roads
from tools.measures._ledger import ROOT, Ledger, key_of, meaning
from tools.measures._rig import standing
from tunefree_hil.base.events import Event
from tunefree_hil.bench import model_of, parameters_of
from tunefree_hil.bench.batch import Batch
from tunefree_hil.config.dump import plain
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.jobs.options.records import BATCH, TuneOptions
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune.ensemble.evaluator import EnsembleEvaluator, open_batch
from tunefree_hil.jobs.tune.ensemble.selection import select_on_held_out
from tunefree_hil.jobs.tune.evaluators import BatchEvaluator, Evaluator
from tunefree_hil.jobs.tune.options import TunePlan, make_tune_plan
from tunefree_hil.jobs.tune.robustness import check_robustness
from tunefree_hil.jobs.tune.search import TrialSearch
from tunefree_hil.tune.insight import Edge, find_edge
from tunefree_hil.tune.journal import Journal, open_journal
from tunefree_hil.tune.trial import Trial

T = TypeVar("T")
Report = Callable[[], None]  # called after every event of a search
Winner = dict[str, Any]  # {seed, trial, trials, score, violation, parameters, values, edges, course}
CHECK_SHARE = 0.1  # of a search: the robustness check


class SearchRequest(NamedTuple):
    """One study. trials: 0 is the bench file's number."""

    bench_file: str
    seed: int
    trials: int = 0

    def plan(self) -> TunePlan:
        """The options of the command."""
        options = TuneOptions(
            Path(self.bench_file), trials=self.trials or None, seed=self.seed, backend=BATCH, verify=False
        )
        return make_tune_plan(options)


def search_units(plan: TunePlan, n_roads: int) -> float:
    """Work of a search, in drives."""
    return (1.0 + CHECK_SHARE) * (plan.trials + len(plan.vectors)) * n_roads


class _Study(NamedTuple):
    """A search to run or to find. depends: all that its winner depends on."""

    plan: TunePlan
    name: str
    units: float
    depends: dict[str, Any]


def find_winner(request: SearchRequest, ledger: Ledger, progress: Progress) -> Winner:
    """The winner of `tunefree-hil tune BENCH --backend batch --seed SEED` on the searched model."""
    plan = request.plan()
    bench, roads = plan.bench, [plan.bench.scenarios[name] for name in plan.bench.spec.scenarios]
    depends = {
        **standing(bench, bench.spec.model, roads),
        "what": "study",
        "slower": bench.spec.tune.slower,
        "ensemble": None if bench.spec.ensemble is None else plain(bench.spec.ensemble),
    }
    study = _study(plan, f"{Path(request.bench_file).stem}-seed-{request.seed}", len(roads), depends)
    return _keep_winner(study, ledger, progress, _search)


def search_on_vehicle(request: SearchRequest, roads: list[ScenarioSpec], ledger: Ledger, progress: Progress) -> Winner:
    """The best trial of a search on the vehicle itself over these roads, requirements first, then the score.

    It keeps the requirements without the reserve of a search, and is not checked in a slower car: a bound, not gains
    to use. The controller, with what it knows of the vehicle, is that of the bench file.
    """
    plan = request.plan()
    bench, vehicle = on_roads(plan.bench, roads), plan.bench.spec.verify_model
    depends = standing(bench, vehicle, roads)
    settings = plan.settings._replace(bench_hash=depends["identity"], requirements=limits_on_vehicle(bench))
    depends |= {"what": "study on the vehicle", "identified": model_of(bench, bench.spec.model).hash}
    plan = plan._replace(bench=bench, settings=settings)
    study = _study(plan, f"{Path(request.bench_file).stem}-on-vehicle-seed-{request.seed}", len(roads), depends)
    return _keep_winner(study, ledger, progress, _search_vehicle)


def _study(plan: TunePlan, name: str, n_roads: int, depends: dict[str, Any]) -> _Study:
    depends |= {"settings": plan.settings.as_data(), "trials": plan.trials, "search": search_code_hash()}
    return _Study(plan, name, search_units(plan, n_roads), depends)


def _keep_winner(
    study: _Study, ledger: Ledger, progress: Progress, search: Callable[[TunePlan, Journal, Report], Trial]
) -> Winner:
    """The winner that the ledger knows, else that of the search; a search that was cut off goes on in its folder."""
    winner = ledger.find(study.depends)
    is_known = winner is not None
    if winner is None:
        path = ledger.folder / f"{study.name}-{key_of(study.depends)[:12]}" / "trials.jsonl"
        path.parent.mkdir(parents=True, exist_ok=True)
        journal = open_journal(path, study.plan.settings)

        def report() -> None:
            done, total = len(journal.trials()), study.plan.trials
            progress.update(study.units * done / total / (1.0 + CHECK_SHARE), f"{study.name}, trial {done} of {total}")

        trial = search(study.plan, journal, report)
        winner = ledger.keep(study.depends, describe_winner(study.plan, journal, trial))
    progress.finish(study.units, f"{study.name}: {winner['score']:.4f}, trial {winner['trial']}", is_known=is_known)
    return winner


def _search(plan: TunePlan, journal: Journal, report: Report) -> Trial:
    """Search, robustness check and choice as the job makes them (jobs/tune/tune.py); the winner."""
    bench, run = plan.bench, RunFolder(journal.path.parent, {})
    with open_batch(bench) as (batch, cars):
        evaluator: Evaluator
        if cars is None:
            evaluator = _batch_evaluator(plan, batch)
        else:
            limits, first = plan.settings.requirements, len(plan.vectors)
            evaluator = EnsembleEvaluator(batch, bench, cars, journal.baselines, limits=limits, first_trial=first)
        _run_trials(plan, evaluator, journal, report)
        robustness = _result_of(check_robustness(bench, run, journal, plan.vectors, batch))
    ranked = robustness.rank_trials(journal.trials())
    held_out = _result_of(select_on_held_out(bench, run, journal, ranked))
    return robustness._replace(held_out=held_out).rank_trials(journal.trials())[0]


def _search_vehicle(plan: TunePlan, journal: Journal, report: Report) -> Trial:
    with Batch(plan.bench, plan.bench.spec.verify_model) as batch:
        _run_trials(plan, _batch_evaluator(plan, batch), journal, report)
    best = journal.best()
    assert best is not None
    return best


def _batch_evaluator(plan: TunePlan, batch: Batch) -> BatchEvaluator:
    scenarios = [plan.bench.scenarios[name] for name in plan.bench.spec.scenarios]
    return BatchEvaluator(batch, plan.bench, scenarios, batch_size=max(len(plan.vectors), 1))


def _run_trials(plan: TunePlan, evaluator: Evaluator, journal: Journal, report: Report) -> None:
    """Baselines and trials that the journal does not have yet."""
    search = TrialSearch(plan, RunFolder(journal.path.parent, {}), evaluator, journal)
    for job in (search.score_baselines(), search.run_trials()):
        for _ in job:
            report()


def _result_of(job: Generator[Event, None, T]) -> T:
    """Run a job to its end; what it returns."""
    while True:
        try:
            next(job)
        except StopIteration as end:
            return end.value


def describe_winner(plan: TunePlan, journal: Journal, trial: Trial) -> Winner:
    """Plain data of a winner and of the course of its search."""
    edges = {axis.name: find_edge(axis, trial.parameters[axis.name]) for axis in plan.settings.space.axes}
    return {
        "seed": plan.settings.seed,
        "trial": trial.slot + 1,
        "trials": len(journal.trials()),
        "score": trial.score,
        "violation": trial.violation,
        "parameters": trial.parameters,
        "values": parameters_of(plan.bench, trial.parameters),
        "edges": {name: edge.value for name, edge in edges.items() if edge is not Edge.NONE},
        "course": [[one.score, one.violation] for one in journal.trials()],
    }


@lru_cache(maxsize=1)
def search_code_hash() -> str:
    """SHA-256 over the code of the search job, which the hash of a score's code leaves out."""
    paths = sorted((ROOT / "tunefree_hil" / "jobs" / "tune").rglob("*.py"))
    return sha256("".join(meaning(path.read_text(encoding="utf-8")) for path in paths).encode()).hexdigest()
