"""The hidden effects of one drive as a record of numbers that the loops read; all neutral where nothing is hidden."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from tools.gap_exam.catalogue import kind_of


class Hidden(NamedTuple):
    """Main parameters by the effects' names, in the catalogue's units; second parameters behind them."""

    steer_dead_time: float = 0.0
    steer_lag: float = 0.0
    steer_rate_limit: float = math.inf
    steer_dead_band: float = 0.0
    steer_friction: float = 0.0
    steer_saturation: float = math.inf
    steer_gain: float = 1.0
    steer_offset: float = 0.0
    steer_backlash: float = 0.0
    throttle_dead_time: float = 0.0
    throttle_lag: float = 0.0
    throttle_rate_limit: float = math.inf
    throttle_dead_band: float = 0.0
    throttle_gain: float = 1.0
    powertrain_lag: float = 0.0
    power_limit: float = math.inf
    brake_dead_time: float = 0.0
    brake_lag: float = 0.0
    brake_dead_band: float = 0.0
    brake_gain: float = 1.0
    brake_pressure_lag: float = 0.0
    brake_fade: float = 0.0
    brake_drag: float = 0.0
    payload: float = 0.0
    payload_ahead_m: float = 0.0
    front_stiffness: float = 1.0
    rear_stiffness: float = 1.0
    friction: float = 1.0
    tyre_relaxation: float = 0.0
    rolling_resistance: float = 0.0
    aero_drag: float = 0.0
    grade: float = 0.0
    head_wind: float = 0.0
    side_wind: float = 0.0
    road_bank: float = 0.0
    speed_scale: float = 1.0
    yaw_rate_bias: float = 0.0
    yaw_rate_scale: float = 1.0
    yaw_rate_filter: float = 0.0
    accel_bias: float = 0.0
    steer_report_offset: float = 0.0
    report_latency: float = 0.0
    ins_latency: float = 0.0
    body_roll: float = 0.0
    body_roll_natural_hz: float = 1.4
    driveline_shuffle: float = 0.0
    driveline_shuffle_natural_hz: float = 3.0
    abs_cycling: float = 0.0
    abs_cycling_cycle_hz: float = 6.0
    frame_loss: float = 0.0
    frame_loss_bursts_per_s: float = 0.0
    command_delay: float = 0.0
    speed_ratio: float = 0.0
    shift_hole: float = 0.0
    shift_hole_hole_s: float = 0.4
    heat_derating: float = 0.0
    heat_derating_free_mj: float = 0.2


NOTHING = Hidden()
Effects = Mapping[str, Mapping[str, float]]  # effect -> parameter -> value, as in the sealed truth


def hidden_of(effects: Effects) -> Hidden:
    """The record of some effects; ValueError for a parameter that an effect does not have."""
    fields: dict[str, float] = {}
    for name, params in effects.items():
        kind = kind_of(name)
        places = {kind.parameter: name, kind.second: f"{name}_{kind.second}"}
        for parameter, value in params.items():
            if parameter not in places or not parameter:
                raise ValueError(f"{name} has no parameter {parameter!r}; it has {kind.parameter!r}, {kind.second!r}")
            fields[places[parameter]] = float(value)
    return NOTHING._replace(**fields)
