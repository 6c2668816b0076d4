"""What a tuned result is held against: the manual gains, and gains that a textbook gives (interfaces 7).

The shipped baselines stand in `control/parameters.py` as complete vectors. Here: which of them a vehicle has, which one
opens a study, and the vector `rule_based`, worked out from a data sheet without any drive.

A vehicle folder says with `manual_gains` whether the shipped gains are its own. Where they are not, its manual gains
are `rule_based`; those of the other vehicle are still scored, look-ahead 0, and called what they are: borrowed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.control.parameters import BASELINES, study_values
from tunefree_hil.tune.space import Axis, Space

FIRST_TRIAL = "mrac_on"  # with look-ahead 0 (interfaces 7)
RULE_BASED = "rule_based"
BORROWED = {"borrowed": "as_shipped", "borrowed_mrac_on": "mrac_on"}  # another vehicle's gains, under names that say so

# What Bryson's rule may let go wrong: the thresholds of the published peak metrics (apollo_facts 6.1).
LARGEST_LATERAL_M, LARGEST_LATERAL_RATE_MPS = 0.5, 0.5
LARGEST_HEADING_RAD, LARGEST_HEADING_RATE_RADPS = 0.5236, 0.5236
OUTER_SLOWER = 5.0  # time-scale separation of a cascade


class RuleInputs(NamedTuple):
    """The plain numbers that `rule_based` needs.

    steer_lag_s: first-order lag of the steering actuator (model folder). drive_*: the slower of throttle and brake.
    loop_delay_s: report plus command delay of the bench. steer_limit_rad: at the steering *wheel*. speed_mps: the
    planned speed of the drives, which bounds how much steering the lateral acceleration allows.
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


def complete(searched: Mapping[str, float]) -> dict[str, float]:
    """The vector that is sent for a trial: the searched values over those that a study fixes (MRAC on, gamma 1)."""
    return {**study_values(), **searched}


def manual_vectors(rule: Mapping[str, float], *, shipped: bool) -> dict[str, dict[str, float]]:
    """The baselines of a vehicle by name, as they are, unclipped. rule: its `rule_based` vector.

    shipped: the shipped gains were made for this vehicle (`manual_gains = "as_shipped"` in vehicle.toml).
    """
    if shipped:
        return {**{name: dict(values) for name, values in BASELINES.items()}, RULE_BASED: dict(rule)}
    return {RULE_BASED: dict(rule), **{name: dict(BASELINES[source]) for name, source in BORROWED.items()}}


def opening(vectors: Mapping[str, Mapping[str, float]]) -> Mapping[str, float]:
    """Of a vehicle's baselines the one that opens a study: the shipped gains with MRAC on, else `rule_based`."""
    return vectors.get(FIRST_TRIAL, vectors[RULE_BASED])


def first_trial(space: Space, opens: Mapping[str, float] | None = None) -> dict[str, float]:
    """Slot 0 of a study: the manual gains with MRAC on (or `opens`), clipped; the middle of a box that has none."""
    manual = BASELINES[FIRST_TRIAL] if opens is None else opens
    return space.fit({axis.name: manual.get(axis.name, _middle(axis)) for axis in space.axes})


def lag_of_order_2_s(natural_hz: float, damping: float) -> float:
    """The lag of first order with the same slope at low frequency as a second-order one: 2 damping / natural."""
    return 2.0 * damping / (2.0 * math.pi * natural_hz)


def rule_based(inputs: RuleInputs) -> dict[str, float]:
    """A complete vector from rules alone; unclipped. Raises InputError for an input that is not above 0.

    Speed: SIMC (Skogestad 2003, J. Process Control 13, 291-309). With a right open-loop map the speed is the integral
    of the command after dead time and lag; the half rule takes dead time + lag / 2 as delay theta, and tau_c = theta
    gives kp = 1 / (2 theta), ki = kp / (8 theta), at all speeds. Station: the same rule for the loop around it, P only,
    five times slower. Q: Bryson's rule (Bryson and Ho 1975), q = (largest input / largest error)^2 at R = 1. The
    reference of MRAC is as quick as the actuator itself; there is no rule for p, it stays at the manual product.
    """
    for name, value in inputs._asdict().items():
        if not (math.isfinite(value) and value >= 0.0) or (value == 0.0 and name not in _MAY_BE_ZERO):
            hint = "give it in vehicle.toml or model.toml"
            raise InputError(f"rule_based needs {name}, not {value}", code="bad_rule_input", key=name, hint=hint)
    return {**study_values(), **_speed_gains(inputs), **_lateral_weights(inputs), "mrac.t_ref_s": inputs.steer_lag_s}


_MAY_BE_ZERO = ("drive_dead_time_s", "drive_lag_s", "loop_delay_s")


def _speed_gains(inputs: RuleInputs) -> dict[str, float]:
    delay_s = inputs.drive_dead_time_s + inputs.loop_delay_s + 0.5 * inputs.drive_lag_s
    if delay_s <= 0.0:
        raise InputError("rule_based needs a delay in the drive channel", code="bad_rule_input", key="drive_lag_s")
    closed_s = delay_s  # tau_c: the tightest that SIMC recommends
    kp = 1.0 / (closed_s + delay_s)
    ki = kp / (4.0 * (closed_s + delay_s))
    around_s = OUTER_SLOWER * closed_s + delay_s + 0.5 * closed_s  # the inner loop's lag, by the half rule
    gains = {"speed.kp_low": kp, "speed.ki_low": ki, "speed.kp_high": kp, "speed.ki_high": ki}
    return {"station.kp": 1.0 / around_s, **gains}


def _lateral_weights(inputs: RuleInputs) -> dict[str, float]:
    """Largest road-wheel angle: the stop, or what the lateral acceleration allows at the planned speed."""
    stop_rad = inputs.steer_limit_rad / inputs.steer_ratio
    grip_rad = math.atan(inputs.lateral_accel_mps2 * inputs.wheelbase_m / (inputs.speed_mps * inputs.speed_mps))
    largest = {
        "lqr.q1": LARGEST_LATERAL_M,
        "lqr.q2": LARGEST_LATERAL_RATE_MPS,
        "lqr.q3": LARGEST_HEADING_RAD,
        "lqr.q4": LARGEST_HEADING_RATE_RADPS,
    }
    return {name: (min(stop_rad, grip_rad) / error) ** 2 for name, error in largest.items()}


def _middle(axis: Axis) -> float:
    return math.sqrt(axis.low * axis.high) if axis.log else 0.5 * (axis.low + axis.high)
