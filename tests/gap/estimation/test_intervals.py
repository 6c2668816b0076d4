"""Intervals of effects: as wide as blocks differ, as the fit allows and as the calibration leaves open."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import stdtrit

from tunefree_hil.gap.estimation.candidates import Suspect, doubted
from tunefree_hil.gap.estimation.intervals import (
    FORM,
    UNSTEADY,
    WAVERS,
    apart,
    deviations,
    unsteady,
    values_of,
    wavering,
)
from tunefree_hil.gap.estimation.least_squares import Fitted, Free, Sums
from tunefree_hil.gap.estimation.noise import Colour
from tunefree_hil.gap.estimation.nuisance import Nuisance

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
    return Fitted("x", (free.key,), np.array([z]), (free,), values, np.zeros((1, 1)), {"steer": sums}, {})


ALL, ONE_DAY = np.arange(BLOCKS), np.zeros(BLOCKS)


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


def scattered(differ: float) -> float:
    """What blocks that disagree by so many of their deviations disagree beyond noise: of 12, and about their mean."""
    return (BLOCKS / (BLOCKS - 1) * differ**2 - 1.0) ** 0.5


def test_an_effect_that_is_there_is_the_same_in_all_blocks() -> None:
    """At z = 0.2, with a curvature of 400 a block: a block knows it by 0.05, a quarter of the way from neutral."""
    late = "steer_dead_time"
    assert wavering(fitted(DELAY, differ=1.2), late, ALL, ONE_DAY).share == 0.0, "chance"
    share = scattered(3.0) * 0.05 / 0.2
    assert wavering(fitted(DELAY, differ=3.0), late, ALL, ONE_DAY).share == pytest.approx(share, rel=0.01)
    sharp = fitted(DELAY, differ=3.0, curve=4e6)
    assert wavering(sharp, late, ALL, ONE_DAY).share == 0.0, "half a thousandth of a second is the bus's own"
    size = DELAY._replace(key="brake_drag.force_n")
    assert 0.0 < wavering(fitted(size, differ=3.0, curve=4e6), "brake_drag", ALL, ONE_DAY).share < WAVERS, "too little"


@pytest.mark.parametrize("gain", [0.7, 1.08, 1.55])
def test_an_effect_may_waver_as_much_as_the_same_number_does_in_a_model_that_lacks_nothing(gain: float) -> None:
    """Two hundredths, from another form of the pedal, are much of a gain of 8 %, and no sign against it."""
    plain = Free("throttle_gain.gain_frac", 0.4, 2.0, True, 1.0, -0.35, 1.35)
    (free,) = doubted(Suspect("x", (plain,), ()), [Nuisance(plain.key, 1.0, 0.05, drift=0.02)], {}).free
    curve = 4e6
    known = curve**-0.5 * np.log(2.0 / 0.4)  # by a block, of itself
    for sigmas, says in ((1.1, False), (UNSTEADY * 1.2, True)):
        differ = float(np.hypot(sigmas * 0.02 / known, 1.0)) * ((BLOCKS - 1) / BLOCKS) ** 0.5
        one = fitted(free, differ=differ, curve=curve, z=free.place(gain))
        assert (wavering(one, "throttle_gain", ALL, ONE_DAY).share > WAVERS) == says


def test_a_car_whose_model_has_no_drag_drifts_as_any_other() -> None:
    drag = Free("aero_drag.drag_area_m2", 0.03, 3.0, True, 0.0, -0.35, 1.35)
    assert doubted(Suspect("x", (drag,), ()), [], {}).free[0].drift == 0.03
    assert doubted(Suspect("x", (DELAY,), ()), [], {}).free[0].drift == 0.0


def test_what_all_blocks_say_alike_is_no_wavering() -> None:
    """A number that is held at an end of its range is pulled the same way by all blocks; they may know it unequally."""
    one = fitted(DELAY, differ=0.5)
    sums = one.sums["steer"]
    curve = sums.curve * np.linspace(0.2, 5.0, BLOCKS)[:, None, None]
    pulled = sums._replace(slope=sums.slope + 0.5 * curve[:, :, 0], curve=curve)
    assert wavering(one._replace(sums={"steer": pulled}), "steer_dead_time", ALL, ONE_DAY).share == 0.0


def test_blocks_that_know_little_are_asked_as_far_as_they_know() -> None:
    """One block knows the effect well, the others hardly, and they agree: their chance is larger, and is no wavering.
    Where they do not agree it is seen, though the one that knows most says nothing of it.
    """
    chance = np.random.default_rng(3)
    curve = np.full(BLOCKS, 4.0)
    curve[0] = 4e4
    one = fitted(DELAY)
    for loud, says in ((1.0, False), (6.0, True)):
        pull = loud * chance.standard_normal(BLOCKS) * np.sqrt(curve)
        pull[0] = 0.0
        sums = one.sums["steer"]._replace(slope=pull[:, None], curve=curve[:, None, None])
        found = wavering(one._replace(sums={"steer": sums}), "steer_dead_time", ALL, ONE_DAY).share
        assert (found > 0.0) == says


def test_blocks_of_other_days_need_not_say_the_same() -> None:
    """Two drives, each steady, that are far apart."""
    one, days = fitted(DELAY, differ=0.5), np.repeat([0, 1], BLOCKS // 2)
    sums = one.sums["steer"]
    shifted = sums._replace(slope=sums.slope + np.where(days == 0, 200.0, -200.0)[:, None])
    twice = one._replace(sums={"steer": shifted})
    assert (
        wavering(twice, "steer_dead_time", ALL, days).share
        == 0.0
        < wavering(twice, "steer_dead_time", ALL, ONE_DAY).share
    )
    graded = twice._replace(keys=("grade.grade_rad",), free=())
    assert apart(graded, ALL, days) == {} and apart(graded, ALL, ONE_DAY) == {}, "half a deviation is what it may be"
    far = graded._replace(sums={"steer": shifted._replace(slope=10.0 * shifted.slope)})
    assert apart(far, ALL, days) == {"grade.grade_rad": pytest.approx(5.0 * 2.0**0.5, rel=0.05)}
    assert apart(far, ALL, ONE_DAY) == {} and apart(far._replace(keys=("brake_gain.gain_frac",)), ALL, days) == {}


@pytest.mark.parametrize("sigma", [0.02, 0.1])
def test_a_gain_that_recalibration_moves_from_block_to_block_is_told(sigma: float) -> None:
    """A nuisance counts in deviations of its prior, here of a car that a calibration knows well or not; a block knows
    it by a thousandth. How steady it has to be does not hang on that.
    """
    key = "brake_gain.gain_frac"
    curve = (1e3 * sigma) ** 2

    def moved(by: float) -> dict[str, float]:
        one = fitted(DELAY, differ=by / 1e-3 * ((BLOCKS - 1) / BLOCKS) ** 0.5, curve=curve)
        return unsteady(one._replace(keys=(key,), free=()), ALL, ONE_DAY, {key: sigma})

    assert moved(1e-3) == {} and moved(0.02 * 1.3) == {}
    assert moved(0.02 * 2.0) == {key: pytest.approx(2.0, rel=0.01)} and UNSTEADY < 2.0
    assert unsteady(fitted(DELAY, differ=40.0), ALL, ONE_DAY, {}) == {}, "no gain"


def test_a_limit_whose_neutral_is_without_end_has_an_interval() -> None:
    limit = Free("throttle_rate_limit.rate_per_s", 0.05, 3.0, True, np.inf, -0.35, 1.35)
    value = values_of("throttle_rate_limit", fitted(limit, z=0.5), ALL)["rate_per_s"]
    assert 0.05 < value.low < value.value < value.high < 3.0
