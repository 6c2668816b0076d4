"""The first trial, and the rules (Skogestad's half rule and SIMC, Bryson's weights)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tunefree_hil.base.contracts import Tunable
from tunefree_hil.base.errors import InputError
from tunefree_hil.control.contract import VehicleConstants
from tunefree_hil.control.parameters import BASELINES, NAMES, check_complete, round32
from tunefree_hil.tune.baselines import (
    DRIVE_LINE_LAG_S,
    RuleInputs,
    compute_rule_based,
    list_further_starts,
    list_manual_vectors,
    make_first_trial,
    select_first_baseline,
)
from tunefree_hil.tune.loop_margins import LateralLoop, keeps_margins
from tunefree_hil.tune.space import make_space, resolve_space

MKZ = RuleInputs(
    steer_lag_s=0.12,
    drive_dead_time_s=0.1,
    drive_lag_s=0.2,
    loop_delay_s=0.02,
    steer_limit_rad=8.2,
    steer_ratio=16.0,
    wheelbase_m=2.8448,
    lateral_accel_mps2=5.0,
    speed_mps=8.0,
)
LOOP = LateralLoop(VehicleConstants(), VehicleConstants(), 0.147, 0.07, 30.0, 0.01)


def test_the_first_trial_is_manual_with_mrac_clipped() -> None:
    space = resolve_space("complete", [])
    first = make_first_trial(space)
    manual = BASELINES["mrac_on"]
    by_name = {axis.name: axis for axis in space.axes}
    assert first == space.clip(first)
    assert first["lqr.q2"] == by_name["lqr.q2"].low and first["lqr.q4"] == by_name["lqr.q4"].low
    inside = [name for name in space.names if name not in ("lqr.q2", "lqr.q4", "mrac.p")]
    assert [first[name] for name in inside] == [round32(manual[name]) for name in inside]


def test_a_parameter_without_a_manual_value_starts_in_the_middle() -> None:
    space = make_space([Tunable("mine.a", "1", 0.01, 1.0), Tunable("mine.b", "1", 0.0, 4.0, "linear")])
    assert make_first_trial(space) == pytest.approx({"mine.a": 0.1, "mine.b": 2.0})


def test_only_the_vehicle_that_gains_were_shipped_for_has_them() -> None:
    rule = compute_rule_based(MKZ, LOOP)
    own, other = list_manual_vectors(rule, shipped=True), list_manual_vectors(rule, shipped=False)
    assert list(own) == [*BASELINES, "rule_based"] and own["rule_based"] == other["rule_based"] == rule
    assert not set(other) & set(BASELINES) and all(name == "rule_based" or "borrowed" in name for name in other)
    assert other["borrowed_mrac_on"] == BASELINES["mrac_on"] and other["borrowed"]["look_ahead_m"] == 0.0
    assert select_first_baseline(own) == BASELINES["mrac_on"] and select_first_baseline(other) == rule


def test_a_study_can_open_with_rule_based() -> None:
    space = resolve_space("complete", [])
    rule = compute_rule_based(MKZ, LOOP)
    first = make_first_trial(space, rule)
    assert first == space.clip({name: rule[name] for name in space.names}) != make_first_trial(space)


def test_of_a_baseline_only_what_lies_outside_the_box_is_moved() -> None:
    manual = BASELINES["as_shipped"]
    inside = resolve_space("complete", []).clip(manual)
    assert [name for name, value in inside.items() if value != pytest.approx(manual[name])] == ["lqr.q2", "lqr.q4"]


def test_rules_give_a_complete_vector_that_scales_as_it_should() -> None:
    values = compute_rule_based(MKZ, LOOP)
    assert tuple(check_complete(values)) == NAMES
    quick = compute_rule_based(MKZ._replace(drive_dead_time_s=0.04, drive_lag_s=0.1, loop_delay_s=0.01), LOOP)
    slow_s, quick_s = 0.12 + 0.2 + 0.5 * DRIVE_LINE_LAG_S, 0.05 + 0.1 + 0.5 * DRIVE_LINE_LAG_S
    assert values["speed.kp_low"] == pytest.approx(0.5 / slow_s)
    for name, power in (("speed.kp_low", 1), ("speed.ki_high", 2), ("station.kp", 1)):
        assert quick[name] == pytest.approx(values[name] * (slow_s / quick_s) ** power)
    assert compute_rule_based(MKZ._replace(drive_lag_s=2.0), LOOP)["speed.kp_low"] == pytest.approx(0.5 / 1.62)
    assert values["mrac.t_ref_s"] == 0.12


def test_q_is_brysons_where_the_loop_bears_it() -> None:
    """A loop of nearly no delay, and slow: nothing is taken off."""
    quick = LOOP._replace(dead_time_s=0.005, lag_s=0.005, top_speed_mps=3.0)
    values = compute_rule_based(MKZ._replace(lateral_accel_mps2=1.0), quick)
    angle_rad = math.atan(1.0 * MKZ.wheelbase_m / MKZ.speed_mps**2)
    assert values["lqr.q1"] == values["lqr.q2"] == pytest.approx((angle_rad / 0.5) ** 2)
    assert values["lqr.q3"] == values["lqr.q4"] == pytest.approx((angle_rad / 0.5236) ** 2)


@pytest.mark.parametrize("dead_time_s", [0.1, 0.25])
def test_q_leaves_the_loop_its_margins(dead_time_s: float) -> None:
    loop = LOOP._replace(dead_time_s=dead_time_s)
    values = compute_rule_based(MKZ, loop)
    weights = (values["lqr.q1"], values["lqr.q2"], values["lqr.q3"], values["lqr.q4"])
    assert keeps_margins(loop, weights)
    assert values["lqr.q1"] / values["lqr.q3"] == pytest.approx((0.5236 / 0.5) ** 2)
    assert values["lqr.q2"] <= values["lqr.q1"] < 0.1


def closed_loop(values: dict[str, float], seconds: float) -> np.ndarray:
    """An integrator behind dead time and the lags of pedals and drive line, started 1 m behind.

    Columns: station error, speed.
    """
    dt_s, delay = 0.001, 120
    queue = [0.0] * delay
    station_m, speed_mps, pedal, force, integral = 1.0, 0.0, 0.0, 0.0, 0.0
    rows = []
    for _ in range(int(seconds / dt_s)):
        wish = -speed_mps + values["station.kp"] * station_m
        integral += values["speed.ki_low"] * wish * dt_s
        queue.append(values["speed.kp_low"] * wish + integral)
        pedal += (queue.pop(0) - pedal) * dt_s / MKZ.drive_lag_s
        force += (pedal - force) * dt_s / DRIVE_LINE_LAG_S
        speed_mps += force * dt_s
        station_m -= speed_mps * dt_s
        rows.append((station_m, speed_mps))
    return np.array(rows)


def test_the_rules_close_a_loop_that_is_stable_and_calm() -> None:
    rows = closed_loop(compute_rule_based(MKZ, LOOP), 30.0)
    assert np.all(np.abs(rows[-1]) < 0.01)
    assert rows[:, 0].min() > -0.35  # overshoot of the station
    assert not np.all(np.abs(closed_loop({**compute_rule_based(MKZ, LOOP), "speed.kp_low": 8.0}, 30.0)[-1]) < 0.01)


@pytest.mark.parametrize("change", [{"steer_lag_s": 0.0}, {"speed_mps": -1.0}, {"steer_ratio": math.nan}])
def test_rules_without_their_numbers_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(InputError) as caught:
        compute_rule_based(MKZ._replace(**change), LOOP)
    assert caught.value.key == next(iter(change))


def test_further_starts_are_the_other_sets_once_each() -> None:
    space = resolve_space("complete", [])
    vectors = list_manual_vectors(compute_rule_based(MKZ, LOOP), shipped=True)
    first = make_first_trial(space, select_first_baseline(vectors))
    starts = list_further_starts(space, vectors, first)
    assert starts == [make_first_trial(space, vectors["rule_based"])], "of the others only switches differ"
    assert all(space.clip(start) == start for start in starts)
    assert list_further_starts(space, {"mine": vectors["mrac_on"]}, first) == []
