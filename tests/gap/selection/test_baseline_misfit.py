"""What a model misses as usual: it speaks against nobody, and who has the value that he always had is no news."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from tests.gap.estimation.test_intervals import ALL, DELAY, fitted
from tests.gap.selection.test_criteria import spread, weighed
from tunefree_hil.base.contracts import Link
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_model
from tunefree_hil.gap.diagnostics.residual_tests import Looked
from tunefree_hil.gap.estimation.evidence import LEAST_NATS
from tunefree_hil.gap.estimation.intervals import across
from tunefree_hil.gap.estimation.least_squares import Free
from tunefree_hil.gap.selection.baseline_misfit import (
    HAD,
    KEY,
    NEWS,
    NOTHING,
    TIMES,
    Usual,
    as_data,
    parted,
    seen_alone,
    usual_of,
    usual_words,
)
from tunefree_hil.gap.selection.verdict import not_it, verdict_of
from tunefree_hil.learn.model_folder import plain

BROKEN = Looked("yaw_rate", Link.REPORT_TO_MOTION, "rad/s", 0.2, 0.1, 0.2, 0.8, True)
STEP = weighed(steer_dead_time=spread(1.0))[0]
FOUND = fitted(DELAY)  # 0.1 s
VALUE, DEVIATION = across(FOUND, ALL)[DELAY.key]


def usual(delay_s: float, deviation: float = 0.001) -> Usual:
    there = {"steer_dead_time": {"delay_s": (delay_s, deviation)}}
    return Usual({"yaw_rate": 0.5}, there, frozenset({STEP.target}), there)


def test_a_model_that_comes_near_its_own_logs_takes_everything_for_news() -> None:
    assert parted([STEP], FOUND, NOTHING, ALL) == ([STEP], ())


def test_who_has_the_value_that_the_own_logs_gave_it_is_no_news_and_both_are_said() -> None:
    news, words = parted([STEP], FOUND, usual(VALUE + 0.5 * DEVIATION), ALL)
    assert news == []
    assert words[0].startswith("steer_dead_time is no news: delay_s 0.1, and 0.10")


@given(off=st.floats(-0.09, 0.4), deviation=st.floats(1e-4, 0.1))
def test_news_is_what_is_further_off_than_both_are_doubted(off: float, deviation: float) -> None:
    news, words = parted([STEP], FOUND, usual(VALUE + off, deviation), ALL)
    far = abs(off) > NEWS * np.hypot(DEVIATION, deviation)
    assert bool(news) == far and bool(words) != far


@given(alone=st.floats(-20.0, 60.0))
def test_who_shows_only_beside_what_is_no_news_is_no_name(alone: float) -> None:
    other = STEP._replace(name="yaw_rate_bias")
    news, words = seen_alone([other], [STEP, other], [STEP, other._replace(evidence=alone)])
    assert bool(news) == (alone > LEAST_NATS) and bool(words) != bool(news)
    assert not words or words == ("yaw_rate_bias shows only beside steer_dead_time, which is not put in",)


def test_two_that_hide_each_other_stay_where_both_are_news() -> None:
    other, nothing = STEP._replace(name="yaw_rate_bias"), STEP._replace(evidence=-5.0)
    both = [STEP, other]
    assert seen_alone(both, both, [nothing, nothing._replace(name="yaw_rate_bias")]) == (both, ())


def test_what_explains_all_that_is_missed_is_named_be_it_news_or_not() -> None:
    for known in (usual(VALUE), usual(VALUE)._replace(effects={})):
        named, words = parted([STEP], FOUND, known, ALL, explained=True)
        assert named == [STEP] and words == parted([STEP], FOUND, known, ALL)[1] != ()


def test_whom_the_own_logs_could_not_show_is_no_news() -> None:
    news, words = parted([STEP], FOUND, usual(VALUE)._replace(effects={}), ALL)
    assert not news and "do not hold what would show it" in words[0]


def test_where_the_model_came_near_its_own_logs_all_is_news_that_they_did_not_plainly_have() -> None:
    elsewhere = frozenset({"another signal"})
    for known in (usual(VALUE, 1.1 * VALUE / HAD), usual(VALUE)._replace(effects={})):
        assert parted([STEP], FOUND, known._replace(broken=elsewhere), ALL) == ([STEP], ())
    limit = STEP._replace(name="steer_rate_limit")
    rate = Free("steer_rate_limit.rate_radps", 0.1, 20.0, True, np.inf, -0.35, 1.35)
    at_it = fitted(rate, z=rate.place(6.9))
    endless = Usual({}, {"steer_rate_limit": {"rate_radps": (6.9, 0.0)}}, elsewhere)
    assert parted([limit], at_it, endless, ALL) == ([limit], ()), "the own logs say nothing of it"
    plainly = usual(VALUE, 0.9 * VALUE / HAD)._replace(broken=elsewhere)
    news, words = parted([STEP], FOUND, plainly, ALL)
    assert news == [] and words[0].startswith("steer_dead_time is no news")


def test_what_is_missed_as_usual_speaks_against_nobody() -> None:
    was = BROKEN._replace(share=0.85)
    assert not_it([was], [BROKEN], {"yaw_rate": 0.9}, {"yaw_rate": 0.3})
    assert not not_it([was], [BROKEN], {"yaw_rate": 0.9}, {"yaw_rate": 0.3}, usual(0.1))
    more = BROKEN._replace(share=1.01 * TIMES * 0.5)
    assert not_it([more], [more], {"yaw_rate": 1.0}, {}, usual(0.1))
    assert not not_it([BROKEN], [BROKEN], {}, {"speed": 0.1}, usual(0.1))


def test_what_is_missed_beyond_the_usual_is_told_first() -> None:
    worse = BROKEN._replace(signal="rate_of_speed", share=0.3)
    _, _, words = verdict_of([], [], [BROKEN], "", {}, (), {}, usual(0.1))
    assert words == ("yaw_rate is missed by 80.0%, as usual with this model",)
    said = verdict_of([], [], [BROKEN, worse], "", {}, (), {}, usual(0.1))
    assert said == ("none_of_these", (), ("rate_of_speed is missed by 30.0%, and no effect explains it",))


def test_words_are_of_what_is_missed_most() -> None:
    told = usual(0.1)._replace(missed={"yaw_rate": 0.8, "brake": 0.1})
    words = "the model misses yaw_rate by 80% of the signal in the very logs that it was made from"
    assert usual_words(told) == (words,) and usual_words(NOTHING) == () and as_data(NOTHING) == {}


def test_a_gain_that_the_own_logs_would_move_as_much_is_no_news() -> None:
    """Whichever pedal shows it: it is one force along the car."""
    known = NOTHING._replace(restless={"throttle_gain.gain_frac": 2.0})
    found = {"throttle_gain.gain_frac": 2.0 * TIMES, "brake_gain.gain_frac": 1.6, "steer_gain.gain_frac": 1.6}
    assert known.more_restless(found) == {"steer_gain.gain_frac": 1.6} and NOTHING.more_restless(found) == found
    more = {"throttle_gain.gain_frac": 2.1 * TIMES}
    assert known.more_restless(more) == more


def test_what_was_missed_of_the_own_logs_too_speaks_against_no_name_elsewhere() -> None:
    known = NOTHING._replace(own_missed={BROKEN.signal: BROKEN.amount / 1.5})
    assert not_it([BROKEN], [BROKEN], {}, {"steer": 0.01}, NOTHING).startswith("explains less than what is left")
    assert not_it([BROKEN], [BROKEN], {}, {"steer": 0.01}, known) == ""
    less = NOTHING._replace(own_missed={BROKEN.signal: BROKEN.amount / (1.1 * TIMES)})
    assert not_it([BROKEN], [BROKEN], {}, {"steer": 0.01}, less)
    left = {BROKEN.signal: 1.0}
    assert not_it([BROKEN], [BROKEN], left, {BROKEN.signal: 0.01}, known), "who works on it has to explain it"


def test_a_card_keeps_it_and_one_that_is_none_is_named(tmp_path: Path) -> None:
    nominal = load_model("mkz_nominal")
    assert usual_of(nominal) == NOTHING
    model = replace(nominal, folder=str(tmp_path), plant=replace(nominal.plant, card="card.json"))
    kept = usual(0.25)._replace(restless={"throttle_gain.gain_frac": 2.5}, own_missed={"rate_of_speed": 0.2})
    endless = {**kept.effects, "steer_rate_limit": {"rate_radps": (np.inf, 0.1)}}
    (tmp_path / "card.json").write_text(json.dumps(plain(as_data(kept._replace(effects=endless)))))
    assert usual_of(model) == kept
    for much in ("much", "nan"):
        (tmp_path / "card.json").write_text(json.dumps({KEY: {"missed": {"yaw_rate": much}}}))
        with pytest.raises(InputError) as refused:
            usual_of(model)
        assert refused.value.key == KEY and "card.json" in refused.value.file


LOUD_ONE = BROKEN._replace(share=0.04, loud=0.16, gross=0.0)


@pytest.mark.parametrize(
    ("own", "later", "as_usual"), [(0.0, 0.16, False), (0.12, 0.16, True), (0.12, 0.23, True), (0.12, 0.25, False)]
)
def test_moments_that_were_just_not_loud_in_the_own_logs_are_no_alarm_later(
    own: float, later: float, as_usual: bool
) -> None:
    """What is loud is broken from a bar on; on which side of it own logs were says little."""
    known = Usual({"yaw_rate": 0.05}, {}, frozenset(), loud={"yaw_rate": own})
    one = LOUD_ONE._replace(loud=later)
    assert known.as_usual(one) is as_usual and known.was_there(one) is as_usual
    still = not_it([one], [one], {"yaw_rate": 0.0}, {"yaw_rate": 0.1}, known)
    assert ("still" in still) is not as_usual
    more = one._replace(share=0.3, loud=0.0)
    assert not known.as_usual(more), "of what could be explained there is more"


def test_what_is_missed_throughout_is_held_against_its_own_too() -> None:
    known = Usual({"yaw_rate": 0.05}, {}, frozenset(), gross={"yaw_rate": 0.24})
    one = BROKEN._replace(share=0.04, gross=0.26)
    assert known.as_usual(one) and not known.as_usual(one._replace(gross=0.5))
    assert not known._replace(gross={}).as_usual(one)


def test_loud_moments_of_the_own_logs_are_no_leave_for_what_could_be_explained() -> None:
    """A model that misses the moments of a signal, and little else of it: a tenfold share is news."""
    known = Usual({"yaw_rate": 0.71}, {}, frozenset(), loud={"yaw_rate": 0.71}, share={"yaw_rate": 0.04})
    moments = BROKEN._replace(share=0.05, loud=0.8, gross=0.0)
    assert known.as_usual(moments) and known.was_there(moments)
    tenfold = moments._replace(share=0.4)
    assert not known.as_usual(tenfold) and not known.was_there(tenfold)
    assert known._replace(share={}).as_usual(tenfold), "a card of before does not tell the two apart"
    little = known._replace(share={"yaw_rate": 0.0004})
    assert little.as_usual(moments._replace(share=0.9 * moments.visible)), "of so little no link is broken"


def test_what_is_left_elsewhere_is_what_is_more_than_usual() -> None:
    """Moments that are missed as usual neither speak against a name nor are quoted."""
    known = Usual({"yaw_rate": 0.14}, {}, frozenset(), loud={"yaw_rate": 0.14}, share={"yaw_rate": 0.02})
    elsewhere = BROKEN._replace(share=0.05, loud=0.27, gross=0.0)
    assert not known.as_usual(elsewhere)
    assert not_it([elsewhere], [elsewhere], {"yaw_rate": 1.0}, {"speed": 0.1}, known) == ""
    says = not_it([elsewhere], [elsewhere], {"yaw_rate": 1.0}, {"speed": 0.04}, known)
    assert "yaw_rate is missed by 5.0%" in says
