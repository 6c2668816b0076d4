"""--fail-if: what is understood, what is refused in one message, and what holds."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import InputError
from tunefree_hil.grade.checks import Condition, check_condition, parse_condition

SCENARIOS = ("u_turn", "side-pass")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("lateral_err_peak > +5%", ("lateral_err_peak", "", ">", 0.05, True)),
        ("lateral_err_peak>+5%", ("lateral_err_peak", "", ">", 0.05, True)),
        ("score@u_turn >= 0.4", ("score", "u_turn", ">=", 0.4, False)),
        ("score @ side-pass <= -10 %", ("score", "side-pass", "<=", -0.1, True)),
        (" replans > 0 ", ("replans", "", ">", 0.0, False)),
        ("steer_rate_rms < 1e-3", ("steer_rate_rms", "", "<", 0.001, False)),
        ("failed > +0.5", ("failed", "", ">", 0.5, False)),
    ],
)
def test_conditions(text: str, expected: tuple[str, str, str, float, bool]) -> None:
    found = parse_condition(text, SCENARIOS)
    assert found[1:4] == expected[:3] and found.relative is expected[4]
    assert found.limit == pytest.approx(expected[3])


def test_a_misspelt_metric_gets_a_guess() -> None:
    with pytest.raises(InputError) as caught:
        parse_condition("lateral_peak > 1", ["tiny"])
    assert caught.value.hint.startswith("Did you mean lateral_err_peak")
    with pytest.raises(InputError) as caught:
        parse_condition("xyz > 1", ["tiny"])
    assert caught.value.hint.startswith("one of score, ")


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "not a condition"),
        ("lateral_err_peak", "not a condition"),
        ("lateral_err_peak = 3", "not a condition"),
        ("lateral_err_peak > ", "not a condition"),
        ("lateral_err_peak > 5 m", "not a condition"),
        ("lateral > 3", "unknown metric 'lateral'"),
        ("score@left_turn > 3", "not all runs drove: 'left_turn'"),
        ("score > 5%", "no sign before 5%"),
        ("score > much", "'much', which is not a number"),
        ("score > nan", "not a number"),
        ("score > +x%", "no sign"),
    ],
)
def test_a_bad_one_is_one_message(text: str, part: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_condition(text, SCENARIOS)
    assert part in caught.value.message and caught.value.key == "--fail-if" and caught.value.hint


def holds(text: str, *values: float | None) -> list[bool]:
    named = {f"run{i}": value for i, value in enumerate(values)}
    return [one.holds for one in check_condition(parse_condition(text, SCENARIOS), named)]


def test_the_first_run_is_what_the_others_are_held_against() -> None:
    assert holds("score > +5%", 1.0, 1.04, 1.06) == [False, True]
    assert holds("score > -10%", 1.0, 0.95, 0.85) == [True, False]
    assert holds("score > 0.9", 1.0, 0.8, 0.9, 0.91) == [False, False, True]
    assert holds("score >= 0.9", 1.0, 0.9) == [True]
    assert holds("replans > +5%", 0.0, 0.0, 1.0) == [False, True]


def test_what_cannot_be_told_fails() -> None:
    assert holds("score > +5%", 1.0, None) == [True]
    assert holds("score > +5%", None, 1.0) == [True]
    assert holds("score > 2", None, 1.0) == [False]
    (finding,) = check_condition(parse_condition("score > 1", ()), {"a": 1.0, "b": None})
    assert "is not available in b" in finding.words


@given(st.floats(0.0, 10.0), st.floats(0.0, 10.0), st.integers(-99, 99), st.sampled_from([">", ">=", "<", "<="]))
def test_a_condition_or_its_opposite_holds(first: float, other: float, percent: int, op: str) -> None:
    opposite = {">": "<=", "<=": ">", "<": ">=", ">=": "<"}[op]
    one, two = (parse_condition(f"score {word} {percent:+d}%", ()) for word in (op, opposite))
    values = {"a": first, "b": other}
    assert check_condition(one, values)[0].holds is not check_condition(two, values)[0].holds
    assert isinstance(one, Condition)
