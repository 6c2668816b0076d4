"""Robustness check: the best trials are driven again in a slower car; the winner is the best one that passes.

A trial passes when it drives both cars to the end without a re-plan, and the slower one without an oscillation beyond
its limit: that of the bench file's requirements, else the default.

The slower car is the plant of the search with dead times and lags of all actuators times `[tune] slower`. With 1.5, the
default, a trial that passes has the smallest phase margin that textbooks allow, 30 degrees (docs/reference/margins.md).
The slower car is always driven in the batch.

The result is plain data, the end of a sentence, and a table.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, parameters_of
from tunefree_hil.bench.batch import Batch, Driven, Job
from tunefree_hil.bench.scaling import DEAD_TIME, LAG
from tunefree_hil.grade.objectives import OBJECTIVES, measure_objectives
from tunefree_hil.grade.requirements.judgement import oscillates
from tunefree_hil.grade.requirements.limits import requirement_limits
from tunefree_hil.grade.score import combine_scores
from tunefree_hil.jobs.identity import data_sha256
from tunefree_hil.jobs.progress import count_data
from tunefree_hil.jobs.run_folder import JOINED, RunFolder, read_json, write_json
from tunefree_hil.jobs.tune.margins import MIN_DRIVES_PER_CALL, JobDriver, find_batch_obstacle
from tunefree_hil.tune.ensemble import HeldOutScore, rank_by_held_out
from tunefree_hil.tune.journal import slot_key
from tunefree_hil.tune.pareto import Objectives, find_reference, measure_trade
from tunefree_hil.tune.robust_winner import (
    DriveTotals,
    drive_totals,
    find_open_trials,
    find_rejected_trials,
    is_robust,
    mean_merit,
    rank_trials,
)
from tunefree_hil.tune.trial import Baseline, ScoredStudy, Trial, trial_order

SCHEMA = "tunefree.held/2"  # 1: without `oscillating`
FILE = "held.json"
MIN_TRIALS = 2  # with fewer trials there is no choice
MAX_CHECKED_TRIALS = 64  # the best ones; a search that has converged has hundreds that are nearly equal
MAX_SHOWN_TRIALS = 5  # rejected trials in a table
TRADE = "trade"  # key that is only in data of a study of several objectives


class RobustnessResult(NamedTuple):
    """Result of the robustness check.

    factor: On dead times and lags; 1 where nothing was checked.
    totals: In the slower car, by `slot_key` of a trial and by the name of a baseline.
    reason: Why the slower car could not be driven, '' where it was; the winner is then the best score alone.
    held_out: Of near-equal trials, by `slot_key`: what chooses among them (jobs/tune/ensemble/selection.py).
    """

    factor: float = 1.0
    totals: Mapping[str, DriveTotals] = {}
    reason: str = ""
    held_out: Mapping[str, HeldOutScore] = {}

    def rank_trials(self, trials: Sequence[Trial]) -> list[Trial]:
        """Sort the trials, the winner first."""
        return rank_by_held_out(rank_trials(trials, self.totals), self.held_out)

    def as_data(self) -> dict[str, Any]:
        """JSON data, with the keys "factor", "came" (totals) and "reason"."""
        return {"factor": self.factor, "came": _data_from_totals(self.totals), "reason": self.reason}


def robustness_from_data(data: Mapping[str, Any]) -> RobustnessResult:
    """The inverse of `RobustnessResult.as_data`."""
    return RobustnessResult(data["factor"], _totals_from_data(data), data["reason"])


def check_robustness(
    bench: Bench,
    run: RunFolder,
    study: ScoredStudy,
    vectors: Mapping[str, Mapping[str, float]],
    batch: JobDriver | None = None,
) -> Generator[Event, None, RobustnessResult]:
    """Drive the trials that may win, and the baselines, in the slower car.

    The totals are stored in held.json of the run, and read from there where they belong to the same trials.

    Args:
        bench: The bench of the search.
        run: Run folder of the tune.
        study: The scored trials.
        vectors: Baselines by name.
        batch: Batch of the model of the bench; None for a new one.
    """
    factor = bench.spec.tune.slower
    if factor == 1.0 or len(study.trials()) < MIN_TRIALS:
        return RobustnessResult()
    trials_id = hash_trials(study, factor)
    reason = find_batch_obstacle(bench, run.record.get(JOINED))
    stored = None if reason else _read_totals(run, trials_id)
    if stored is not None:
        return RobustnessResult(factor, stored)
    if not reason:
        try:
            with ExitStack() as stack:
                totals = yield from drive_slower_car(batch or stack.enter_context(Batch(bench)), bench, study, vectors)
            reason = _find_missing_actuators(bench, study, totals)
            if not reason:
                data = {"schema": SCHEMA, "of": trials_id, "slower": factor, "came": _data_from_totals(totals)}
                write_json(run.path / FILE, data)
                return RobustnessResult(factor, totals)
        except (InputError, BenchError) as error:
            reason = f"{error.code}: {error.message.splitlines()[0]}"
    yield Event("warning", f"no robustness check, the winner is the trial with the best score: {reason}")
    return RobustnessResult(factor, {}, reason)


def drive_slower_car(
    batch: JobDriver, bench: Bench, study: ScoredStudy, vectors: Mapping[str, Mapping[str, float]]
) -> Generator[Event, None, dict[str, DriveTotals]]:
    """Drive the clean baselines, then the trials in the order of their merit, until no other can win."""
    totals: dict[str, DriveTotals] = {}
    reference = find_reference(study.baselines()) if study.settings.objectives else ()
    baselines = {name: vectors[name] for name, base in study.baselines().items() if _nominal_totals(base).is_clean}
    yield Event("note", f"robustness check of the best trials ({slower_car_text(bench.spec.tune.slower)})")
    totals |= _drive_vectors(batch, bench, baselines, reference)
    if not any(_nominal_totals(trial).is_clean for trial in study.trials()):
        message = "no trial drives all scenarios without a re-plan, so none can pass the robustness check"
        yield Event("warning", f"{message}: the best score wins")
    ranked, started = sorted(study.trials(), key=trial_order), time.monotonic()
    batch_size = -(-MIN_DRIVES_PER_CALL // len(bench.spec.scenarios))
    trials = ranked[:MAX_CHECKED_TRIALS]
    while open_trials := find_open_trials(trials, totals) or _next_trials(ranked, trials, totals):
        trials = ranked[: max(len(trials), ranked.index(open_trials[-1]) + 1)]
        chosen = {slot_key(trial.slot): parameters_of(bench, trial.parameters) for trial in open_trials[:batch_size]}
        totals |= _drive_vectors(batch, bench, chosen, reference)
        n_driven, n_left = len(totals) - len(baselines), len(find_open_trials(trials, totals))
        n_passed = sum(is_robust(trial, totals) for trial in trials)
        data = count_data("robustness check, trial", n_driven, n_driven + n_left, started)
        yield Event("progress", f"{n_passed} of {n_driven} passed", data)
    return totals


def _next_trials(ranked: list[Trial], trials: list[Trial], totals: Mapping[str, DriveTotals]) -> list[Trial]:
    """Where none of the best trials passed, the next ones that may; none where one did, or where all were driven."""
    if any(is_robust(trial, totals) for trial in trials):
        return []
    return find_open_trials(ranked[: len(trials) + MAX_CHECKED_TRIALS], totals)


def slower_car_text(factor: float) -> str:
    """'delays and lags +50 %'."""
    return f"delays and lags {100.0 * (factor - 1.0):+.0f} %"


def _drive_vectors(
    batch: JobDriver, bench: Bench, vectors: Mapping[str, Mapping[str, float]], reference: Objectives
) -> dict[str, DriveTotals]:
    """Totals of each vector over all scenarios of the bench, in the slower car.

    reference: Objectives of the best manual set; empty in a study by the score.
    """
    scenarios = [bench.scenarios[name] for name in bench.spec.scenarios]
    scale = {DEAD_TIME: bench.spec.tune.slower, LAG: bench.spec.tune.slower}
    jobs = [Job(values, scenario, scale=scale) for values in vectors.values() for scenario in scenarios]
    drives = batch.drive(jobs)
    n = len(scenarios)
    totals = {name: _total_drives(bench, drives[i * n : (i + 1) * n]) for i, name in enumerate(vectors)}
    if not reference:
        return totals
    return {
        name: totals[name]._replace(trade=_measure_trade(bench, drives[i * n : (i + 1) * n], reference))
        for i, name in enumerate(vectors)
    }


def _measure_trade(bench: Bench, drives: Sequence[Driven], reference: Objectives) -> float:
    """The trade of one vector; where the bench ended a drive without a grade, that of failures."""
    grades = {drive.grade.scenario: drive.grade._asdict() for drive in drives if drive.grade is not None}
    if len(grades) < len(drives):
        return measure_trade((bench.weights.failure_score,) * len(reference), reference)
    return measure_trade(measure_objectives(grades, bench.weights, list(OBJECTIVES)), reference)


def _total_drives(bench: Bench, drives: Sequence[Driven]) -> DriveTotals:
    """Totals of one vector; a drive that the bench ended without a grade counts as failed."""
    grades = [drive.grade for drive in drives if drive.grade is not None]
    n_lost = len(drives) - len(grades)
    if n_lost:
        return DriveTotals(bench.weights.failure_score, sum(grade.replans for grade in grades), n_lost)
    totals = drive_totals(combine_scores(grades), {grade.scenario: grade.as_data() for grade in grades})
    limits = requirement_limits(bench.vehicle.limits, bench.spec.require)
    return totals._replace(oscillating=sum(oscillates(grade.requirements or {}, limits) for grade in grades))


def _nominal_totals(scored: Baseline | Trial) -> DriveTotals:
    return drive_totals(scored.score, scored.scenarios)


def _find_missing_actuators(bench: Bench, study: ScoredStudy, totals: Mapping[str, DriveTotals]) -> str:
    """A message where all scores are equal in both cars, since some plants have no actuators; else ''."""
    scores = [(trial.score, totals[key].score) for trial in study.trials() if (key := slot_key(trial.slot)) in totals]
    if scores and all(nominal == slower for nominal, slower in scores):
        return f"model {bench.spec.model} has no actuators that could be slower"
    return ""


def hash_trials(study: ScoredStudy, factor: float) -> str:
    """An id of the inputs of a robustness result: rule, settings, trials with scores, baselines, factor."""
    trials = [[trial.slot, trial.score] for trial in study.trials()]
    return data_sha256([SCHEMA, study.settings.as_data(), trials, sorted(study.baselines()), factor])


def _read_totals(run: RunFolder, trials_id: str) -> dict[str, DriveTotals] | None:
    path = run.path / FILE
    if not path.is_file():
        return None
    data = read_json(path)
    is_same = data.get("schema") == SCHEMA and data.get("of") == trials_id
    return _totals_from_data(data) if is_same else None


def _totals_from_data(data: Mapping[str, Any]) -> dict[str, DriveTotals]:
    return {key: DriveTotals(**totals) for key, totals in data["came"].items()}


def _data_from_totals(totals: Mapping[str, DriveTotals]) -> dict[str, dict[str, Any]]:
    return {key: _data_of_totals(key_totals) for key, key_totals in totals.items()}


def _data_of_totals(totals: DriveTotals) -> dict[str, Any]:
    return {name: value for name, value in totals._asdict().items() if name != TRADE or value is not None}


def robustness_data(result: RobustnessResult, study: ScoredStudy, trials: Sequence[Trial]) -> dict[str, Any]:
    """The value of "held" in a result.

    Keys: factor, reason, driven (number of trials in the slower car), holding (how many passed), and where any was
    driven: winner, passed_over (trials with a better score or trade than the winner), baselines.

    Args:
        result: Result of the robustness check.
        study: All trials.
        trials: Trials that may win; of a batch those that the bus confirmed.
    """
    all_trials = study.trials()
    driven = [trial for trial in all_trials if slot_key(trial.slot) in result.totals]
    data: dict[str, Any] = {"factor": result.factor, "reason": result.reason, "driven": len(driven)}
    data["holding"] = sum(is_robust(trial, result.totals) for trial in driven)
    if driven:
        data["winner"] = _trial_data(result.rank_trials(trials)[0], result)
        rejected = find_rejected_trials(all_trials, result.totals)
        data["passed_over"] = [_trial_data(trial, result) for trial in rejected]
        names = [name for name in study.baselines() if name in result.totals]
        data["baselines"] = {name: _data_of_totals(result.totals[name]) for name in names}
    return data


def _trial_data(trial: Trial, result: RobustnessResult) -> dict[str, Any]:
    """A trial in both cars; `slower` is None where the slower car was not driven."""
    totals = result.totals.get(slot_key(trial.slot))
    return {
        "key": slot_key(trial.slot),
        "slot": trial.slot,
        "score": trial.score,
        **({} if trial.trade is None else {TRADE: trial.trade}),
        "mean": mean_merit(trial, result.totals),
        "calm": drive_totals(trial.score, trial.scenarios).is_clean,
        "slower": totals and _data_of_totals(totals),
        "holds": is_robust(trial, result.totals),
    }


def robustness_text(data: Mapping[str, Any]) -> str:
    """The end of a sentence about `robustness_data`; '' where nothing was checked."""
    if data["reason"]:
        return f"no robustness check ({data['reason']}): chosen by score alone"
    if not data["driven"]:
        return ""
    winner = data["winner"]
    parts = [_passed_text(data)]
    if not winner["holds"]:
        parts.append(f"the winner FAILED it: it {_totals_text(winner)}")
    if data["passed_over"]:
        best, number = data["passed_over"][0], len(data["passed_over"])
        noun = _merit_noun(best)
        more = f" (and {number - 1} more with a better {noun})" if number > 1 else ""
        text = f"{best['key']} has a better {noun} ({_merit(best):.3f}) but was rejected{more}: it {_totals_text(best)}"
        if best["slower"]:
            text += f" in the slower car, where the winner has a {noun} of {_merit(winner['slower']):.3f}"
        parts.append(text)
    return "; ".join(parts)


def _passed_text(data: Mapping[str, Any]) -> str:
    """'robustness check (delays and lags +50 %): 9 of 14 passed'."""
    return f"robustness check ({slower_car_text(data['factor'])}): {data['holding']} of {data['driven']} passed"


def robustness_table(data: Mapping[str, Any]) -> list[str]:
    """Lines with the winner, the rejected trials and the baselines in both cars."""
    rows = robustness_rows(data)
    if not rows:
        return []
    noun = _merit_noun(data["winner"])
    text = _passed_text(data) + ("" if noun == "score" else f"; {noun} of the objectives (below 1: all are better)")
    width = max(len(row.name) for row in rows)
    lines = [text[0].upper() + text[1:], f"{'':{width}}  nominal  slower"]
    lines += [f"{row.name:{width}}  {row.nominal:>7}  {row.slower:>6}  {row.verdict}" for row in rows]
    more = len(data["passed_over"]) - MAX_SHOWN_TRIALS
    return [*lines, f"... {more} more with a better {noun}"] if more > 0 else lines


class RobustnessRow(NamedTuple):
    """A row of the table: name, scores or trades in the nominal and in the slower car, verdict."""

    name: str
    nominal: str
    slower: str
    verdict: str


def robustness_rows(data: Mapping[str, Any]) -> list[RobustnessRow]:
    """The winner first; empty where nothing was driven."""
    if not data["driven"]:
        return []
    entries = {f"{data['winner']['key']}, the winner": data["winner"]}
    entries |= {entry["key"]: entry for entry in data["passed_over"][:MAX_SHOWN_TRIALS]}
    entries |= {
        name: {"score": None, "slower": totals, "holds": DriveTotals(**totals).is_clean}
        for name, totals in data["baselines"].items()
    }
    return [
        RobustnessRow(
            name,
            _score_text(_merit(entry)),
            _score_text(_merit(entry["slower"] or {})),
            "passed" if entry["holds"] else _totals_text(entry),
        )
        for name, entry in entries.items()
    ]


def _merit(entry: Mapping[str, Any]) -> float | None:
    """What a trial, or its totals, is ranked by: the trade where it has one, else the score."""
    return entry.get(TRADE, entry.get("score"))


def _merit_noun(entry: Mapping[str, Any]) -> str:
    return TRADE if TRADE in entry else "score"


def _score_text(score: float | None) -> str:
    return "" if score is None else f"{score:.3f}"


def _totals_text(entry: Mapping[str, Any]) -> str:
    """'re-plans 13 times and fails in 3 scenarios', or another reason why a trial did not win."""
    totals = entry["slower"]
    if totals is None:
        return "re-plans or fails in the nominal car"
    parts = [f"re-plans {_count_text(totals['replans'], 'time')}"] if totals["replans"] else []
    parts += [f"fails in {_count_text(totals['failed'], 'scenario')}"] if totals["failed"] else []
    swinging = totals.get("oscillating", 0)  # not in results of older versions
    parts += [f"oscillates in {_count_text(swinging, 'scenario')}"] if swinging else []
    return " and ".join(parts) or f"has a {_merit_noun(totals)} of {_merit(totals):.3f}"


def _count_text(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
