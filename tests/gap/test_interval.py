"""Intervals of effects: as wide as blocks differ, as the fit allows and as the calibration leaves open."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import stdtrit

from tunefree_hil.gap.interval import FORM, UNSTEADY, WAVERS, deviations, unsteady, values_of, wavering
from tunefree_hil.gap.noise import Colour
from tunefree_hil.gap.null import Nuisance
from tunefree_hil.gap.problem import Fitted, Free, Sums
from tunefree_hil.gap.suspects import Suspect, doubted

BLOCKS, ROWS = 12, 200
DELAY = Free("steer_dead_time.delay_s", 0.0, 0.5, False, 0.0, 0.0, 1.35)


def fitted(free: Free, differ: float = 0.0, curve: float = 400.0, z: float = 0.2, proof: int = 0) -> Fitted:
    """An effect alone. differ: by how many deviations of a block its blocks disagree; proof: more blocks, at odds."""
    chance = np.random.default_rng(1)
    pulls = chance.standard_normal(BLOCKS)
    pulls = differ * np.sqrt(curve) * (pulls - pulls.mean()) / pulls.std()
    pulls = np.concatenate([pulls, np.full(proof, 1e4)])
    count = BLOCKS + proof
    sums = Sums(np.array([0]), np.ones(count), pulls[:, None], np.full((count, 1, 1), curve), np.full(count, ROWS),
                Colour(np.array([1.0]), 1.0, 1.0))  # fmt: skip
    values = {free.key: free.value(z)}
    return Fitted("x", (free.key,), np.array([z]), (free,), values, {"steer": sums}, {})


ALL = np.arange(BLOCKS)


def test_blocks_that_agree_are_trusted_as_far_as_the_fit_is() -> None:
    assert deviations(fitted(DELAY), ALL)[0] == pytest.approx((BLOCKS * 400.0) ** -0.5, rel=0.01)


def test_blocks_that_disagree_make_it_wider() -> None:
    wide, narrow = deviations(fitted(DELAY, differ=3.0), ALL)[0], deviations(fitted(DELAY, differ=0.2), ALL)[0]
    assert wide == pytest.approx(3.0 * (BLOCKS * 400.0) ** -0.5 * np.sqrt(BLOCKS / (BLOCKS - 1)), rel=0.02)
    assert narrow == pytest.approx((BLOCKS * 400.0) ** -0.5, rel=0.01)


def test_blocks_that_prove_are_not_looked_at() -> None:
    assert deviations(fitted(DELAY, proof=3), ALL)[0] == deviations(fitted(DELAY), ALL)[0]


def test_a_parameter_that_the_logs_do_not_feel_has_a_wide_interval_and_none_of_no_width() -> None:
    value = values_of("steer_dead_time", fitted(DELAY, curve=0.0), ALL)["delay_s"]
    assert value.low == 0.0 and value.high > 0.4 and value.unit == "s"


def test_an_interval_is_of_student_with_as_many_degrees_as_blocks_allow() -> None:
    value = values_of("steer_dead_time", fitted(DELAY), ALL)["delay_s"]
    by = 0.5 * stdtrit(BLOCKS - 1, 0.975) * np.hypot(1.0 / np.sqrt(BLOCKS * 400.0 + 2.0 * np.pi), FORM * 0.2)
    assert (value.value, value.low, value.high) == pytest.approx((0.1, 0.1 - by, 0.1 + by))


@pytest.mark.parametrize(
    ("free", "sigma", "least"),
    [
        (Free("brake_gain.gain_frac", 0.4, 2.0, True, 1.0, -0.35, 1.35), 0.02, 0.02),
        (Free("aero_drag.drag_area_m2", 0.03, 3.0, True, 0.0, -0.35, 1.35), 0.03, 0.03),
        (Free("grade.grade_rad", -0.12, 0.12, False, 0.0, -0.35, 1.35), 0.0007, 0.0007),
    ],
)
def test_what_a_calibration_does_not_know_is_not_known_of_the_effect(free: Free, sigma: float, least: float) -> None:
    suspect = doubted(Suspect("x", (free,), ()), [Nuisance(free.key, free.neutral, sigma)], {})
    name, _, parameter = free.key.partition(".")
    open_, sure = (values_of(name, fitted(one, curve=1e8, z=0.7), ALL)[parameter] for one in (suspect.free[0], free))
    share = open_.value if free.neutral else 1.0
    doubt = stdtrit(BLOCKS - 1, 0.975) * least * share
    assert open_.high - open_.value == pytest.approx(np.hypot(sure.high - sure.value, doubt), rel=0.01)


def test_nothing_is_known_better_than_an_effects_own_form() -> None:
    value = values_of("steer_dead_time", fitted(DELAY, curve=1e12), ALL)["delay_s"]
    assert value.high - value.value == pytest.approx(stdtrit(BLOCKS - 1, 0.975) * FORM * 0.1, rel=0.01)


def test_beside_a_latency_the_doubt_is_its_clocks() -> None:
    late = Free("ins_latency.delay_s", 0.01, 0.6, False, 0.0, 0.0, 1.35)
    assert doubted(Suspect("x", (late,), ()), [Nuisance("clock.ins_s", 0.0, 0.004)], {}).free[0].doubt == 0.004


def test_what_counts_by_a_constant_of_the_model_is_known_as_well_as_that() -> None:
    free = Free("rolling_resistance.extra_frac", -0.8, 4.0, False, 0.0, -0.03, 1.35)
    suspect = doubted(Suspect("x", (free,), ()), [], {"rolling_frac": 0.2, "drag_area_m2": 0.5})
    value = values_of("rolling_resistance", fitted(suspect.free[0], curve=1e8, z=0.5), ALL)["extra_frac"]
    assert value.high - value.value == pytest.approx(stdtrit(BLOCKS - 1, 0.975) * 0.2 * 1.6, rel=0.01)


def test_an_effect_that_is_there_is_the_same_in_all_blocks() -> None:
    """At z = 0.2, with a curvature of 400 a block: a block knows it by 0.05, a quarter of the way from neutral."""
    assert wavering(fitted(DELAY, differ=1.2), "steer_dead_time", ALL) == 0.0, "chance"
    assert wavering(fitted(DELAY, differ=3.0), "steer_dead_time", ALL) == pytest.approx(8.0**0.5 * 0.05 / 0.2, rel=0.01)
    sharp = fitted(DELAY, differ=3.0, curve=4e6)
    assert wavering(sharp, "steer_dead_time", ALL) == 0.0, "half a thousandth of a second is the bus's own"
    gain = DELAY._replace(key="grade.grade_rad")
    assert 0.0 < wavering(fitted(gain, differ=3.0, curve=4e6), "grade", ALL) < WAVERS, "clear, and too little to matter"


def test_a_gain_that_recalibration_moves_from_block_to_block_is_told() -> None:
    """A nuisance counts in deviations of its prior; a block knows it by 0.05 of them."""

    def moved(differ: float) -> Fitted:
        one = fitted(DELAY, differ=differ)
        return one._replace(keys=("throttle_gain.gain_frac",), free=())

    assert unsteady(moved(1.0), ALL) == {} and unsteady(moved(10.0), ALL) == {}
    assert unsteady(moved(40.0), ALL) == {"throttle_gain.gain_frac": pytest.approx(2.0, rel=0.01)} and UNSTEADY < 2.0
    assert unsteady(fitted(DELAY, differ=40.0), ALL) == {}, "no gain"


def test_a_limit_whose_neutral_is_without_end_has_an_interval() -> None:
    limit = Free("throttle_rate_limit.rate_per_s", 0.05, 3.0, True, np.inf, -0.35, 1.35)
    value = values_of("throttle_rate_limit", fitted(limit, z=0.5), ALL)["rate_per_s"]
    assert 0.05 < value.low < value.value < value.high < 3.0
