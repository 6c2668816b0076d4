"""Intervals of effects: from the scatter of blocks, the fit and the doubt of the calibration."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import stdtrit

from tunefree_hil.gap.estimation.candidates import Candidate, add_parameter_sigmas
from tunefree_hil.gap.estimation.intervals import (
    CRITERIA,
    block_inconsistency,
    estimate_parameters,
    inconsistent_daily_effects,
    inconsistent_gains,
    standard_deviations,
)
from tunefree_hil.gap.estimation.least_squares import Fit, FreeParameter, NormalEquations
from tunefree_hil.gap.estimation.noise import NoiseModel
from tunefree_hil.gap.estimation.nuisance import Nuisance

BLOCKS, ROWS = 12, 200
DELAY = FreeParameter("steer_dead_time.delay_s", 0.0, 0.5, False, 0.0, 0.0, 1.35)


def fitted(free: FreeParameter, differ: float = 0.0, curve: float = 400.0, z: float = 0.2, proof: int = 0) -> Fit:
    """An effect alone. differ: scatter of its blocks, in their deviations; proof: further blocks that contradict."""
    chance = np.random.default_rng(1)
    pulls = chance.standard_normal(BLOCKS)
    pulls = differ * np.sqrt(curve) * (pulls - pulls.mean()) / pulls.std()
    pulls = np.concatenate([pulls, np.full(proof, 1e4)])
    count = BLOCKS + proof
    sums = NormalEquations(
        np.array([0]),
        np.ones(count),
        pulls[:, None],
        np.full((count, 1, 1), curve),
        np.full(count, ROWS),
        NoiseModel(np.array([1.0]), 1.0, 1.0),
    )
    values = {free.key: free.value_from_u(z)}
    return Fit("x", (free.key,), np.array([z]), (free,), values, np.zeros((1, 1)), {"steer": sums}, {})


ALL, ONE_DAY = np.arange(BLOCKS), np.zeros(BLOCKS)


def test_consistent_blocks_give_the_deviation_of_the_fit() -> None:
    assert standard_deviations(fitted(DELAY), ALL)[0] == pytest.approx((BLOCKS * 400.0) ** -0.5, rel=0.01)


def test_inconsistent_blocks_make_it_wider() -> None:
    wide, narrow = (
        standard_deviations(fitted(DELAY, differ=3.0), ALL)[0],
        standard_deviations(fitted(DELAY, differ=0.2), ALL)[0],
    )
    assert wide == pytest.approx(3.0 * (BLOCKS * 400.0) ** -0.5 * np.sqrt(BLOCKS / (BLOCKS - 1)), rel=0.02)
    assert narrow == pytest.approx((BLOCKS * 400.0) ** -0.5, rel=0.01)


def test_holdout_blocks_are_not_used() -> None:
    assert standard_deviations(fitted(DELAY, proof=3), ALL)[0] == standard_deviations(fitted(DELAY), ALL)[0]


def test_an_undetermined_parameter_has_a_wide_interval() -> None:
    value = estimate_parameters("steer_dead_time", fitted(DELAY, curve=0.0), ALL)["delay_s"]
    assert value.low == 0.0 and value.high > 0.4 and value.unit == "s"


def test_an_interval_is_from_students_t_with_the_degrees_of_the_blocks() -> None:
    value = estimate_parameters("steer_dead_time", fitted(DELAY), ALL)["delay_s"]
    by = (
        0.5
        * stdtrit(BLOCKS - 1, 0.975)
        * np.hypot(1.0 / np.sqrt(BLOCKS * 400.0 + 2.0 * np.pi), CRITERIA.form_share * 0.2)
    )
    assert (value.value, value.low, value.high) == pytest.approx((0.1, 0.1 - by, 0.1 + by))


@pytest.mark.parametrize(
    ("free", "sigma", "least"),
    [
        (FreeParameter("brake_gain.gain_frac", 0.4, 2.0, True, 1.0, -0.35, 1.35), 0.02, 0.02),
        (FreeParameter("aero_drag.drag_area_m2", 0.03, 3.0, True, 0.0, -0.35, 1.35), 0.03, 0.03),
        (FreeParameter("grade.grade_rad", -0.12, 0.12, False, 0.0, -0.35, 1.35), 0.0007, 0.0007),
    ],
)
def test_the_doubt_of_the_calibration_adds_to_the_interval(free: FreeParameter, sigma: float, least: float) -> None:
    suspect = add_parameter_sigmas(Candidate("x", (free,), ()), [Nuisance(free.key, free.neutral, sigma)], {})
    name, _, parameter = free.key.partition(".")
    open_, sure = (
        estimate_parameters(name, fitted(one, curve=1e8, z=0.7), ALL)[parameter] for one in (suspect.free[0], free)
    )
    share = open_.value if free.neutral else 1.0
    doubt = stdtrit(BLOCKS - 1, 0.975) * least * share
    assert open_.high - open_.value == pytest.approx(np.hypot(sure.high - sure.value, doubt), rel=0.01)


def test_no_interval_is_narrower_than_the_doubt_of_the_form() -> None:
    value = estimate_parameters("steer_dead_time", fitted(DELAY, curve=1e12), ALL)["delay_s"]
    assert value.high - value.value == pytest.approx(stdtrit(BLOCKS - 1, 0.975) * CRITERIA.form_share * 0.1, rel=0.01)


def test_a_latency_has_the_doubt_of_its_clock() -> None:
    late = FreeParameter("ins_latency.delay_s", 0.01, 0.6, False, 0.0, 0.0, 1.35)
    assert (
        add_parameter_sigmas(Candidate("x", (late,), ()), [Nuisance("clock.ins_s", 0.0, 0.004)], {})
        .free[0]
        .calibration_sigma
        == 0.004
    )


def test_a_parameter_that_scales_a_constant_has_its_doubt() -> None:
    free = FreeParameter("rolling_resistance.extra_frac", -0.8, 4.0, False, 0.0, -0.03, 1.35)
    suspect = add_parameter_sigmas(Candidate("x", (free,), ()), [], {"rolling_frac": 0.2, "drag_area_m2": 0.5})
    value = estimate_parameters("rolling_resistance", fitted(suspect.free[0], curve=1e8, z=0.5), ALL)["extra_frac"]
    assert value.high - value.value == pytest.approx(stdtrit(BLOCKS - 1, 0.975) * 0.2 * 1.6, rel=0.01)


def scattered(differ: float) -> float:
    """Scatter beyond noise of 12 blocks that differ by so many of their deviations, about their mean."""
    return (BLOCKS / (BLOCKS - 1) * differ**2 - 1.0) ** 0.5


def test_an_effect_that_exists_is_the_same_in_all_blocks() -> None:
    """At z = 0.2, with a curvature of 400 a block: its deviation is 0.05, a quarter of the distance from neutral."""
    late = "steer_dead_time"
    assert block_inconsistency(fitted(DELAY, differ=1.2), late, ALL, ONE_DAY).share == 0.0, "chance"
    share = scattered(3.0) * 0.05 / 0.2
    assert block_inconsistency(fitted(DELAY, differ=3.0), late, ALL, ONE_DAY).share == pytest.approx(share, rel=0.01)
    sharp = fitted(DELAY, differ=3.0, curve=4e6)
    assert block_inconsistency(sharp, late, ALL, ONE_DAY).share == 0.0, "half a millisecond is jitter of the bus"
    size = DELAY._replace(key="brake_drag.force_n")
    assert (
        0.0
        < block_inconsistency(fitted(size, differ=3.0, curve=4e6), "brake_drag", ALL, ONE_DAY).share
        < CRITERIA.max_inconsistency_share
    ), "too little"


@pytest.mark.parametrize("gain", [0.7, 1.08, 1.55])
def test_an_effect_may_scatter_as_much_as_it_drifts_in_a_model_that_lacks_nothing(gain: float) -> None:
    """2 %, from another form of the pedal, are a large part of a gain of 8 %, and do not contradict it."""
    plain = FreeParameter("throttle_gain.gain_frac", 0.4, 2.0, True, 1.0, -0.35, 1.35)
    (free,) = add_parameter_sigmas(
        Candidate("x", (plain,), ()), [Nuisance(plain.key, 1.0, 0.05, drift_sigma=0.02)], {}
    ).free
    curve = 4e6
    known = curve**-0.5 * np.log(2.0 / 0.4)  # by a block, of itself
    for sigmas, says in ((1.1, False), (CRITERIA.max_drift_ratio * 1.2, True)):
        differ = float(np.hypot(sigmas * 0.02 / known, 1.0)) * ((BLOCKS - 1) / BLOCKS) ** 0.5
        one = fitted(free, differ=differ, curve=curve, z=free.u_from_value(gain))
        assert (
            block_inconsistency(one, "throttle_gain", ALL, ONE_DAY).share > CRITERIA.max_inconsistency_share
        ) == says


def test_a_car_whose_model_has_no_drag_drifts_as_any_other() -> None:
    drag = FreeParameter("aero_drag.drag_area_m2", 0.03, 3.0, True, 0.0, -0.35, 1.35)
    assert add_parameter_sigmas(Candidate("x", (drag,), ()), [], {}).free[0].drift_sigma == 0.03
    assert add_parameter_sigmas(Candidate("x", (DELAY,), ()), [], {}).free[0].drift_sigma == 0.0


def test_what_all_blocks_have_in_common_is_no_scatter() -> None:
    """A parameter at its bound has gradients of equal sign in all blocks, though of unequal information."""
    one = fitted(DELAY, differ=0.5)
    sums = one.equations["steer"]
    curve = sums.curvature * np.linspace(0.2, 5.0, BLOCKS)[:, None, None]
    pulled = sums._replace(gradient=sums.gradient + 0.5 * curve[:, :, 0], curvature=curve)
    assert block_inconsistency(one._replace(equations={"steer": pulled}), "steer_dead_time", ALL, ONE_DAY).share == 0.0


def test_blocks_are_weighted_by_their_information() -> None:
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
        sums = one.equations["steer"]._replace(gradient=pull[:, None], curvature=curve[:, None, None])
        found = block_inconsistency(one._replace(equations={"steer": sums}), "steer_dead_time", ALL, ONE_DAY).share
        assert (found > 0.0) == says


def test_drives_of_different_days_may_differ() -> None:
    """Two drives, each steady, that are far apart."""
    one, days = fitted(DELAY, differ=0.5), np.repeat([0, 1], BLOCKS // 2)
    sums = one.equations["steer"]
    shifted = sums._replace(gradient=sums.gradient + np.where(days == 0, 200.0, -200.0)[:, None])
    twice = one._replace(equations={"steer": shifted})
    assert (
        block_inconsistency(twice, "steer_dead_time", ALL, days).share
        == 0.0
        < block_inconsistency(twice, "steer_dead_time", ALL, ONE_DAY).share
    )
    graded = twice._replace(keys=("grade.grade_rad",), free=())
    assert (
        inconsistent_daily_effects(graded, ALL, days) == {} and inconsistent_daily_effects(graded, ALL, ONE_DAY) == {}
    ), "half a deviation is what it may be"
    far = graded._replace(equations={"steer": shifted._replace(gradient=10.0 * shifted.gradient)})
    assert inconsistent_daily_effects(far, ALL, days) == {"grade.grade_rad": pytest.approx(5.0 * 2.0**0.5, rel=0.05)}
    assert (
        inconsistent_daily_effects(far, ALL, ONE_DAY) == {}
        and inconsistent_daily_effects(far._replace(keys=("brake_gain.gain_frac",)), ALL, days) == {}
    )


@pytest.mark.parametrize("sigma", [0.02, 0.1])
def test_a_recalibrated_gain_that_scatters_between_blocks_is_reported(sigma: float) -> None:
    """A nuisance counts in deviations of its prior, here of a car that a calibration knows well or not; a block knows
    it by a thousandth. How steady it has to be does not hang on that.
    """
    key = "brake_gain.gain_frac"
    curve = (1e3 * sigma) ** 2

    def moved(by: float) -> dict[str, float]:
        one = fitted(DELAY, differ=by / 1e-3 * ((BLOCKS - 1) / BLOCKS) ** 0.5, curve=curve)
        return inconsistent_gains(one._replace(keys=(key,), free=()), ALL, ONE_DAY, {key: sigma})

    assert moved(1e-3) == {} and moved(0.02 * 1.3) == {}
    assert moved(0.02 * 2.0) == {key: pytest.approx(2.0, rel=0.01)} and CRITERIA.max_drift_ratio < 2.0
    assert inconsistent_gains(fitted(DELAY, differ=40.0), ALL, ONE_DAY, {}) == {}, "no gain"


def test_a_limit_whose_neutral_value_is_infinite_has_an_interval() -> None:
    limit = FreeParameter("throttle_rate_limit.rate_per_s", 0.05, 3.0, True, np.inf, -0.35, 1.35)
    value = estimate_parameters("throttle_rate_limit", fitted(limit, z=0.5), ALL)["rate_per_s"]
    assert 0.05 < value.low < value.value < value.high < 3.0
