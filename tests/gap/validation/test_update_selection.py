"""What recalibration moved stays as it was where free runs over the blocks that choose come no nearer by it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.gap.made_answer import LATE_S, VEHICLE, late_drive, made_model
from tunefree_hil.config.schema import EffectSpec
from tunefree_hil.gap.measured.blocks import HOLDOUT, cut_blocks
from tunefree_hil.gap.measured.chain import build_measured_drive
from tunefree_hil.gap.validation.block_runs import DIVERGED_SQUARE, POSITION, BlockErrors
from tunefree_hil.gap.validation.update_selection import (
    ACROSS,
    ALONG,
    SENSORS,
    error_gains,
    is_improvement,
    select_updates,
    update_groups,
)

STEERING = {"actuator.steer.dead_time_s": 0.9 * LATE_S}  # helps
PULL = {"plant.drive_force_n": -0.06, "rolling_resistance.extra_frac": 0.2}  # spoils
LATE = EffectSpec(name="steer_dead_time", params={"delay_s": LATE_S})


def run(**errors: float) -> BlockErrors:
    """RMS by signal, the same in three blocks of ten rows."""
    counts = {name: np.full(3, 10.0) for name in errors}
    return BlockErrors({"": {name: np.full(3, 10.0 * one * one) for name, one in errors.items()}}, counts, {}, ())


def test_every_number_that_was_moved_is_in_one_group() -> None:
    values = {
        "grade.grade_rad": 0.001, "throttle_gain.gain_frac": 1.01, "plant.creep_force_n": 0.1,
        "steer_gain.gain_frac": 0.99, "actuator.brake.lag_s": 0.1, "actuator.steer.lag_s": 0.1,
        "plant.wheelbase_m": 0.01, "side_wind.force_n": 4.0, "speed_scale.scale_frac": 1.001,
        "accel_bias.bias_mps2": 0.01, "clock.ins_s": 0.001, "brake_gain.gain_frac": 1.0, "steer_lag.tau_s": 0.1,
    }  # fmt: skip
    found = update_groups(values, {"steer_lag"})
    assert list(found) == [ALONG, ACROSS, SENSORS]
    assert found[SENSORS] == {"speed_scale.scale_frac", "accel_bias.bias_mps2"}
    assert found[ACROSS] == {
        "steer_gain.gain_frac", "actuator.steer.lag_s", "plant.wheelbase_m", "side_wind.force_n",
    }  # fmt: skip
    assert len(found[ALONG]) == 4, "a clock, a neutral value and what was found are in none"


def test_errors_count_by_their_shares_and_hardly_below_the_floor() -> None:
    floors = {"speed": 1e-6, "steer": 1e-6}
    gains = error_gains(run(speed=1.0, steer=5.0), run(speed=2.0, steer=5.0), floors)
    assert gains == pytest.approx(np.full(3, math.log(2.0)))
    spoilt = error_gains(run(speed=0.0322, steer=0.375), run(speed=0.0291, steer=0.375), floors)
    assert spoilt == pytest.approx(np.full(3, math.log(0.0291 / 0.0322)), rel=1e-3), "whatever else is far off"
    floors = {"speed": 0.1}
    assert np.abs(error_gains(run(speed=0.01), run(speed=0.02), floors)).max() < 0.02
    assert not error_gains(run(**{POSITION: 1.0}), run(**{POSITION: 9.0}), {POSITION: 0.1}).any()
    far = math.sqrt(DIVERGED_SQUARE)  # what a proof says of a run that came to no number
    wild = error_gains(run(speed=far), run(speed=1.0), floors)
    assert wild.max() < -10.0 and np.array_equal(error_gains(run(speed=1.0), run(speed=far), floors), -wild)


@pytest.mark.parametrize(("gains", "clear"), [
    ((2.0, 1.4), True), ((0.3, 0.3), False), ((0.1,) * 5, False), ((0.1,) * 40, True), ((3.0, -1.0, 3.0), False),
    ((-2.0, -1.4), False),
])  # fmt: skip
def test_what_is_not_above_chance_does_not_pay(gains: tuple[float, ...], clear: bool) -> None:
    assert is_improvement(np.array(gains)) is clear


@pytest.mark.parametrize("blocks", [2, 5, 20])
def test_chance_alone_seldom_pays(blocks: int) -> None:
    drawn = 0.4 * np.random.default_rng(1).standard_normal((5000, blocks))
    assert 0.0 < np.mean([is_improvement(one) for one in drawn]) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(("values", "found", "left"), [
    ({**STEERING, **PULL}, [], (ALONG,)),
    ({**PULL, "actuator.steer.dead_time_s": 0.03, "steer_dead_time.delay_s": LATE_S}, [LATE], (ALONG, ACROSS)),
    ({"steer_dead_time.delay_s": LATE_S}, [LATE], ()),
])  # fmt: skip
def test_what_spoils_a_signal_stays_as_it_was(
    values: dict[str, float], found: list[EffectSpec], left: tuple[str, ...]
) -> None:
    paid = select_updates(made_model(), VEHICLE, values, found, [build_measured_drive(late_drive(), VEHICLE)])
    assert paid.reverted_groups == left
    kept = {key for key in values if not (key in PULL or (ACROSS in left and key.startswith("actuator.steer")))}
    assert set(paid.values) == (kept if left else set(values))


@pytest.mark.slow
def test_the_blocks_that_prove_are_not_looked_at() -> None:
    drive, name = late_drive(), "report.yaw_rate_radps"
    blocks = cut_blocks([drive.n_rows], drive.dt_s)
    spoilt = drive.fields[name].copy()
    for b in np.flatnonzero(blocks.roles == HOLDOUT):
        spoilt[blocks.begins[b] : blocks.ends[b]] += 5.0
    other = drive._replace(fields={**drive.fields, name: spoilt})
    was, now = (
        select_updates(made_model(), VEHICLE, {**STEERING, **PULL}, [], [build_measured_drive(one, VEHICLE)])
        for one in (drive, other)
    )
    assert was == now and was.reverted_groups == (ALONG,)
