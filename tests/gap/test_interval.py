"""Intervals of effects: as wide as blocks differ, as the fit allows and as the calibration leaves open."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import stdtrit

from tunefree_hil.gap.interval import deviations, values_of
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
    by = 0.5 * stdtrit(BLOCKS - 1, 0.975) / np.sqrt(BLOCKS * 400.0 + 2.0 * np.pi)
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
    suspect = doubted(Suspect("x", (free,), ()), [Nuisance(free.key, free.neutral, sigma)])
    name, _, parameter = free.key.partition(".")
    open_, sure = (values_of(name, fitted(one, curve=1e8, z=0.7), ALL)[parameter] for one in (suspect.free[0], free))
    share = open_.value if free.neutral else 1.0
    assert sure.high - sure.low < 0.1 * least
    assert open_.high - open_.value == pytest.approx(stdtrit(BLOCKS - 1, 0.975) * least * share, rel=0.01)


def test_beside_a_latency_the_doubt_is_its_clocks() -> None:
    late = Free("ins_latency.delay_s", 0.01, 0.6, False, 0.0, 0.0, 1.35)
    assert doubted(Suspect("x", (late,), ()), [Nuisance("clock.ins_s", 0.0, 0.004)]).free[0].doubt == 0.004
