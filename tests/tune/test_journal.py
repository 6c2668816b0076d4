"""The list of generations: what a kill leaves, what is refused, and the copy that the dashboard opens."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.tune.drive_study import FIRST, bowl, settings
from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.tune.journal import Journal, open_journal, slot_key
from tunefree_hil.tune.study import read_study
from tunefree_hil.tune.trial import Evaluation
from tunefree_hil.tune.trial_loop import run_generations

ASKED = settings("tpe_independent")._replace(in_flight=4)
Points = Mapping[int, dict[str, float]]


def answer(points: Points) -> list[Evaluation]:
    return [bowl(values) for values in points.values()]


@pytest.fixture
def whole(tmp_path: Path) -> Journal:
    """Three generations that nobody disturbed."""
    journal = open_journal(tmp_path / "whole.jsonl", ASKED)
    list(run_generations(journal, 12, answer))
    return journal


def test_generations_are_appended_and_read_again(whole: Journal) -> None:
    again = open_journal(whole.path, ASKED)
    assert again.trials() == whole.trials() and len(again.trials()) == 12
    assert again.best() == whole.best() == min(whole.trials(), key=lambda trial: trial.score)
    assert len(whole.path.read_text().splitlines()) == 1 + 3


def test_cut_off_anywhere_it_goes_on_to_the_same_trials(whole: Journal, tmp_path: Path) -> None:
    text = whole.path.read_bytes()
    cut = tmp_path / "cut.jsonl"
    for place in range(0, len(text), max(1, len(text) // 23)):
        cut.write_bytes(text[:place])
        journal = open_journal(cut, ASKED)
        list(run_generations(journal, 12, answer))
        assert journal.trials() == whole.trials()
        assert cut.read_bytes() == text


def test_an_interruption_is_kept_as_one_and_costs_a_generation(whole: Journal, tmp_path: Path) -> None:
    journal = open_journal(tmp_path / "cut.jsonl", ASKED)
    calls = 0

    def interrupted(points: Points) -> list[Evaluation]:
        nonlocal calls
        calls += 1
        if calls == 3:
            raise KeyboardInterrupt
        return answer(points)

    with pytest.raises(KeyboardInterrupt):
        list(run_generations(journal, 12, interrupted))
    assert [trial.error for trial in open_journal(journal.path, ASKED).failures()] == ["interrupted"] * 4
    list(run_generations(journal, 12, answer))
    assert journal.trials() == whole.trials()


def test_one_that_fails_is_asked_again_alone(whole: Journal, tmp_path: Path) -> None:
    journal = open_journal(tmp_path / "lost.jsonl", ASKED)
    asked: list[list[int]] = []

    def one_fails(points: Points) -> list[Evaluation]:
        asked.append(list(points))
        lost = len(asked) == 2
        return [Evaluation(0.0, {}, error="lost") if lost and slot == 6 else bowl(p) for slot, p in points.items()]

    told = list(run_generations(journal, 12, one_fails))
    assert asked == [[0, 1, 2, 3], [4, 5, 6, 7], [6], [8, 9, 10, 11]]
    assert [trial.slot for trial in told if trial.error] == [6]
    assert journal.trials() == whole.trials()
    with pytest.raises(BenchError, match="for good"):
        list(run_generations(journal, 16, lambda points: [Evaluation(0.0, {}, error="for good")] * len(points)))


def test_other_settings_and_other_files_are_refused(whole: Journal, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="in_flight was 4, now 8"):
        open_journal(whole.path, ASKED._replace(in_flight=8))
    other = tmp_path / "other.jsonl"
    for text in ('{"schema": "tunefree.other/1"}\n', "no JSON\n", "[1]\n"):
        other.write_text(text)
        with pytest.raises(InputError, match="not a list of trials"):
            open_journal(other, ASKED)


def test_two_processes_cannot_fill_one_list(whole: Journal) -> None:
    running = run_generations(open_journal(whole.path, ASKED), 16, answer)
    next(running)
    with pytest.raises(InputError, match="another process"):
        list(run_generations(whole, 16, answer))
    running.close()


def test_what_the_bus_confirms_stands_beside_the_batch(whole: Journal) -> None:
    whole.add_baseline("as_shipped", {**FIRST, "more": 1.0}, bowl(FIRST))
    whole.store_confirmation("as_shipped", Evaluation(0.25, {}))
    whole.store_confirmation(slot_key(3), bowl(whole.trials()[3].parameters))
    again = open_journal(whole.path, ASKED)
    assert again.baselines() == whole.baselines() and again.baselines()["as_shipped"].parameters["more"] == 1.0
    assert again.confirmations()["as_shipped"].score == 0.25
    assert again.confirmations()[slot_key(3)].score == again.trials()[3].score


def test_the_copy_is_a_study_that_grows(whole: Journal, tmp_path: Path) -> None:
    path = tmp_path / "study.db"
    path.write_text("what a full disk left behind")
    whole.copy_to(path)
    list(run_generations(whole, 16, answer))
    whole.add_baseline("as_shipped", FIRST, bowl(FIRST))
    whole.copy_to(path)
    with read_study(path) as study:
        assert study.trials() == whole.trials() and len(study.trials()) == 16
        assert study.baselines() == whole.baselines()
        assert study.settings == ASKED
    assert json.loads(whole.path.read_text().splitlines()[0])["schema"] == "tunefree.trials/1"


def required(points: Points) -> list[Evaluation]:
    """The bowl, with a requirement that only half of the box meets."""
    outcome = {"outcome": "finished"}
    return [
        bowl(values)._replace(scenarios={"bowl": {**outcome, "requirements": {"replans": 10.0 * values["lqr.q1"]}}})
        for values in points.values()
    ]


def test_requirements_are_judged_again_when_the_list_is_read(tmp_path: Path) -> None:
    asked = ASKED._replace(requirements={"replans": 1.0})
    journal = open_journal(tmp_path / "a.jsonl", asked)
    list(run_generations(journal, 24, required))
    trials = journal.trials()
    assert [trial.violation for trial in trials] == [
        max(0.0, 10.0 * trial.parameters["lqr.q1"] - 1.0) for trial in trials
    ]
    assert open_journal(journal.path, asked).trials() == trials
    best = journal.best()
    assert best is not None and best.violation == 0.0
    journal.copy_to(tmp_path / "study.db")
    with read_study(tmp_path / "study.db") as study:
        assert study.settings.requirements == {"replans": 1.0}
        assert [trial.violation for trial in study.trials()] == [trial.violation for trial in trials]
    cut = tmp_path / "cut.jsonl"
    cut.write_bytes(b"".join(journal.path.read_bytes().splitlines(keepends=True)[:3]))
    resumed = open_journal(cut, asked)
    list(run_generations(resumed, 24, required))
    assert resumed.trials() == trials


def test_a_study_by_score_alone_is_not_continued_under_requirements(whole: Journal) -> None:
    with pytest.raises(InputError, match=r"require\.replans was none, now 1"):
        open_journal(whole.path, ASKED._replace(requirements={"replans": 1.0}))
    assert "requirements" not in json.loads(whole.path.read_text().splitlines()[0])["settings"]
    assert {trial.violation for trial in whole.trials()} == {0.0}
