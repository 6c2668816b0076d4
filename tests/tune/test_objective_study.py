"""Studies of two objectives: stored and read alike everywhere, resumed, refused with other ones, old ones as before."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import optuna
import pytest

from tests.tune.drive_study import bowl, settings
from tunefree_hil.base.errors import InputError, TunefreeError
from tunefree_hil.tune.journal import open_journal
from tunefree_hil.tune.pareto import find_study_front, measure_trade
from tunefree_hil.tune.study import open_study, read_study
from tunefree_hil.tune.trial import Evaluation, check_evaluation
from tunefree_hil.tune.trial_loop import point_from_trial, run_generations

NAMES = ("tracking", "comfort")
ASKED = settings("tpe_relative")._replace(in_flight=4, objectives=NAMES)
MANUAL = Evaluation(3.0, {}, objectives=(2.0, 1.0))


def judge(values: Mapping[str, float]) -> Evaluation:
    """Two objectives that cannot both be small."""
    score = bowl(dict(values)).score
    return Evaluation(score, {"bowl": {"score": score}}, objectives=(0.1 + values["lqr.q1"], 0.05 / values["lqr.q1"]))


def answer(points: Mapping[int, dict[str, float]]) -> list[Evaluation]:
    return [judge(values) for values in points.values()]


def test_both_stores_have_the_same_trials_and_the_same_winner(tmp_path: Path) -> None:
    journal = open_journal(tmp_path / "trials.jsonl", ASKED)
    journal.add_baseline("manual", {}, MANUAL)
    yielded = list(run_generations(journal, 16, answer))
    with open_study(tmp_path / "study.db", ASKED) as study:
        study.add_baseline("manual", {}, MANUAL)
        assert list(run_generations(study, 16, answer)) == yielded == journal.trials() == study.trials()
    journal.copy_to(tmp_path / "copy.db")
    for path in ("study.db", "copy.db"):
        with read_study(tmp_path / path) as again:
            best, front = again.best(), find_study_front(again.trials(), again.baselines())
            assert again.settings == ASKED and again.trials() == yielded and again.baselines() == journal.baselines()
            assert best == journal.best() and best in front.trials and front.reference == MANUAL.objectives
            assert best is not None and best.merit == best.trade == measure_trade(best.objectives, (2.0, 1.0))
    assert min(yielded, key=lambda trial: trial.score) != journal.best(), "another trial than the best score"


def test_a_dashboard_finds_the_score_as_value_and_the_objectives_beside_it(tmp_path: Path) -> None:
    with open_study(tmp_path / "study.db", ASKED) as study:
        list(run_generations(study, 4, answer))
    stored = optuna.load_study(study_name="tunefree", storage=f"sqlite:///{tmp_path / 'study.db'}")
    assert len(stored.directions) == 1
    assert stored.trials[3].user_attrs["objectives"] == list(judge(stored.trials[3].params).objectives)


def test_cut_off_anywhere_it_goes_on_to_the_same_trials(tmp_path: Path) -> None:
    whole, cut = open_journal(tmp_path / "whole.jsonl", ASKED), tmp_path / "cut.jsonl"
    whole.add_baseline("manual", {}, MANUAL)
    list(run_generations(whole, 12, answer))
    text = whole.path.read_bytes()
    first = text.index(b"\n", text.index(b"\n") + 1) + 1  # settings and baseline
    for place in range(first, len(text), max(1, len(text) // 9)):
        cut.write_bytes(text[:place])
        journal = open_journal(cut, ASKED)
        list(run_generations(journal, 12, answer))
        assert journal.trials() == whole.trials() and cut.read_bytes() == text


def test_other_objectives_are_refused(tmp_path: Path) -> None:
    alone = ASKED._replace(objectives=())
    for begun, asked, words in ((ASKED, alone, "now the score"), (alone, ASKED, "was|were the score, now tracking")):
        folder = tmp_path / str(len(begun.objectives))
        folder.mkdir()
        open_journal(folder / "t.jsonl", begun)
        open_study(folder / "s.db", begun).close()
        for open_again in (lambda f=folder, a=asked: open_journal(f / "t.jsonl", a),
                           lambda f=folder, a=asked: open_study(f / "s.db", a)):  # fmt: skip
            with pytest.raises(InputError, match=words) as caught:
                open_again()
            assert caught.value.key == "objectives"


def test_a_search_by_score_is_stored_as_in_earlier_versions(tmp_path: Path) -> None:
    journal = open_journal(tmp_path / "t.jsonl", ASKED._replace(objectives=()))
    journal.add_baseline("manual", {}, bowl({**ASKED.first}))
    list(run_generations(journal, 4, lambda points: [bowl(values) for values in points.values()]))
    header, baseline, trials = (json.loads(line) for line in journal.path.read_text().splitlines())
    assert "objectives" not in header["settings"] and set(baseline) == {"baseline", "parameters", "score", "scenarios"}
    assert all(set(trial) == {"slot", "parameters", "score", "scenarios"} for trial in trials["trials"])
    assert all(trial.trade is None and trial.merit == trial.score for trial in journal.trials())


@pytest.mark.parametrize(("sampler", "learned"), [("tpe_relative", (0.2, 0.5)), ("nsga", (0.2, 0.5)), ("tpe_cma", ())])
def test_a_sampler_of_one_objective_learns_the_trade(tmp_path: Path, sampler: str, learned: tuple[float, ...]) -> None:
    asked = ASKED._replace(sampler=sampler)
    journal = open_journal(tmp_path / "t.jsonl", asked)
    journal.add_baseline("manual", {}, MANUAL)
    list(run_generations(journal, 4, lambda points: [Evaluation(1.0, {}, objectives=(0.2, 0.5)) for _ in points]))
    point = point_from_trial(journal.trials()[0], asked)
    assert point.objectives == learned and point.score == measure_trade((0.2, 0.5), (2.0, 1.0))


def test_an_objective_is_a_score() -> None:
    with pytest.raises(TunefreeError, match="scored -1"):
        check_evaluation(Evaluation(1.0, {}, objectives=(0.1, -1.0)), "it")
