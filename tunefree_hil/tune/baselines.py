"""Baselines that a tuned result is compared with: manual gains, and gains from textbook rules.

The shipped baselines are complete vectors in `control/parameters.py`. This module selects those of a vehicle and the
first trial of a study, and computes the vector `rule_based` from a data sheet, without any drive.

`manual_gains` in vehicle.toml says whether the shipped gains were made for the vehicle. Where they were not, its manual
gains are `rule_based`; those of the other vehicle are scored too, with look-ahead 0, and called borrowed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.control.parameters import BASELINES, study_values
from tunefree_hil.tune.loop_margins import LateralLoop, Weights, reduce_to_margins
from tunefree_hil.tune.space import Axis, Space

FIRST_TRIAL = "mrac_on"  # with look-ahead 0
RULE_BASED = "rule_based"
BORROWED = {"borrowed": "as_shipped", "borrowed_mrac_on": "mrac_on"}  # gains of another vehicle, with the shipped name

OUTER_LOOP_RATIO = 5.0  # time-scale separation of a cascade
# Lag from the pedals to the force at the road. Reports contain the pedals, not the torque, so it is in no model's
# actuators. The usual assumption for a speed loop (Rajamani, Vehicle Dynamics and Control, adaptive cruise control).
DRIVE_LINE_LAG_S = 0.5
MAY_BE_ZERO = ("drive_dead_time_s", "drive_lag_s", "loop_delay_s")


class BrysonLimits(NamedTuple):
    """Largest errors of Bryson's rule: the thresholds of the published peak metrics (docs/reference/grading.md)."""

    lateral_m: float = 0.5
    lateral_rate_mps: float = 0.5
    heading_rad: float = 0.5236
    heading_rate_radps: float = 0.5236


class RuleInputs(NamedTuple):
    """Inputs of `compute_rule_based`. The field names appear in error messages.

    steer_lag_s: First-order lag of the steering actuator.
    drive_dead_time_s, drive_lag_s: Of the slower one of throttle and brake.
    loop_delay_s: Report delay plus command delay of the bench.
    steer_limit_rad: At the steering wheel.
    speed_mps: Highest planned speed, at which the lateral acceleration limits the steering angle.
    """

    steer_lag_s: float
    drive_dead_time_s: float
    drive_lag_s: float
    loop_delay_s: float
    steer_limit_rad: float
    steer_ratio: float
    wheelbase_m: float
    lateral_accel_mps2: float
    speed_mps: float


def list_manual_vectors(rule: Mapping[str, float], *, shipped: bool) -> dict[str, dict[str, float]]:
    """The baselines of a vehicle by name, not clipped to a search space.

    Args:
        rule: Its `rule_based` vector.
        shipped: Whether the shipped gains were made for this vehicle (`manual_gains = "as_shipped"` in vehicle.toml).
    """
    if shipped:
        return {**{name: dict(values) for name, values in BASELINES.items()}, RULE_BASED: dict(rule)}
    return {RULE_BASED: dict(rule), **{name: dict(BASELINES[source]) for name, source in BORROWED.items()}}


def select_first_baseline(vectors: Mapping[str, Mapping[str, float]]) -> Mapping[str, float]:
    """The baseline that is the first trial: the shipped gains with MRAC on, else `rule_based`."""
    return vectors.get(FIRST_TRIAL, vectors[RULE_BASED])


def make_first_trial(space: Space, baseline: Mapping[str, float] | None = None) -> dict[str, float]:
    """Parameters of slot 0: the baseline clipped to the space; the middle of the range where it has no value.

    Without `baseline`: the shipped gains with MRAC on.
    """
    manual = BASELINES[FIRST_TRIAL] if baseline is None else baseline
    return space.clip({axis.name: manual.get(axis.name, _middle(axis)) for axis in space.axes})


def list_further_starts(
    space: Space, vectors: Mapping[str, Mapping[str, float]], first: Mapping[str, float]
) -> list[dict[str, float]]:
    """All baselines clipped to the space, without `first` and without equal ones."""
    starts: list[dict[str, float]] = []
    for vector in vectors.values():
        start = make_first_trial(space, vector)
        if start != first and start not in starts:
            starts.append(start)
    return starts


def compute_rule_based(inputs: RuleInputs, loop: LateralLoop) -> dict[str, float]:
    """Compute a complete vector from textbook rules, not clipped to a search space.

    Speed: SIMC (Skogestad 2003, J. Process Control 13, 291-309). With a correct open-loop map the speed is the integral
    of the command after dead time and two lags, of the pedals and of the drive line. The half rule takes dead time +
    smaller lag + half of the larger one as delay theta; tau_c = theta gives kp = 1 / (2 theta) and ki = kp / (8 theta),
    at all speeds. Station: the same rule for the outer loop, proportional only, five times slower. Q: Bryson's rule
    (Bryson and Ho 1975), q = (largest input / largest error)^2 at R = 1, reduced until the loop with its dead time and
    lag keeps a phase margin of 45 degrees and twice its delay at every speed. The reference model of MRAC is as fast as
    the actuator; for p there is no rule, it keeps the manual product.

    Args:
        inputs: Numbers of the vehicle.
        loop: Lateral loop, for the margins.

    Raises:
        InputError: An input is not above 0.
    """
    for name, value in inputs._asdict().items():
        if not (math.isfinite(value) and value >= 0.0) or (value == 0.0 and name not in MAY_BE_ZERO):
            hint = "give it in vehicle.toml or model.toml"
            raise InputError(f"rule_based needs {name}, not {value}", code="bad_rule_input", key=name, hint=hint)
    lateral = reduce_to_margins(loop, _bryson_weights(inputs))
    names = ("lqr.q1", "lqr.q2", "lqr.q3", "lqr.q4")
    weights = dict(zip(names, lateral, strict=True))
    return {**study_values(), **_speed_gains(inputs), **weights, "mrac.t_ref_s": inputs.steer_lag_s}


def _speed_gains(inputs: RuleInputs) -> dict[str, float]:
    smaller_s, larger_s = sorted((inputs.drive_lag_s, DRIVE_LINE_LAG_S))
    delay_s = inputs.drive_dead_time_s + inputs.loop_delay_s + smaller_s + 0.5 * larger_s
    closed_s = delay_s  # tau_c: the fastest that SIMC recommends
    kp = 1.0 / (closed_s + delay_s)
    ki = kp / (4.0 * (closed_s + delay_s))
    outer_s = OUTER_LOOP_RATIO * closed_s + delay_s + 0.5 * closed_s  # lag of the inner loop by the half rule
    gains = {"speed.kp_low": kp, "speed.ki_low": ki, "speed.kp_high": kp, "speed.ki_high": ki}
    return {"station.kp": 1.0 / outer_s, **gains}


def _bryson_weights(inputs: RuleInputs) -> Weights:
    """Bryson's rule; the largest input is the steering stop, or the angle that the lateral acceleration allows."""
    stop_rad = inputs.steer_limit_rad / inputs.steer_ratio
    grip_rad = math.atan(inputs.lateral_accel_mps2 * inputs.wheelbase_m / (inputs.speed_mps * inputs.speed_mps))
    largest_rad, limits = min(stop_rad, grip_rad), BrysonLimits()
    return (
        (largest_rad / limits.lateral_m) ** 2,
        (largest_rad / limits.lateral_rate_mps) ** 2,
        (largest_rad / limits.heading_rad) ** 2,
        (largest_rad / limits.heading_rate_radps) ** 2,
    )


def _middle(axis: Axis) -> float:
    return math.sqrt(axis.low * axis.high) if axis.log else 0.5 * (axis.low + axis.high)
