"""Samples of a channel without a reported output: the output follows from the motion of the car.

Two simple laws are fitted to the training parts, with the command at the delay that leaves the smallest residual:

    pedals     rate of speed = c0 + c1 v + c2 v^2 + g(command), with g piecewise linear in the command, where the other
               pedal has been released for some time. The samples are g(command) and the rate of speed without the
               first three terms, both in m/s2.
    steer      road wheel angle by rolling = atan(wheelbase * yaw rate / v) = c0 + command / ratio.
               The samples are the command and ratio * (angle - c0), both in rad.

Gain, offset and dead band of such a channel belong to the plant; the samples give its dead time and lag. These include
the car's own response, so their intervals are wider than those of a reported output (learn/actuators/identify.py).
The laws also suggest constants of the plant, as start values of a fit for a car with a short data sheet.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.units import AIR_DENSITY_KGPM3, G_MPS2
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.learn.actuators.model import filter_rate
from tunefree_hil.learn.actuators.samples import (
    BENCH_TICKS,
    CHANNELS,
    SAMPLES,
    ActuatorSamples,
    ChannelRecord,
    ChannelSamples,
    cut_segments,
    shift_later,
)
from tunefree_hil.learn.drives.drive import INS_FIRST_YAW_RATES, Array, Drive, DrivePart, first_valid_field
from tunefree_hil.learn.drives.runs import find_runs
from tunefree_hil.learn.drives.smoothing import (
    estimate_rate,
    interpolate_fresh,
    select_speed,
    yaw_rate_from_wheels,
)

OTHER_PEDAL = {"throttle": "brake", "brake": "throttle"}
MOTION_CHANNELS = (*OTHER_PEDAL, "steer")
MOTION_DESCRIPTION = "from the motion: no output is reported"


class MotionLawCriteria(NamedTuple):
    """Settings of the laws; every value is an engineering choice."""

    max_released_frac: float = 0.01  # above rest, up to which a pedal counts as released
    min_released_s: float = 1.0  # for which the other pedal has been released
    knots: int = 5  # of g, the effect of a command
    max_delay_s: float = 0.6  # longest delay of the command that is tried
    delays: int = 20  # tried, up to max_delay_s
    max_steady_accel_mps2: float = 0.2  # up to which the speed counts as held
    min_rows: int = 500  # of a moving car, that a law needs
    min_steady_rows: int = 100  # at a held speed, for the command that holds it
    min_speed_share: float = 0.1  # of the top speed; below it friction and small angles dominate
    top_speed_quantile: float = 0.99  # of the speed, that counts as the top speed
    min_divisor_mps: float = 0.05  # least speed that the yaw rate is divided by
    min_segment_s: float = 3.0  # a shorter segment is left out
    min_inverse_ratio: float = 1e-6  # of an inverse steering ratio; less has the wrong sign or no effect


class SuggestionCriteria(NamedTuple):
    """How constants of the plant follow from the laws; every value is an engineering choice."""

    min_explained_share: float = 0.3  # of the variance of the rate of speed; a weaker law suggests nothing
    drive_knee_frac: float = 0.5  # throttle at which the suggested drive force has risen to 63 %
    zero_of_held_command: float = 0.8  # of the least command that held a speed, for the throttle's zero at most
    zero_of_pull_away: float = 0.7  # of the way from the least command to the one that overcomes rolling resistance
    fast_share: float = 0.7  # of the top speed, at which drag is taken
    rolling_mps2: tuple[float, float] = (0.02, 3.0)  # least and greatest deceleration by rolling resistance
    min_drag_mps2: float = 0.02  # least deceleration by drag at that speed
    force_ratio: float = 1.5  # of the drive force to the largest one that the law shows
    power_ratio: float = 2.0  # of the drive power to force times top speed


LAW = MotionLawCriteria()
SUGGESTION = SuggestionCriteria()


class HeldSpeed(NamedTuple):
    """Throttle commands that held a speed, and that speed; all 0 where the law shows none."""

    low_command: float = 0.0  # 5 % quantile
    median_command: float = 0.0
    median_speed_mps: float = 0.0


class MotionLaw(NamedTuple):
    """A fitted law of one channel."""

    channel: str
    coefficients: Array  # c0, c1, c2 and the slopes of g (pedals), or c0 and 1 / ratio (steer)
    knots: Array  # commands between which g is linear
    command_delay_ticks: int
    steer_ratio: float  # command per road wheel angle, 0 for a pedal
    explained_share: float  # of the variance of the effect
    slow_mps: float  # slower rows are not used
    top_mps: float
    held_speed: HeldSpeed = HeldSpeed()


class _MotionSignals(NamedTuple):
    """Signals of a part, each of shape (n_rows,)."""

    command: Array  # as sent
    speed: Array
    effect: Array  # the quantity that the law explains, after the rate filter
    is_fresh: Array
    is_usable: Array
    dt_s: float
    window: int  # ticks of the rate filter


def fit_motion_law(parts: Sequence[DrivePart], channel: str, vehicle: VehicleSpec) -> MotionLaw | None:
    """The law of a channel without a reported output; None where the logs do not show one."""
    if channel not in MOTION_CHANNELS or not parts:
        return None
    pieces = [piece for part in parts if (piece := _read_signals(part, channel, vehicle)) is not None]
    if sum(int(piece.is_usable.sum()) for piece in pieces) < LAW.min_rows:
        return None
    speeds = np.concatenate([piece.speed[piece.is_usable] for piece in pieces])
    top_mps = float(np.quantile(speeds, LAW.top_speed_quantile))
    slow_mps = LAW.min_speed_share * top_mps
    pieces = [piece._replace(is_usable=piece.is_usable & (piece.speed > slow_mps)) for piece in pieces]
    commands = np.concatenate([piece.command[piece.is_usable] for piece in pieces])
    if len(commands) < LAW.min_rows or float(np.ptp(commands)) <= 0.0:
        return None
    knots = np.zeros(0) if channel == "steer" else _place_knots(commands)
    start = MotionLaw(channel, np.zeros(0), knots, 0, 0.0, 0.0, slow_mps, top_mps)
    max_delay = round(LAW.max_delay_s / pieces[0].dt_s)
    delays = range(0, max_delay + 1, max(max_delay // LAW.delays, 1))
    laws = [_fit_at_delay(pieces, start._replace(command_delay_ticks=delay)) for delay in delays]
    best = max((law for law in laws if law is not None), key=lambda law: law.explained_share, default=None)
    return best if best is None or channel != "throttle" else best._replace(held_speed=_find_held_speed(pieces))


def _find_held_speed(pieces: Sequence[_MotionSignals]) -> HeldSpeed:
    rows = [piece.is_usable & (np.abs(piece.effect) < LAW.max_steady_accel_mps2) for piece in pieces]
    commands = np.concatenate([piece.command[steady] for piece, steady in zip(pieces, rows, strict=True)])
    speeds = np.concatenate([piece.speed[steady] for piece, steady in zip(pieces, rows, strict=True)])
    if len(commands) < LAW.min_steady_rows:
        return HeldSpeed()
    return HeldSpeed(float(np.quantile(commands, 0.05)), float(np.median(commands)), float(np.median(speeds)))


def samples_from_motion(parts: Sequence[DrivePart], law: MotionLaw, vehicle: VehicleSpec) -> ChannelSamples:
    """Commands and outputs by a law; commands are delayed by BENCH_TICKS, as on the bench."""
    segments: list[ActuatorSamples] = []
    for part in parts:
        signals = _read_signals(part, law.channel, vehicle)
        if signals is None:
            continue
        command, output = _command_and_output(law, signals)
        is_good = signals.is_usable & np.isfinite(command) & np.isfinite(output)
        is_compared = signals.is_fresh & (signals.speed > law.slow_mps)
        record = ChannelRecord(command, output, is_compared, signals.window, MOTION_DESCRIPTION)
        runs = find_runs(is_good, round(LAW.min_segment_s / signals.dt_s))
        segments += cut_segments(record, runs, signals.dt_s)
    return ChannelSamples(law.channel, tuple(segments), MOTION_DESCRIPTION)


def _read_signals(part: DrivePart, channel: str, vehicle: VehicleSpec) -> _MotionSignals | None:
    drive, span = part.drive, slice(part.begin, part.end)
    command, selected = drive.get(f"command.{CHANNELS[channel]}"), select_speed(drive)
    if command is None or selected is None or not np.isfinite(command).any():
        return None
    speed, window = interpolate_fresh(*selected), max(round(SAMPLES.rate_window_s / drive.dt_s) | 1, 5)
    is_usable = np.isfinite(command) & np.isfinite(speed) & drive.enabled
    if channel in OTHER_PEDAL:
        effect, fresh = estimate_rate(*selected, window, drive.dt_s), selected[1]
        is_usable &= _is_released(drive, OTHER_PEDAL[channel], vehicle.nominal.rest_pedal_frac)
    else:
        measured = _select_yaw_rate(drive, vehicle)
        if measured is None or not vehicle.nominal.wheelbase_m:
            return None
        yaw_rate, fresh = interpolate_fresh(*measured), measured[1]
        angle = np.arctan(vehicle.nominal.wheelbase_m * yaw_rate / np.maximum(speed, LAW.min_divisor_mps))
        effect = filter_rate(angle, window, drive.dt_s)
    is_usable &= np.isfinite(effect)
    return _MotionSignals(command[span], speed[span], effect[span], fresh[span], is_usable[span], drive.dt_s, window)


def _is_released(drive: Drive, pedal: str, rest_frac: float) -> Array:
    """Rows in which a pedal has been released for some time; all where the drive has no data of it."""
    for group in ("report", "command"):
        values = drive.get(f"{group}.{CHANNELS[pedal]}")
        if values is not None and np.isfinite(values).any():
            is_pressed = np.nan_to_num(values) > rest_frac + LAW.max_released_frac
            window = np.ones(max(round(LAW.min_released_s / drive.dt_s), 1))
            return np.convolve(is_pressed, window)[: len(is_pressed)] < 0.5
    return np.ones(drive.n_rows, dtype=bool)


def _select_yaw_rate(drive: Drive, vehicle: VehicleSpec) -> tuple[Array, Array] | None:
    name = first_valid_field(drive, INS_FIRST_YAW_RATES)
    return yaw_rate_from_wheels(drive, vehicle.nominal) if name is None else (drive.fields[name], drive.fresh[name])


def _place_knots(commands: Array) -> Array:
    """Knots of g, evenly spread over the different commands that were given."""
    values = np.unique(np.round(commands, 3))
    return np.unique(np.quantile(values, np.linspace(0.0, 1.0, min(LAW.knots, len(values)))))


def _design_matrix(signals: _MotionSignals, law: MotionLaw) -> Array:
    """The regressors of the law, shape (n_rows, n_coefficients)."""
    command, ones = shift_later(signals.command, law.command_delay_ticks), np.ones(len(signals.command))
    if law.channel == "steer":
        return np.stack([ones, filter_rate(np.nan_to_num(command), signals.window, signals.dt_s)], axis=1)
    ramps = _knot_ramps(np.nan_to_num(command), law.knots)
    filtered = [filter_rate(ramp, signals.window, signals.dt_s) for ramp in ramps]
    return np.stack([ones, signals.speed, signals.speed * signals.speed, *filtered], axis=1)


def _knot_ramps(commands: Array, knots: Array) -> Iterator[Array]:
    """Ramps that rise between two knots and are constant outside; any piecewise linear g is a sum of them."""
    for low, high in pairwise(knots):
        yield np.clip(commands - low, 0.0, high - low)


def _fit_at_delay(pieces: Sequence[_MotionSignals], law: MotionLaw) -> MotionLaw | None:
    """Fit the coefficients at the law's delay. None where there are few rows or the command acts the wrong way."""
    rows = [piece.is_usable & np.isfinite(shift_later(piece.command, law.command_delay_ticks)) for piece in pieces]
    regressors = np.concatenate([_design_matrix(piece, law)[used] for piece, used in zip(pieces, rows, strict=True)])
    effect = np.concatenate([piece.effect[used] for piece, used in zip(pieces, rows, strict=True)])
    if len(effect) < LAW.min_rows:
        return None
    coefficients = np.linalg.lstsq(regressors, effect, rcond=None)[0]
    explained_share = 1.0 - float(np.var(effect - regressors @ coefficients)) / max(float(np.var(effect)), 1e-12)
    law = law._replace(coefficients=coefficients, explained_share=explained_share)
    if law.channel == "steer":
        inverse_ratio = float(coefficients[1])
        return law._replace(steer_ratio=1.0 / inverse_ratio) if inverse_ratio > LAW.min_inverse_ratio else None
    full_effect = float(coefficients[3:] @ np.diff(law.knots))  # of the largest command
    has_right_sign = full_effect > 0.0 if law.channel == "throttle" else full_effect < 0.0
    return law if has_right_sign else None


def _command_and_output(law: MotionLaw, signals: _MotionSignals) -> tuple[Array, Array]:
    command = shift_later(signals.command, BENCH_TICKS)
    if law.channel == "steer":
        return command, law.steer_ratio * (signals.effect - law.coefficients[0])
    c0, c1, c2, *slopes = law.coefficients.tolist()
    effect = np.stack(list(_knot_ramps(command, law.knots)), axis=1) @ np.array(slopes)
    return effect, signals.effect - c0 - c1 * signals.speed - c2 * signals.speed * signals.speed


def suggest_plant_constants(laws: Mapping[str, MotionLaw], mass_kg: float) -> dict[str, float]:
    """Start values of plant constants by their names in [plant.params], where the laws show them.

    creep_force_n is 0 where the laws show none: a fitted one could explain the most frequent speed of any car.
    """
    constants: dict[str, float] = {}
    if "steer" in laws:
        constants["steer_ratio"] = laws["steer"].steer_ratio
    throttle = laws.get("throttle")
    min_share = SUGGESTION.min_explained_share
    if throttle is not None and throttle.explained_share >= min_share and len(throttle.knots) > 1:
        constants |= _suggest_longitudinal_constants(throttle, mass_kg)
    if laws and (throttle is None or throttle.explained_share < min_share or throttle.coefficients[0] <= 0.0):
        constants["creep_force_n"] = 0.0
    brake = laws.get("brake")
    if brake is not None and brake.explained_share >= min_share and len(brake.knots) > 1:
        braking_mps2 = -float(brake.coefficients[3:] @ np.diff(brake.knots))
        constants["brake_force_n_per_frac"] = mass_kg * braking_mps2 / float(brake.knots[-1] - brake.knots[0])
    return constants


def _suggest_longitudinal_constants(law: MotionLaw, mass_kg: float) -> dict[str, float]:
    """Rolling resistance and drag from the terms without a command, the drive from the throttle's effect."""
    c0, c1, c2 = (float(coefficient) for coefficient in law.coefficients[:3])
    drive_mps2 = np.concatenate([[0.0], np.cumsum(law.coefficients[3:] * np.diff(law.knots))])
    rolling_mps2 = min(max(-c0, SUGGESTION.rolling_mps2[0]), SUGGESTION.rolling_mps2[1])
    fast_mps = SUGGESTION.fast_share * law.top_mps
    drag_mps2 = max(-(c1 * fast_mps + c2 * fast_mps * fast_mps), SUGGESTION.min_drag_mps2)
    pull_away_frac = float(np.interp(rolling_mps2, np.maximum.accumulate(drive_mps2), law.knots))
    zero_frac = float(law.knots[0]) + SUGGESTION.zero_of_pull_away * (pull_away_frac - float(law.knots[0]))
    force_n = SUGGESTION.force_ratio * mass_kg * max(float(drive_mps2.max()), rolling_mps2)
    knee_frac, held_speed = SUGGESTION.drive_knee_frac, law.held_speed
    if held_speed.median_command > 0.0:  # with the start values the car must hold that speed too
        zero_frac = min(zero_frac, SUGGESTION.zero_of_held_command * held_speed.low_command)
        resistance_mps2 = rolling_mps2 + drag_mps2 * (held_speed.median_speed_mps / fast_mps) ** 2
        share = (held_speed.median_command - zero_frac) / max(1.0 - zero_frac, 0.1)
        force_n = mass_kg * resistance_mps2 / max(1.0 - math.exp(-share / knee_frac), 1e-3)
    return {
        "rolling_frac": rolling_mps2 / G_MPS2,
        "drag_area_m2": mass_kg * drag_mps2 / (0.5 * AIR_DENSITY_KGPM3 * fast_mps * fast_mps),
        "throttle_zero_frac": zero_frac,
        "drive_force_n": force_n,
        "drive_knee_frac": knee_frac,
        "drive_power_w": SUGGESTION.power_ratio * force_n * law.top_mps,
    }
