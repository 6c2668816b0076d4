"""What a batch found, said again by the bus: which candidates are driven, what counts as equal, who wins."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import pytest

from tests.bench.tiny import write_bench
from tunefree_hil.base.errors import BenchError, PeerGone
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors
from tunefree_hil.jobs.tune.confirm import ConfirmedStudy, confirm_over_bus, find_differences, find_unconfirmed
from tunefree_hil.jobs.tune.evaluators import BusEvaluator, VectorCandidate
from tunefree_hil.jobs.tune.report import write_tune_report
from tunefree_hil.jobs.tune.robustness import RobustnessResult
from tunefree_hil.tune.compare import find_best_baseline
from tunefree_hil.tune.ensemble import CARS
from tunefree_hil.tune.journal import Journal, open_journal, slot_key
from tunefree_hil.tune.robust_winner import DriveTotals
from tunefree_hil.tune.space import resolve_space
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.trial import Evaluation
from tunefree_hil.tune.trial_loop import run_generations

TRIALS = 8
BY_GRADE = RobustnessResult()


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return load(write_bench(tmp_path))


def score_of(values: dict[str, float]) -> float:
    return values["mrac.t_ref_s"] + (0.0 if values["mrac.enable"] else 1.0)


def evaluation(score: float) -> Evaluation:
    grade = {"scenario": "tiny", "score": score, "metrics": {"lateral_err_peak": 2.0 * score}, "replans": 0}
    return Evaluation(score, {"tiny": {**grade, "outcome": "finished", "ticks": 200}})


@pytest.fixture
def journal(bench: Bench, tmp_path: Path) -> Journal:
    """Eight trials and the baselines, scored in a batch."""
    settings = StudySettings(resolve_space("mrac", [], file=bench.file), 1, "random", "sha256:00", {}, in_flight=4)
    made = open_journal(tmp_path / "trials.jsonl", settings)
    for name, values in compute_baseline_vectors(bench).items():
        made.add_baseline(name, values, evaluation(score_of(values)))
    list(
        run_generations(
            made, TRIALS, lambda points: [evaluation(score_of(parameters_of(bench, p))) for p in points.values()]
        )
    )
    return made


class FakeBus:
    """Says what the batch said, but for `wrong` candidates (by group), whose score it raises; `lost`: the first try."""

    def __init__(self, wrong: Sequence[int] = (), lost: Sequence[int] = ()) -> None:
        self.wrong, self.lost = wrong, list(lost)
        self.asked: list[int] = []
        self.pace: dict[str, float] = {}

    def evaluate(self, candidates: Sequence[VectorCandidate]) -> list[Evaluation]:
        (one,) = candidates
        self.asked.append(one.group)
        if one.group in self.lost:
            self.lost.remove(one.group)
            raise PeerGone("ecu")
        return [evaluation(score_of(dict(one.values)) + (0.5 if one.group in self.wrong else 0.0))]


def confirmed(
    bench: Bench, journal: Journal, bus: FakeBus, best: int = 2, held: RobustnessResult = BY_GRADE
) -> list[str]:
    vectors = compute_baseline_vectors(bench)
    missing = find_unconfirmed(journal, best, held)
    events = confirm_over_bus(bench, journal, cast(BusEvaluator, bus), vectors, missing)
    return [f"{event.kind}: {event.message}" for event in events]


def test_the_best_trials_and_the_best_baseline_are_driven_once(bench: Bench, journal: Journal) -> None:
    bus, baselines = FakeBus(), len(compute_baseline_vectors(bench))
    said = confirmed(bench, journal, bus)
    best = sorted(journal.trials(), key=lambda trial: trial.score)[:2]
    manual = list(journal.baselines()).index(find_best_baseline(journal.baselines()).name)
    assert bus.asked == [baselines + trial.slot for trial in best] + [manual]
    assert all(line.startswith("progress") and line.endswith("equal") for line in said)
    assert find_unconfirmed(journal, 2, BY_GRADE) == {} and len(find_unconfirmed(journal, 3, BY_GRADE)) == 1
    assert find_unconfirmed(open_journal(journal.path, journal.settings), 2, BY_GRADE) == {}, (
        "what was confirmed is kept"
    )


def test_the_winner_is_the_bus_s_and_what_differs_is_named(bench: Bench, journal: Journal, tmp_path: Path) -> None:
    first, second = sorted(journal.trials(), key=lambda trial: trial.score)[:2]
    wrong = len(compute_baseline_vectors(bench)) + first.slot
    said = confirmed(bench, journal, FakeBus(wrong=[wrong]))
    assert said[0].startswith("warning") and "DIFFERENT (tiny: score, tiny: lateral_err_peak)" in said[0]
    result = ConfirmedStudy(journal)
    best = result.best()
    assert best is not None and best.slot == second.slot
    report = write_tune_report(bench, RunFolder(tmp_path, {}), result, BY_GRADE, result)
    assert report.data["exit"] == 1 and report.data["different"] == [f"trial {first.slot + 1}"]
    text = "\n".join(report.lines)
    assert f"all {TRIALS} trials were driven in the batch; 2 of them" in text
    assert any(line.startswith(f"trial {second.slot + 1} ") and "the winner" in line for line in report.lines)
    assert "2 of 3 candidates have the same metrics in batch and bus" in report.sentence


def test_what_holds_is_confirmed_and_wins_and_the_better_grade_is_named(
    bench: Bench, journal: Journal, tmp_path: Path
) -> None:
    first, second, third = sorted(journal.trials(), key=lambda trial: trial.score)[:3]
    upset, calm = DriveTotals(5.0, 7, 2), DriveTotals(third.score + 0.1, 0, 0)
    came = {slot_key(first.slot): upset, slot_key(second.slot): upset, slot_key(third.slot): calm}
    held, bus = RobustnessResult(1.5, came), FakeBus()
    confirmed(bench, journal, bus, best=1, held=held)
    assert bus.asked[0] == len(compute_baseline_vectors(bench)) + third.slot
    result = ConfirmedStudy(journal)
    report = write_tune_report(bench, RunFolder(tmp_path, {}), result, held, result)
    assert report.data["best"]["slot"] == third.slot
    assert tomllib.loads((tmp_path / "best.toml").read_text())["slot"] == third.slot
    assert [one["slot"] for one in report.data["held"]["passed_over"]] == [first.slot, second.slot]
    assert f"{slot_key(first.slot)} has a better score ({first.score:.3f}) but was rejected" in report.sentence


def test_a_node_that_is_lost_costs_one_attempt(bench: Bench, journal: Journal) -> None:
    manual = list(journal.baselines()).index(find_best_baseline(journal.baselines()).name)
    bus = FakeBus(lost=[manual])
    said = confirmed(bench, journal, bus)
    assert [line for line in said if "driven again" in line and line.startswith("warning")]
    assert all(one.is_equal for one in ConfirmedStudy(journal).scores().values())
    with pytest.raises(BenchError):
        journal_again = open_journal(journal.path.with_name("other.jsonl"), journal.settings)
        journal_again.add_baseline("as_shipped", compute_baseline_vectors(bench)["as_shipped"], evaluation(1.0))
        confirmed(bench, journal_again, FakeBus(lost=[0, 0]))


def test_equal_scores_of_other_drives_are_not_equal() -> None:
    one = {"a": {"score": 0.5, "metrics": {"x": 1.0, "y": None}, "replans": 0}}
    same = {"a": {"score": 0.5, "metrics": {"x": 1.0, "y": None}, "replans": 0, "frame_hash": "00"}}
    assert find_differences(one, same) == ()
    assert find_differences({"a": {**one["a"], "frame_hash": "01"}}, same) == ("a: frame_hash",)
    assert find_differences(one, {"a": {**one["a"], "metrics": {"x": 1.0, "y": 0.0}}}) == ("a: y",)
    assert find_differences(one, {**one, "b": {"score": 0.1}}) == ("b: score",)


def test_requirements_are_compared_where_both_have_them() -> None:
    """Trials of an earlier version have none, and the bus that confirms them has."""
    old = {"score": 0.1, "replans": 0, "metrics": {"a": 1.0}}
    new = {**old, "requirements": {"replans": 0.0, "lateral_error_peak_m": 0.2}, "oscillation": None}
    assert find_differences({"bend": old}, {"bend": new}) == ()
    assert find_differences({"bend": new}, {"bend": new}) == ()
    other = {**new, "requirements": {"replans": 0.0, "lateral_error_peak_m": 0.3}}
    assert find_differences({"bend": new}, {"bend": other}) == ("bend: require lateral_error_peak_m",)
    assert find_differences({"bend": old}, {"bend": {**new, "replans": 1}}) == ("bend: replans",)


def test_of_an_ensemble_the_bus_confirms_the_model_and_the_score_stays(bench: Bench, tmp_path: Path) -> None:
    """Only the batch drives the other cars: their part of the score cannot differ."""

    def over_cars(values: dict[str, float]) -> Evaluation:
        plain = evaluation(score_of(values))
        drive = {**plain.scenarios["tiny"], "planned_samples": 200, CARS: {"drives": 3, "mean": 5.0, "worst": 9.0}}
        return Evaluation(plain.score + 2.0, {"tiny": drive})

    class Bus(FakeBus):
        def evaluate(self, candidates: Sequence[VectorCandidate]) -> list[Evaluation]:
            (one,) = super().evaluate(candidates)
            return [Evaluation(one.score, {"tiny": {**one.scenarios["tiny"], "planned_samples": 200}})]

    settings = StudySettings(resolve_space("mrac", [], file=bench.file), 1, "random", "sha256:00", {}, in_flight=4)
    journal = open_journal(tmp_path / "cars.jsonl", settings)
    for name, values in compute_baseline_vectors(bench).items():
        journal.add_baseline(name, values, over_cars(values))
    list(run_generations(journal, 4, lambda points: [over_cars(parameters_of(bench, p)) for p in points.values()]))
    best = min(journal.trials(), key=lambda trial: trial.score)
    said = confirmed(bench, journal, Bus(), best=1)
    assert all(line.startswith("progress") and line.endswith("equal") for line in said)
    winner = ConfirmedStudy(journal).best()
    assert winner is not None and winner.slot == best.slot and winner.score == best.score
    assert winner.scenarios["tiny"][CARS]["drives"] == 3
    wrong = len(compute_baseline_vectors(bench)) + best.slot
    open_again = open_journal(tmp_path / "wrong.jsonl", settings)
    for name, values in compute_baseline_vectors(bench).items():
        open_again.add_baseline(name, values, over_cars(values))
    list(run_generations(open_again, 4, lambda points: [over_cars(parameters_of(bench, p)) for p in points.values()]))
    assert "DIFFERENT" in confirmed(bench, open_again, Bus(wrong=[wrong]), best=1)[0]
