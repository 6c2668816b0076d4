"""What tuning is worth (tune2): studies of several seeds against every manual baseline and random search.

Searched on the bench file's model over its scenarios, judged on its verify model over scenarios that no search saw.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tools.measures._ledger import FIGURES, FOLDER, Ledger
from tools.measures._rig import Rig, failed, replans, standing
from tools.measures._side_by_side import side_by_side
from tools.measures._summary import machine, rounded, summary
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors
from tunefree_hil.tune.baselines import make_first_trial
from tunefree_hil.tune.space import resolve_space
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.study import Evaluation, open_study
from tunefree_hil.tune.trial_loop import run_trials

RANDOM = "random"
Scored = dict[str, Any]


class Plan(NamedTuple):
    """What one call of a measure does."""

    bench: str
    folder: str  # of the ledger
    scenarios: tuple[str, ...]
    verify_scenarios: tuple[str, ...]
    trials: int
    over_bus: bool  # the searches; the judging always is

    def loaded(self) -> Bench:
        """The bench file, read."""
        return load(self.bench)


class Search(NamedTuple):
    """One study: a job of a worker."""

    plan: Plan
    sampler: str
    seed: int


class Judging(NamedTuple):
    """Some vectors on one model: a job of a worker. `unseen`: the verify model and its scenarios."""

    plan: Plan
    unseen: bool
    vectors: dict[str, dict[str, float]]


def make_plan(
    bench: str, name: str, *, trials: int, scenarios: str, verify_scenarios: str, folder: str, over_bus: bool = False
) -> Plan:
    """Options as a plan: 0 trials and '' scenarios are the bench file's; scenarios are given with commas between."""
    spec = load(bench).spec

    def chosen(text: str, known: Sequence[str]) -> tuple[str, ...]:
        return tuple(name for name in known if not text or name in text.split(","))

    return Plan(
        bench,
        str(Path(folder) / name),
        chosen(scenarios, spec.scenarios),
        chosen(verify_scenarios, spec.verify_scenarios),
        trials or spec.tune.trials,
        over_bus,
    )


def measure_tuning(plan: Plan, seeds: int, workers: int) -> tuple[dict[str, Any], dict[str, list[float]]]:
    """(the answer of the measure, scores on the verify model by row of the figure)."""
    before = machine()
    bench = plan.loaded()
    baselines = compute_baseline_vectors(bench)
    sampler = bench.spec.tune.sampler
    searches = [Search(plan, kind, seed) for seed in range(1, seeds + 1) for kind in (sampler, RANDOM)]
    winners: dict[str, Scored] = {}
    for found in side_by_side(search, searches, workers):
        winners[f"{found['sampler']} {found['seed']}"] = found
        _say(f"{found['sampler']}, seed {found['seed']}: {found['score']:.4f} after {found['trials']} trials")
    vectors = baselines | {name: found["values"] for name, found in winners.items()}
    on_model = _judge(plan, False, vectors, workers)
    unseen = _judge(plan, True, vectors, workers)
    rows = {name: [unseen[name]["score"]] for name in baselines}
    for label, kind in (("random search", RANDOM), ("tuned", sampler)):
        rows[label] = [unseen[f"{kind} {seed}"]["score"] for seed in range(1, seeds + 1)]
    manual = min(baselines, key=lambda name: unseen[name]["score"])
    ratios = [score / unseen[manual]["score"] for score in rows["tuned"]]
    detail = {
        "machine": before,
        "bench": plan.bench,
        "parameters": list(next(iter(winners.values()))["parameters"]),
        "trials": plan.trials,
        "sampler": sampler,
        "scenarios": list(plan.scenarios),
        "verify_scenarios": list(plan.verify_scenarios),
        "verify_model": bench.spec.verify_model,
        "manual": manual,
        "beaten": standings(rows, unseen),
        "seeds": [_seed(winners, on_model, unseen, (sampler, RANDOM), seed) for seed in range(1, seeds + 1)],
        "baselines_on_model": {name: on_model[name]["score"] for name in baselines},
        "seconds_a_study": float(np.median([found["seconds"] for found in winners.values()])),
        "workers": workers,
        "searched": "over the bus" if plan.over_bus else "in the batch",
        "same_grades_over_the_bus": _same_grades(winners, on_model),
    }
    for line in detail["beaten"].values():
        _say(line["words"])
    return summary(ratios, "of the best manual score", rounded(detail)), rows


def _same_grades(winners: Mapping[str, Scored], on_model: Mapping[str, Scored]) -> str:
    """In how many drives of the winners the search had every metric, to the bit, that the bus had in the judging."""
    pairs = [
        (drive["metrics"], on_model[name]["scenarios"][scenario]["metrics"])
        for name, found in winners.items()
        for scenario, drive in found.get("scenarios", {}).items()
    ]
    return f"{sum(one == other for one, other in pairs)} of {len(pairs)}"


def standings(rows: Mapping[str, Sequence[float]], judged: Mapping[str, Scored]) -> dict[str, dict[str, Any]]:
    """In how many seeds the tuned vector beats each row; a row of one score stands against every seed.

    A baseline that re-plans or fails is said to do so (docs/reference/controller.md).
    """
    tuned, found = rows["tuned"], {}
    for name, scores in rows.items():
        if name == "tuned":
            continue
        against = list(scores) * len(tuned) if len(scores) == 1 else list(scores)
        wins = sum(mine < other for mine, other in zip(tuned, against, strict=True))
        own = judged[name]["scenarios"] if name in judged else {}
        words = f"beats {name} ({np.median(scores):.3f}) in {wins} of {len(tuned)} seeds"
        words += f"; it re-plans {replans(own)} times" if replans(own) else ""
        words += f"; it fails {', '.join(failed(own))}" if failed(own) else ""
        found[name] = {"beaten": wins, "of": len(tuned), "scores": list(scores), "replans": replans(own),
                       "failed": failed(own), "words": words}  # fmt: skip
    return found


def search(job: Search) -> Scored:
    """Run or go on with one study; its winner: {values, parameters, score, trials, seconds, course}."""
    plan, bench = job.plan, job.plan.loaded()
    ledger = Ledger(Path(plan.folder), f"{job.sampler}-{job.seed}")
    asked = bench.spec.tune
    space = resolve_space(asked.set, asked.parameters, file=bench.file)
    chosen = [bench.scenarios[name] for name in plan.scenarios]
    depends = {
        **standing(bench, bench.spec.model, chosen),
        "what": "study",
        "space": space.as_data(),
        "sampler": job.sampler,
        "seed": job.seed,
        "trials": plan.trials,
        "first": make_first_trial(space),
    }
    known = ledger.find(depends)
    return known if known is not None else ledger.keep(depends, _searched(job, bench, ledger, depends["identity"]))


def _searched(job: Search, bench: Bench, ledger: Ledger, identity: str) -> Scored:
    """The study itself, as `tune` runs it. Trials that the ledger knows cost nothing, so a cut-off study goes on."""
    asked = bench.spec.tune
    space = resolve_space(asked.set, asked.parameters, file=bench.file)
    settings = StudySettings(space, job.seed, job.sampler, identity, make_first_trial(space))
    seconds: list[float] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        Rig(bench, bench.spec.model, job.plan.scenarios, ledger, over_bus=job.plan.over_bus) as rig,
        open_study(Path(folder) / "study.db", settings) as study,
    ):

        def evaluate(searched: dict[str, float]) -> Evaluation:
            scored = rig.evaluate(parameters_of(bench, searched))
            seconds.append(scored["seconds"])
            return Evaluation(scored["score"], scored["scenarios"])

        for trial in run_trials(study, job.plan.trials, evaluate):
            if trial.error:
                _say(f"{job.sampler}, seed {job.seed}, trial {trial.slot + 1} failed, asked again: {trial.error}")
        best = min(study.trials(), key=lambda trial: trial.score)
        return {
            "sampler": job.sampler,
            "seed": job.seed,
            "trials": len(study.trials()),
            "slot": best.slot,
            "score": best.score,
            "scenarios": best.scenarios,
            "parameters": best.parameters,
            "values": parameters_of(bench, best.parameters),
            "seconds": sum(seconds),
            "course": [trial.score for trial in study.trials()],
        }


def _judge(plan: Plan, unseen: bool, vectors: dict[str, dict[str, float]], workers: int) -> dict[str, Scored]:
    names = list(vectors)
    shares = [names[i::workers] for i in range(workers)]
    jobs = [Judging(plan, unseen, {name: vectors[name] for name in share}) for share in shares if share]
    together: dict[str, Scored] = {}
    for found in side_by_side(judge, jobs, workers):
        together |= found
    return {name: together[name] for name in names}


def judge(job: Judging) -> dict[str, Scored]:
    """Score the vectors; those that the ledger knows are not driven again."""
    bench = job.plan.loaded()
    model = bench.spec.verify_model if job.unseen else bench.spec.model
    names = job.plan.verify_scenarios if job.unseen else job.plan.scenarios
    ledger = Ledger(Path(job.plan.folder), f"judged-{next(iter(job.vectors)).replace(' ', '-')}")
    with Rig(bench, model, names, ledger) as rig:
        return {name: rig.evaluate(values) for name, values in job.vectors.items()}


def _seed(
    winners: Mapping[str, Scored],
    on_model: Mapping[str, Scored],
    unseen: Mapping[str, Scored],
    samplers: tuple[str, str],
    seed: int,
) -> dict[str, Any]:
    """One line of the detail."""
    line: dict[str, Any] = {"seed": seed}
    for label, sampler in zip(("tuned", RANDOM), samplers, strict=True):
        name = f"{sampler} {seed}"
        line[label] = {
            "on_model": on_model[name]["score"],
            "unseen": unseen[name]["score"],
            "failed": failed(unseen[name]["scenarios"]),
            "replans": replans(unseen[name]["scenarios"]),
            "trial": winners[name]["slot"] + 1,
            "seconds": winners[name]["seconds"],
            "parameters": winners[name]["parameters"],
        }
    return line


def _say(words: str) -> None:
    print(words, file=sys.stderr, flush=True)


def write_figure(rows: Mapping[str, Sequence[float]], plan: Plan, manual: str, figures: str, name: str) -> str:
    """Dots by row to `<figures>/<name>.png`; manual: the best baseline."""
    from tools.measures.figures.dots import draw_dots
    from tunefree_hil.figures.style import save

    path, model = Path(figures) / f"{name}.png", plan.loaded().spec.verify_model
    what = f"score on {len(plan.verify_scenarios)} unseen scenarios, {model} (lower is better)"
    searched = {label: rows[label] for label in ("tuned", "random search")}
    others = sorted(rows.keys() - searched.keys(), key=lambda label: rows[label][0])
    return str(save(draw_dots(searched | {label: rows[label] for label in others}, what, manual), path))


__all__ = ["FIGURES", "FOLDER", "make_plan", "measure_tuning", "write_figure"]
