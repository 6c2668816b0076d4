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
from tunefree_hil.gap.diagnostics.residual_tests import LinkResidual
from tunefree_hil.gap.estimation.evidence import MIN_EVIDENCE_NATS
from tunefree_hil.gap.estimation.intervals import estimates_across_blocks
from tunefree_hil.gap.estimation.least_squares import FreeParameter
from tunefree_hil.gap.result_text import baseline_texts, reason_text, verdict_texts
from tunefree_hil.gap.selection.baseline_misfit import (
    BASELINE_KEY,
    NO_BASELINE,
    BaselineMisfit,
    baseline_of_model,
    card_entries,
)
from tunefree_hil.gap.selection.criteria import BASELINE
from tunefree_hil.gap.selection.reasons import Criterion, VerdictKind
from tunefree_hil.gap.selection.rejection import (
    EffectSplit,
    ExplainedTargets,
    drop_dependent_effects,
    find_residual_rejection,
    split_known_effects,
)
from tunefree_hil.gap.selection.verdict import Findings, decide_verdict
from tunefree_hil.learn.model_folder import plain_data

BROKEN = LinkResidual("yaw_rate", Link.REPORT_TO_MOTION, "rad/s", 0.2, 0.1, 0.2, 0.8, True)
STEP = weighed(steer_dead_time=spread(1.0))[0]
FOUND = fitted(DELAY)  # 0.1 s
VALUE, DEVIATION = estimates_across_blocks(FOUND, ALL)[DELAY.key]


def usual(delay_s: float, deviation: float = 0.001) -> BaselineMisfit:
    there = {"steer_dead_time": {"delay_s": (delay_s, deviation)}}
    return BaselineMisfit({"yaw_rate": 0.5}, there, frozenset({STEP.target}), there)


def rejection(
    before: list[LinkResidual],
    after: list[LinkResidual],
    left: dict[str, float],
    explained: dict[str, float],
    baseline: BaselineMisfit = NO_BASELINE,
) -> Criterion | None:
    reason = find_residual_rejection(before, after, ExplainedTargets(explained, left), baseline)
    return None if reason is None else reason.criterion


def test_a_model_that_comes_near_its_own_logs_takes_everything_for_news() -> None:
    assert split_known_effects([STEP], FOUND, NO_BASELINE, ALL) == EffectSplit([STEP])


def test_who_has_the_value_that_the_own_logs_gave_it_is_no_news_and_both_are_said() -> None:
    news, words = split_known_effects([STEP], FOUND, usual(VALUE + 0.5 * DEVIATION), ALL)
    assert news == []
    assert reason_text(words[0]).startswith("steer_dead_time is not new: delay_s 0.1, and 0.10")


@given(off=st.floats(-0.09, 0.4), deviation=st.floats(1e-4, 0.1))
def test_news_is_what_is_further_off_than_both_are_doubted(off: float, deviation: float) -> None:
    news, words = split_known_effects([STEP], FOUND, usual(VALUE + off, deviation), ALL)
    far = abs(off) > BASELINE.new_value_sigmas * np.hypot(DEVIATION, deviation)
    assert bool(news) == far and bool(words) != far


@given(alone=st.floats(-20.0, 60.0))
def test_who_shows_only_beside_what_is_no_news_is_no_name(alone: float) -> None:
    other = STEP._replace(name="yaw_rate_bias")
    news, words = drop_dependent_effects([other], [STEP, other], [STEP, other._replace(evidence=alone)])
    assert bool(news) == (alone > MIN_EVIDENCE_NATS) and bool(words) != bool(news)
    told = [reason_text(reason) for reason in words]
    assert not told or told == ["yaw_rate_bias shows only beside steer_dead_time, which is not new"]


def test_two_that_hide_each_other_stay_where_both_are_news() -> None:
    other, nothing = STEP._replace(name="yaw_rate_bias"), STEP._replace(evidence=-5.0)
    both = [STEP, other]
    assert drop_dependent_effects(both, both, [nothing, nothing._replace(name="yaw_rate_bias")]) == EffectSplit(both)


def test_what_explains_all_that_is_missed_is_named_be_it_news_or_not() -> None:
    for known in (usual(VALUE), usual(VALUE)._replace(effects={})):
        named, words = split_known_effects([STEP], FOUND, known, ALL, explained=True)
        assert named == [STEP] and words == split_known_effects([STEP], FOUND, known, ALL)[1] != ()


def test_whom_the_own_logs_could_not_show_is_no_news() -> None:
    news, words = split_known_effects([STEP], FOUND, usual(VALUE)._replace(effects={}), ALL)
    assert not news and words[0].criterion is Criterion.UNTESTED_IN_CALIBRATION


def test_where_the_model_came_near_its_own_logs_all_is_news_that_they_did_not_plainly_have() -> None:
    elsewhere = frozenset({"another signal"})
    for known in (usual(VALUE, 1.1 * VALUE / BASELINE.known_sigmas), usual(VALUE)._replace(effects={})):
        assert split_known_effects([STEP], FOUND, known._replace(broken=elsewhere), ALL) == EffectSplit([STEP])
    limit = STEP._replace(name="steer_rate_limit")
    rate = FreeParameter("steer_rate_limit.rate_radps", 0.1, 20.0, True, np.inf, -0.35, 1.35)
    at_it = fitted(rate, z=rate.u_from_value(6.9))
    endless = BaselineMisfit({}, {"steer_rate_limit": {"rate_radps": (6.9, 0.0)}}, elsewhere)
    assert split_known_effects([limit], at_it, endless, ALL) == EffectSplit([limit]), "the own logs say nothing of it"
    plainly = usual(VALUE, 0.9 * VALUE / BASELINE.known_sigmas)._replace(broken=elsewhere)
    news, words = split_known_effects([STEP], FOUND, plainly, ALL)
    assert news == [] and words[0].criterion is Criterion.KNOWN_TO_CALIBRATION


def test_what_is_missed_as_usual_speaks_against_nobody() -> None:
    was = BROKEN._replace(explainable_share=0.85)
    assert rejection([was], [BROKEN], {"yaw_rate": 0.9}, {"yaw_rate": 0.3})
    assert not rejection([was], [BROKEN], {"yaw_rate": 0.9}, {"yaw_rate": 0.3}, usual(0.1))
    more = BROKEN._replace(explainable_share=1.01 * BASELINE.max_misfit_factor * 0.5)
    assert rejection([more], [more], {"yaw_rate": 1.0}, {}, usual(0.1))
    assert not rejection([BROKEN], [BROKEN], {}, {"speed": 0.1}, usual(0.1))


def test_what_is_missed_beyond_the_usual_is_told_first() -> None:
    worse = BROKEN._replace(signal="rate_of_speed", explainable_share=0.3)
    within = decide_verdict(Findings([BROKEN], baseline=usual(0.1)))
    assert verdict_texts(within, {}) == ("yaw_rate is missed by 80.0%, as usual with this model",)
    found = decide_verdict(Findings([BROKEN, worse], baseline=usual(0.1)))
    assert found.kind is VerdictKind.NONE_OF_THESE and found.reasons[0].criterion is Criterion.UNEXPLAINED
    assert verdict_texts(found, {}) == ("rate_of_speed is missed by 30.0%, and no effect explains it",)


def test_words_are_of_what_is_missed_most() -> None:
    told = usual(0.1)._replace(misfit={"yaw_rate": 0.8, "brake": 0.1})
    words = "the model misses yaw_rate by 80% of the signal in its own calibration logs"
    assert baseline_texts(told) == (words,) and baseline_texts(NO_BASELINE) == () and card_entries(NO_BASELINE) == {}


def test_a_gain_that_the_own_logs_would_move_as_much_is_no_news() -> None:
    """Whichever pedal shows it: it is one force along the car."""
    known = NO_BASELINE._replace(inconsistent_gains={"throttle_gain.gain_frac": 2.0})
    found = {
        "throttle_gain.gain_frac": 2.0 * BASELINE.max_misfit_factor,
        "brake_gain.gain_frac": 1.6,
        "steer_gain.gain_frac": 1.6,
    }
    assert (
        known.excess_inconsistency(found) == {"steer_gain.gain_frac": 1.6}
        and NO_BASELINE.excess_inconsistency(found) == found
    )
    more = {"throttle_gain.gain_frac": 2.1 * BASELINE.max_misfit_factor}
    assert known.excess_inconsistency(more) == more


def test_what_was_missed_of_the_own_logs_too_speaks_against_no_name_elsewhere() -> None:
    known = NO_BASELINE._replace(misfit_unexplained={BROKEN.signal: BROKEN.misfit_share / 1.5})
    assert rejection([BROKEN], [BROKEN], {}, {"steer": 0.01}) is Criterion.LARGER_ELSEWHERE
    assert rejection([BROKEN], [BROKEN], {}, {"steer": 0.01}, known) is None
    less = NO_BASELINE._replace(
        misfit_unexplained={BROKEN.signal: BROKEN.misfit_share / (1.1 * BASELINE.max_misfit_factor)}
    )
    assert rejection([BROKEN], [BROKEN], {}, {"steer": 0.01}, less)
    left = {BROKEN.signal: 1.0}
    assert rejection([BROKEN], [BROKEN], left, {BROKEN.signal: 0.01}, known), "who works on it has to explain it"


def test_a_card_keeps_it_and_one_that_is_none_is_named(tmp_path: Path) -> None:
    nominal = load_model("mkz_nominal")
    assert baseline_of_model(nominal) == NO_BASELINE
    model = replace(nominal, folder=str(tmp_path), plant=replace(nominal.plant, card="card.json"))
    kept = usual(0.25)._replace(
        inconsistent_gains={"throttle_gain.gain_frac": 2.5}, misfit_unexplained={"rate_of_speed": 0.2}
    )
    endless = {**kept.effects, "steer_rate_limit": {"rate_radps": (np.inf, 0.1)}}
    (tmp_path / "card.json").write_text(json.dumps(plain_data(card_entries(kept._replace(effects=endless)))))
    assert baseline_of_model(model) == kept
    for much in ("much", "nan"):
        (tmp_path / "card.json").write_text(json.dumps({BASELINE_KEY: {"missed": {"yaw_rate": much}}}))
        with pytest.raises(InputError) as refused:
            baseline_of_model(model)
        assert refused.value.key == BASELINE_KEY and "card.json" in refused.value.file


LOUD_ONE = BROKEN._replace(explainable_share=0.04, burst_share=0.16, gross_share=0.0)


@pytest.mark.parametrize(
    ("own", "later", "as_usual"), [(0.0, 0.16, False), (0.12, 0.16, True), (0.12, 0.23, True), (0.12, 0.25, False)]
)
def test_moments_that_were_just_not_loud_in_the_own_logs_are_no_alarm_later(
    own: float, later: float, as_usual: bool
) -> None:
    """What is loud is broken from a bar on; on which side of it own logs were says little."""
    known = BaselineMisfit({"yaw_rate": 0.05}, {}, frozenset(), burst_share={"yaw_rate": own})
    one = LOUD_ONE._replace(burst_share=later)
    assert known.is_within(one) is as_usual and known.is_known(one) is as_usual
    found = rejection([one], [one], {"yaw_rate": 0.0}, {"yaw_rate": 0.1}, known)
    assert (found is Criterion.RESIDUAL_PEAK) is not as_usual
    more = one._replace(explainable_share=0.3, burst_share=0.0)
    assert not known.is_within(more), "of what could be explained there is more"


def test_what_is_missed_throughout_is_held_against_its_own_too() -> None:
    known = BaselineMisfit({"yaw_rate": 0.05}, {}, frozenset(), gross_share={"yaw_rate": 0.24})
    one = BROKEN._replace(explainable_share=0.04, gross_share=0.26)
    assert known.is_within(one) and not known.is_within(one._replace(gross_share=0.5))
    assert not known._replace(gross_share={}).is_within(one)


def test_loud_moments_of_the_own_logs_are_no_leave_for_what_could_be_explained() -> None:
    """A model that misses the moments of a signal, and little else of it: a tenfold share is news."""
    known = BaselineMisfit(
        {"yaw_rate": 0.71}, {}, frozenset(), burst_share={"yaw_rate": 0.71}, explainable_share={"yaw_rate": 0.04}
    )
    moments = BROKEN._replace(explainable_share=0.05, burst_share=0.8, gross_share=0.0)
    assert known.is_within(moments) and known.is_known(moments)
    tenfold = moments._replace(explainable_share=0.4)
    assert not known.is_within(tenfold) and not known.is_known(tenfold)
    assert known._replace(explainable_share={}).is_within(tenfold), "a card of before does not tell the two apart"
    little = known._replace(explainable_share={"yaw_rate": 0.0004})
    assert little.is_within(moments._replace(explainable_share=0.9 * moments.tolerated_share)), (
        "of so little no link is broken"
    )


def test_what_is_left_elsewhere_is_what_is_more_than_usual() -> None:
    """Moments that are missed as usual neither speak against a name nor are quoted."""
    known = BaselineMisfit(
        {"yaw_rate": 0.14}, {}, frozenset(), burst_share={"yaw_rate": 0.14}, explainable_share={"yaw_rate": 0.02}
    )
    elsewhere = BROKEN._replace(explainable_share=0.05, burst_share=0.27, gross_share=0.0)
    assert not known.is_within(elsewhere)
    assert rejection([elsewhere], [elsewhere], {"yaw_rate": 1.0}, {"speed": 0.1}, known) is None
    says = rejection([elsewhere], [elsewhere], {"yaw_rate": 1.0}, {"speed": 0.04}, known)
    assert says is Criterion.LARGER_ELSEWHERE
