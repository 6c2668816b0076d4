"""Sizes by bisection, the order in which an exam is asked, and who waits for whom."""

from __future__ import annotations

import itertools
import threading
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tools.gap_exam.drives_for_tests import DOMAIN
from tools.gap_exam.cases import Case
from tools.gap_exam.catalogue import EFFECTS, kind_of, value
from tools.gap_exam.files import Run, write_json
from tools.gap_exam.ladder import FIRST_STEP, Ladder, at_size, effect_of, next_size, threshold
from tools.gap_exam.limits import limits
from tools.gap_exam.order import in_order, part_of
from tools.gap_exam.outcomes import Mark
from tools.gap_exam.rows import PER_ROUND, ROUNDS, exam_of
from tools.gap_exam.runner import Turns
from tools.gap_exam.score import Marked
from tools.gap_exam.seal import put_away
from tools.gap_exam.session import Wish, askable, chosen, exam_for

EXAM = exam_of(DOMAIN)
STEPS = [case for case in EXAM.cases if case.rung >= 0 and effect_of(case) == "steer_lag"]


def answered(run: Run, case: Case, verdict: str) -> None:
    put_away(run, case.number, {**case._asdict(), "oracle": None, "mismatch": 0.0}, "00")
    effects = [{"name": effect_of(case), "params": {}}] if verdict == "one" else []
    write_json(run.answer(case.number) / "gap.json", {"verdict": verdict, "effects": effects, "set": []})
    write_json(run.answer(case.number) / "run.json", {"seconds": 1.0})


@given(st.lists(st.lists(st.booleans(), min_size=3, max_size=3), max_size=ROUNDS - 1))
def test_every_round_halves_what_is_open(rounds: list[list[bool]]) -> None:
    sizes = [next_size(rounds[:k]) for k in range(len(rounds) + 1)]
    for k, (before, after) in enumerate(itertools.pairwise(sizes)):
        assert after - before == pytest.approx((-1 if all(rounds[k]) else 1) * FIRST_STEP * 0.5**k)
    assert 0.0 < sizes[-1] < 1.0


def test_a_bisection_and_the_sizes_that_were_drawn_find_a_sharp_limit() -> None:
    drawn = [0.12 + 0.88 * (k + 0.5) / 7 for k in range(7)]  # of the row `one`, evenly here
    for edge in (0.2, 0.34, 0.61, 0.9):
        rounds, sizes, named = [], [], []
        for _ in range(ROUNDS):
            size = next_size(rounds)
            rounds.append([size >= edge] * PER_ROUND)
            sizes += [size] * PER_ROUND
            named += rounds[-1]
        found = threshold([*sizes, *drawn], [*named, *(size >= edge for size in drawn)])
        assert abs(found.size - edge) < 0.1 and found.low < edge + 0.07 and found.high > edge - 0.07


def test_the_interval_of_a_limit_holds_what_it_says() -> None:
    """Logs named at random by a curve whose 90 % point is known: it lies within in nine of ten cases and more."""
    rng, inside = np.random.default_rng(4), 0
    for _ in range(80):
        edge, spread, rounds, sizes = rng.uniform(0.1, 0.9), rng.uniform(0.03, 0.12), [], []
        for _ in range(ROUNDS):
            size = next_size(rounds)
            share = 1.0 / (1.0 + np.exp(-((size - edge) / spread + np.log(9.0))))
            rounds.append(list(rng.random(PER_ROUND) < share))
            sizes += [size] * PER_ROUND
        drawn = rng.uniform(0.12, 1.0, 7)  # of the row `one`
        hits = rng.random(7) < 1.0 / (1.0 + np.exp(-((drawn - edge) / spread + np.log(9.0))))
        found = threshold([*sizes, *drawn], [*(bool(one) for some in rounds for one in some), *hits.tolist()])
        inside += found.low <= edge <= found.high
    assert inside >= 0.88 * 80


def test_a_size_hangs_on_the_answers_before_it(tmp_path: Path) -> None:
    run, ladder = Run(tmp_path), Ladder(EXAM)
    first, second, third = ([case for case in STEPS if case.rung == rung] for rung in range(3))
    assert not ladder.waits(run, first[0]) and ladder.waits(run, second[0])
    for case in first:
        answered(run, at_size(EXAM, case, 0.5), "one")
    assert not ladder.waits(run, second[0]) and ladder.waits(run, third[0])
    sized = ladder.sized(run, second[0])
    assert sized.size == 0.2 and sized.effects["steer_lag"]["tau_s"] == pytest.approx(value("steer_lag", 0.2), rel=1e-4)
    for case, verdict in zip(second, ("one", "none_missing", "one"), strict=True):
        answered(run, ladder.sized(run, case), verdict)
    assert ladder.sized(run, third[0]).size == 0.35


def test_sign_and_second_parameter_stay_whatever_the_size() -> None:
    for name in ("yaw_rate_bias", "payload"):
        case = next(case for case in EXAM.cases if case.rung == 1 and effect_of(case) == name)
        small, large = (at_size(EXAM, case, size).effects[name] for size in (0.1, 0.9))
        main = kind_of(name).parameter
        assert small[main] * large[main] > 0.0 and abs(small[main]) < abs(large[main])
        assert {k: v for k, v in small.items() if k != main} == {k: v for k, v in large.items() if k != main}
        assert at_size(EXAM, case, 0.5).effects == case.effects


def test_every_row_has_some_early_and_the_headline_is_done_first() -> None:
    order = in_order(EXAM)
    assert sorted(case.number for case in order) == list(range(len(EXAM.cases)))
    tenth = Counter(case.row for case in order[: len(order) // 10])
    assert set(tenth) == {case.row for case in EXAM.cases} - {"semi_free"} or set(tenth) == {c.row for c in EXAM.cases}
    last = {row: max(k for k, case in enumerate(order) if case.row == row) for row in tenth}
    assert min(last, key=last.__getitem__) in ("one", "semi_free") and last["one"] < 0.7 * len(order)
    before = max(place for row, place in last.items() if row != "limits")
    assert before < 0.95 * last["limits"], "what a cut run lacks first is the last rounds of the bisections"
    effects = {effect_of(case) for case in order[: len(order) // 4] if case.row == "one"}
    assert len(effects) > 36, "a run that is cut off has met most effects"
    assert order == in_order(exam_of(DOMAIN))


def test_parts_share_an_exam_and_no_bisection_is_cut() -> None:
    parts = [chosen(EXAM, Wish(Path("x"), part=f"{k}/4", recordings=Path("y"))) for k in (1, 2, 3, 4)]
    assert sorted(case.number for part in parts for case in part) == list(range(len(EXAM.cases)))
    for name in EFFECTS:
        assert len({part_of(case, 4) for case in EXAM.cases if case.rung >= 0 and effect_of(case) == name}) == 1
    with pytest.raises(ValueError, match="K/N"):
        chosen(EXAM, Wish(Path("x"), part="5/4"))
    with pytest.raises(ValueError, match="no row"):
        chosen(EXAM, Wish(Path("x"), rows=("on",)))
    assert not any(case.source for case in chosen(EXAM, Wish(Path("x"))))


def test_a_case_that_waits_lets_others_by(tmp_path: Path) -> None:
    run = Run(tmp_path)
    first, second = ([case for case in STEPS if case.rung == rung] for rung in range(2))
    other = next(case for case in EXAM.cases if case.row == "free")
    turns = Turns(run, Ladder(EXAM), [*first, *second, other])
    taken = [turns.take() for _ in range(3)]
    assert [one.number for one in taken if one] == [case.number for case in first]
    assert (turns.take() or first[0]).number == other.number, "the second round waits for the first's answers"
    waiting: list[Case | None] = []
    thread = threading.Thread(target=lambda: waiting.append(turns.take()))
    thread.start()
    for case in first:
        answered(run, at_size(EXAM, case, 0.5), "none_missing")
        turns.give_back()
    thread.join(10.0)
    assert waiting[0] is not None and waiting[0].number == second[0].number and waiting[0].size == 0.8
    assert Turns(run, Ladder(EXAM), [other], until=0.0).take() is None, "no time left"
    stopped = Turns(run, Ladder(EXAM), [other])
    stopped.stop()
    assert stopped.take() is None


def test_what_waits_for_another_part_ends_the_work(tmp_path: Path) -> None:
    second = [case for case in STEPS if case.rung == 1]
    assert Turns(Run(tmp_path), Ladder(EXAM), second).take() is None


def test_a_folder_is_gone_on_with_in_its_own_domain(tmp_path: Path) -> None:
    write_json(Run(tmp_path).exam, {"domain": "dev:tests", "sample": False})
    assert exam_for(Wish(tmp_path)).cases == EXAM.cases
    with pytest.raises(Exception, match="whole exam"):
        exam_for(Wish(tmp_path, sample=True))


def test_a_limit_is_said_by_the_drives_that_excite_as_well() -> None:
    """An effect that ordinary drives never show is named on excited ones from 0.4 on, and not in 90 % of all logs."""

    def marked(row: str, kind: str, size: float) -> Marked:
        effects = {"steer_lag": {kind_of("steer_lag").parameter: value("steer_lag", size)}}
        truth = {"row": row, "kind": kind, "size": size if row == "limits" else -1.0, "effects": effects}
        return Marked(0, truth, None, Mark("right" if kind == "excited" and size >= 0.4 else "silent"))

    sizes = [0.5, 0.3, 0.4, 0.35, 0.45]
    asked = [marked("limits", "excited", size) for size in sizes]
    drawn = [marked("one", kind, size) for kind in ("excited", "ordinary") for size in (0.6, 0.8, 0.95)]
    (found,) = limits([*asked, *drawn])
    assert found.excited is not None and value("steer_lag", 0.3) < found.excited < value("steer_lag", 0.6)
    assert found.value is None or found.value > 1.5 * found.excited
    (of_excited,) = limits([one for one in (*asked, *drawn) if one.truth["kind"] == "excited"])
    assert of_excited.value == of_excited.excited == found.excited


def test_cases_of_recordings_are_not_left_where_none_were_given(tmp_path: Path) -> None:
    run = Run(tmp_path)
    assert not any(case.source for case in askable(run, EXAM).cases) and any(case.source for case in EXAM.cases)
    (tmp_path / "recordings").mkdir()
    assert askable(run, EXAM) is EXAM
