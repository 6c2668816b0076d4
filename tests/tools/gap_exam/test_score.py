"""Rows, limits and intervals from hand-made cases."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tools.gap_exam import report, score
from tools.gap_exam.catalogue import EFFECTS, size_of, value
from tools.gap_exam.driver import CONTROLLER, PERSON
from tools.gap_exam.limits import amount, limits
from tools.gap_exam.outcomes import OUTCOMES, mark
from tools.gap_exam.score import Marked
from tools.gap_exam.statistics import by_models, mean, quantile, share, share_by_models
from tools.gap_exam.words import plain


def case(
    number: int, verdict: str, *names: str, row: str = "one", effects: Any = None, found: bool = True, **more: Any
) -> Marked:
    """A case of one effect (a steering lag, unless it says otherwise) and its answer."""
    effects = {"steer_lag": {"tau_s": 0.1}} if effects is None else effects
    truth = {"row": row, "effects": effects, "oracle": {"detectable": found}, "mismatch": 0.0, "kind": "excited",
             "who": CONTROLLER, "size": -1.0, **more}  # fmt: skip
    stated = [] if verdict == "set" else [{"name": name, "params": {"tau_s": {"value": 0.11}}} for name in names]
    answer = {"verdict": verdict, "effects": stated, "set": list(names) if verdict == "set" else []}
    return Marked(number, truth, answer, mark(truth, answer, 10.0))


ANSWERS = [
    ("one", "steer_lag"),
    ("set", "steer_lag", "payload"),
    ("none_missing",),
    ("one", "payload"),
    ("cannot_test",),
]


def test_a_row_sums_to_all_of_its_logs() -> None:
    cases = [case(i, *answer) for i, answer in enumerate(ANSWERS * 4)]
    row = score.row("one", cases)
    assert (
        row.outcomes == {**dict.fromkeys(OUTCOMES, 4), "partial": 0, "failed": 0} and sum(row.outcomes.values()) == 20
    )
    figures = row.figures
    assert figures["right"].value == 0.2 and figures["right"].n == 20
    assert figures["right_or_in_set"].value == 0.4 and figures["set_size"].value == 1.5
    assert figures["value_error_median"].value == pytest.approx(0.1)
    assert all(one.low <= one.value <= one.high for one in figures.values())


def test_rows_are_told_apart() -> None:
    cases = [
        case(0, "one", "steer_lag"),
        case(1, "one", "payload", found=False),
        case(2, "none_missing", row="free", effects={}),
        case(3, "none_missing", row="free", effects={}, mismatch=0.05),
        case(4, "none_of_these", row="outside", effects={"body_roll": {}}),
        case(5, "one", "steer_lag", who=PERSON, kind="ordinary", mismatch=0.02),
        case(6, "one", "steer_lag", row="semi", oracle=None),
    ]
    rows = {row.name: row for row in score.table(cases)}
    assert rows["one effect, detectable"].n == 2 and rows["one effect, not detectable"].outcomes["wrong"] == 1
    assert rows["effect-free"].n == 2 and rows["effect-free, background mismatch"].n == 1
    assert rows["outside the catalogue"].outcomes["right"] == 1
    assert rows["one effect, a person drives"].n == rows["one effect, ordinary drive"].n == 1
    assert rows["one effect, background mismatch 2 %"].n == 1 and rows["semi-real"].n == 1
    assert score.false_names(cases)[0]["number"] == 1


def ladder_cases(named: dict[float, tuple[int, ...]]) -> list[Marked]:
    """Logs of a steering lag by size, each named or met with silence."""
    cases = []
    for size, hits in named.items():
        for yes in hits:
            effects = {"steer_lag": {"tau_s": value("steer_lag", size)}}
            name = ("one", "steer_lag") if yes else ("none_missing",)
            cases.append(case(len(cases), *name, row="limits", effects=effects, size=size))
    return cases


def test_the_smallest_value_that_is_named() -> None:
    """All from 0.375 on were named and nothing at 0.25: the limit lies between, so does its interval, about."""
    cases = ladder_cases({0.5: (1, 1, 1), 0.25: (0, 0, 0), 0.375: (1, 1, 1), 0.3125: (1, 0, 0), 0.8: (1, 1, 1)})
    (found,) = limits(cases)
    assert found.n == 15 and found.unit == "s" and found.steps[0] == (0.25, value("steer_lag", 0.25), 0, 3)
    assert found.value is not None and found.low is not None and found.high is not None
    assert value("steer_lag", 0.3) < found.value < value("steer_lag", 0.45)
    assert value("steer_lag", 0.25) < found.low < found.value < found.high < value("steer_lag", 0.8)
    (never,) = limits([one._replace(mark=one.mark._replace(outcome="silent")) for one in cases])
    assert never.value is None and report.limit_words(never) == "not up to 0.171 s"
    assert report.limit_words(found) == f"{found.value:.3g} s ({found.low:.3g} to {found.high:.3g})"


def test_one_effect_logs_count_for_a_limit_once_there_is_a_bisection() -> None:
    """A size that was drawn is that of its value; of an effect without a bisection nothing is said."""
    steps = ladder_cases({0.5: (1, 1, 1), 0.25: (0, 0, 0)})
    drawn = []
    for place, size in enumerate((0.41, 0.62, 0.9)):
        effects = {"steer_lag": {"tau_s": value("steer_lag", size)}}
        drawn.append(case(20 + place, "one", "steer_lag", effects=effects, size=-1.0))
    (alone,), (both,) = limits(steps), limits([*steps, *drawn])
    assert both.n == alone.n + 3 and both.at[0] < alone.at[0], "three more were named"
    assert [round(size, 6) for size, _, _, _ in both.steps] == [0.25, 0.41, 0.5, 0.62, 0.9]
    assert limits(drawn) == []


@pytest.mark.parametrize("name", sorted(EFFECTS))
@pytest.mark.parametrize("sign", [1, -1])
def test_a_size_is_found_again_by_its_value(name: str, sign: int) -> None:
    assert size_of(name, value(name, 0.37, sign)) == pytest.approx(0.37)


def test_a_limit_is_not_said_below_what_was_asked() -> None:
    sizes = (0.5, 0.25, 0.125, 0.0625)
    (found,) = limits(ladder_cases(dict.fromkeys(sizes, (1, 1, 1))))
    assert found.value == pytest.approx(value("steer_lag", 0.0625)) and found.at[0] == found.at[1] == 0.0625
    assert found.low is None and found.or_less and found.high is not None
    assert report.limit_words(found) == f"0.017 s or less (open to {found.high:.3g})"


def test_an_end_outside_of_what_was_asked_is_open() -> None:
    """Named at half of the largest size and above that: where nothing was asked nothing is known."""
    (found,) = limits(ladder_cases({0.45: (0, 1), 0.5: (0, 1, 1), 0.55: (1, 1)}))
    assert (found.low, found.high) == (None, None) and 0.45 <= found.at[1] <= found.at[0] <= found.at[2] <= 0.55
    assert found.value is None or report.limit_words(found).endswith("(open on both sides)")
    (upper,) = limits(ladder_cases({0.2: (0, 0, 0), 0.35: (0, 0, 0), 0.5: (1, 1)}))
    assert upper.high is None and upper.low is not None and upper.at[2] == 0.5
    assert report.limit_words(upper).endswith(" to open)")
    (never,) = limits(ladder_cases({0.2: (0, 0, 0), 0.35: (0, 0, 0)}))
    assert (never.value, never.high, never.at[2]) == (None, None, 0.35) and "not up to" in report.limit_words(never)


def test_of_a_limit_less_is_grosser() -> None:
    """All named down from the slightest that was asked: that, or more; in plain notation, its unit once."""
    cases = [
        case(k, "one", name, row="limits", effects={name: {parameter: value(name, size)}}, size=size)
        for name, parameter in (("power_limit", "power_w"), ("friction", "friction_frac"), ("steer_gain", "gain_frac"))
        for k, size in enumerate([0.5] * 3 + [0.2] * 3)
    ]
    words = {one.name: report.limit_words(one) for one in limits(cases)}
    assert words["power_limit"].startswith("29 800 W or more (open to ") and "e+" not in words["power_limit"]
    assert words["friction"].startswith("0.838 or more (open to ")
    assert words["steer_gain"].startswith("1 ± 0.0269 or less (open to ") and words["steer_gain"].endswith(")")
    page = report.markdown([], limits(cases), "x")
    assert "| power_limit ↓ |" in page and "| steer_gain |" in page and "the smaller the value" in page


@pytest.mark.parametrize(
    ("number", "text"),
    [(11000.0, "11 000"), (0.02442, "0.0244"), (126.0, "126"), (9.996, "10"), (0.0, "0"), (-1234.5, "-1 230")],
)
def test_numbers_are_plain(number: float, text: str) -> None:
    assert plain(number) == text


def test_a_gain_is_limited_by_its_departure() -> None:
    assert amount("steer_gain", 1.0) == pytest.approx(0.28) and amount("power_limit", 1.0) == pytest.approx(7.5e3)
    assert amount("friction", 0.0) == pytest.approx(1 / 1.12), "no gain: what is left of it"


def test_intervals() -> None:
    """Wilson's, by its published example (81 of 263: 0.2553 to 0.3662), and none without data."""
    one = share(81, 263)
    assert (round(one.low or 0, 4), round(one.high or 0, 4)) == (0.2553, 0.3662)
    assert share(0, 300).low == 0.0 and share(0, 300).high == pytest.approx(0.0126, abs=1e-4)
    assert share(5, 5).high == 1.0 and share(0, 0).value is None
    middle = quantile([float(i) for i in range(101)], 0.5)
    assert middle.value == 50.0 and middle.low == 40.0 and middle.high == 61.0
    assert quantile([float(i) for i in range(8)], 1.0) == (7.0, 7.0, 7.0, 8)
    assert quantile([3.0], 0.9) == (3.0, 3.0, 3.0, 1) and quantile([], 0.5).n == 0
    assert mean([1.0, 3.0]).value == 2.0


def test_a_row_whose_logs_share_models_draws_whole_models() -> None:
    """Two logs of each model, alike: half as many witnesses, so a wider interval; and never a certain one."""
    named = [("one", "steer_lag"), ("none_missing",)]
    cases = [case(k, *named[k // 2 % 2], row="start_b", model=f"m{k // 2}") for k in range(24)]
    shared, own = (
        score.row("b", cases),
        score.row("b", [one._replace(truth={**one.truth, "model": f"m{k}"}) for k, one in enumerate(cases)]),
    )
    assert (shared.models, shared.whole, own.models, own.whole) == (12, True, 24, False)
    wide, narrow = shared.figures["right"], own.figures["right"]
    assert narrow == share(12, 24) and wide.value == 0.5 and wide.n == 24
    assert wide.low is not None and narrow.low is not None and wide.low < narrow.low - 0.02
    assert shared.figures["wrong"] == share(0, 12)._replace(n=24), "all alike: Wilson, by models"
    assert score.row("b", cases) == shared, "the same whenever it is counted"
    one = [case(k, *named[k // 2 % 2], model=f"m{k // 2}") for k in range(24)]
    assert score.row("one", one).figures["right"] == share(12, 24) and score.row("one", one).models == 12


def test_models_of_two_runs_are_not_the_same() -> None:
    cases = [case(k, "none_missing", row="free", effects={}, model="m00")._replace(run=f"run{k % 2}") for k in range(4)]
    assert score.row("effect-free", cases).models == 2


def test_two_models_alike_say_no_more_than_their_logs() -> None:
    """Five of ten and six of ten: draws of the two differ by a tenth, logs by half."""
    hits, models = [True] * 5 + [False] * 5 + [True] * 6 + [False] * 4, ["a"] * 10 + ["b"] * 10
    assert share_by_models(hits, models) == share(11, 20)
    errors = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    plain = quantile(errors, 0.5)
    assert by_models(plain, errors, ["a"] * 6, lambda some: float(np.median(some))) == plain, (
        "one model: no draw differs"
    )


def test_outcomes_sum_to_a_hundred_percent() -> None:
    """Three thirds rounded are 99.9: one of them gets the tenth that is missing. All seven are figures, too."""
    row = score.row("one", [case(0, *ANSWERS[0]), case(1, *ANSWERS[1]), case(2, *ANSWERS[2])])
    parts = report.shares(row.outcomes)
    assert set(parts) == set(OUTCOMES) and sum(round(10 * one) for one in parts.values()) == 1000
    values = [row.figures[name].value for name in OUTCOMES]
    assert sum(one for one in values if one is not None) == pytest.approx(1.0) and None not in values


def test_the_page_and_the_pictures(tmp_path: Path) -> None:
    cases = [case(i, *answer) for i, answer in enumerate(ANSWERS)]
    cases += [case(9, "one", "steer_lag", row="limits", size=0.5)]
    rows, edges = score.table(cases), limits(cases)
    paths = report.write_report(tmp_path, rows, edges, score.false_names(cases), "dev:x")
    assert [path.name for path in paths] == ["table.md", "table.json", "outcomes.png", "limits.png"]
    page = (tmp_path / "table.md").read_text()
    assert "| one effect, detectable | 5 | 5 | 20.0 % | 20.0 % | 0.0 % | 20.0 % | 20.0 % | 20.0 % | 0.0 % |" in page
    data = json.loads((tmp_path / "table.json").read_text())
    assert data["rows"][0]["figures"]["right"]["n"] == 5 and data["wrong"][0]["number"] == 3
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in paths[2:])
