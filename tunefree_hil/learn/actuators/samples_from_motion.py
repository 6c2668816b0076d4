"""Pairs of a channel that reports no output: what the car's motion says the output must have been.

Two laws of the plainest kind, fitted on the training parts with the command at the shift that leaves the least:

    pedals     rate of speed = c0 + c1 v + c2 v^2 + g(command), g straight between KNOTS places in the commands; where
               the other pedal is at rest, and has been for CALM_S. The pair is g(command) against what of the rate of
               speed is not drag, both in m/s2.
    steer      road wheel angle by rolling = atan(wheelbase * yaw rate / v) = c0 + command / ratio.
               The pair is the command against ratio * (the angle - c0), both in rad.

Gain, offset and dead band of such a channel belong to the plant; dead time and lag are what it is there for. They hold
the car's own answer too, so their intervals are wider than those of a reported output (learn/actuators/identify.py).

Constants of the plant as the plain laws of learn/actuators/samples_from_motion.py suggest them: where a fit may begin.

For a car whose folder states little and whose channels report nothing, and which may be a tenth of a road car's size.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.units import AIR_DENSITY_KGPM3, G_MPS2
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.learn.actuators.model import smooth_rate
from tunefree_hil.learn.actuators.samples import BENCH_TICKS, CHANNELS, RATE_WINDOW_S, WARM_S, Pair, Pairs, shifted
from tunefree_hil.learn.drives.drive import INS_FIRST_YAW_RATES, Array, Drive, Part, first_told
from tunefree_hil.learn.drives.runs import runs
from tunefree_hil.learn.drives.smoothing import between_fresh, rate_of, speed_of, yaw_by_wheels

OTHER_PEDAL = {"throttle": "brake", "brake": "throttle"}
SEEN_BY_MOTION = (*OTHER_PEDAL, "steer")
AT_REST_FRAC, CALM_S = 0.01, 1.0
KNOTS = 5
LONGEST_SHIFT_S = 0.6
STEADY_MPS2 = 0.2  # less counts as a speed that is held
LEAST_ROWS = 500  # of moving car, for a law
SLOW_SHARE = 0.1  # of the fastest 1 %: below it friction and a wheel that hardly turns say nothing
LEAST_S = 3.0
WORDS = "from motion: no output is reported"


class Law(NamedTuple):
    """channel; coefficients; knots of the commands (pedals); the shift, in ticks, at which it was fitted.

    ratio: steering wheel (or whatever the command turns) per road wheel, 0 for a pedal. explained: share of the
    variance of what is to be explained. slow_mps, top_mps: a tenth of the fastest driven, and that.
    held: of the commands that held a speed the least but for a twentieth, the middle one, and the middle speed; or 0.
    """

    channel: str
    coefficients: Array
    knots: Array
    shift: int
    ratio: float
    explained: float
    slow_mps: float
    top_mps: float
    held: tuple[float, float, float] = (0.0, 0.0, 0.0)


class _Signals(NamedTuple):
    """Of a part, a value a tick: command as sent, speed, what is to be explained (through the filter), usable rows."""

    command: Array
    speed: Array
    effect: Array
    fresh: Array
    good: Array
    dt_s: float
    window: int


def law_of(parts: Sequence[Part], channel: str, vehicle: VehicleSpec) -> Law | None:
    """The law of a channel that no report speaks of; None where the logs do not have what it takes."""
    if channel not in SEEN_BY_MOTION or not parts:
        return None
    some = [one for one in (_signals(part, channel, vehicle) for part in parts) if one is not None]
    if sum(int(one.good.sum()) for one in some) < LEAST_ROWS:
        return None
    top_mps = float(np.quantile(np.concatenate([one.speed[one.good] for one in some]), 0.99))
    slow_mps = SLOW_SHARE * top_mps
    some = [one._replace(good=one.good & (one.speed > slow_mps)) for one in some]
    commands = np.concatenate([one.command[one.good] for one in some])
    if len(commands) < LEAST_ROWS or float(np.ptp(commands)) <= 0.0:
        return None
    knots = np.zeros(0) if channel == "steer" else _knots(commands)
    longest = round(LONGEST_SHIFT_S / some[0].dt_s)
    found = [_fitted(some, channel, knots, shift, top_mps) for shift in range(0, longest + 1, max(longest // 20, 1))]
    best = max((one for one in found if one is not None), key=lambda one: one.explained, default=None)
    return best if best is None or channel != "throttle" else best._replace(held=_held(some))


def _held(some: Sequence[_Signals]) -> tuple[float, float, float]:
    """See Law.held."""
    rows = [one.good & (np.abs(one.effect) < STEADY_MPS2) for one in some]
    commands = np.concatenate([one.command[row] for one, row in zip(some, rows, strict=True)])
    speeds = np.concatenate([one.speed[row] for one, row in zip(some, rows, strict=True)])
    if len(commands) < LEAST_ROWS // 5:
        return 0.0, 0.0, 0.0
    return float(np.quantile(commands, 0.05)), float(np.median(commands)), float(np.median(speeds))


def pairs_by_motion(parts: Sequence[Part], law: Law, vehicle: VehicleSpec) -> Pairs:
    """Stretches of command and output by a law, on the time of the commands as sent and BENCH_TICKS later."""
    found: list[Pair] = []
    for part in parts:
        one = _signals(part, law.channel, vehicle)
        if one is None:
            continue
        command, output = _pair(law, one)
        good = one.good & np.isfinite(command) & np.isfinite(output)
        for begin, end in runs(good, round(LEAST_S / one.dt_s)):
            counts = one.fresh[begin:end] & (one.speed[begin:end] > law.slow_mps)
            counts[: round(WARM_S / one.dt_s)] = False
            if counts.any():
                found.append(Pair(command[begin:end], output[begin:end], counts, one.dt_s, one.window))
    return Pairs(law.channel, tuple(found), WORDS)


def _signals(part: Part, channel: str, vehicle: VehicleSpec) -> _Signals | None:
    drive, cut = part.drive, slice(part.begin, part.end)
    asked, speed = drive.get(f"command.{CHANNELS[channel]}"), speed_of(drive)
    if asked is None or speed is None or not np.isfinite(asked).any():
        return None
    even, window = between_fresh(*speed), max(round(RATE_WINDOW_S / drive.dt_s) | 1, 5)
    good = np.isfinite(asked) & np.isfinite(even) & drive.enabled
    if channel in OTHER_PEDAL:
        effect, fresh = rate_of(*speed, window, drive.dt_s), speed[1]
        good &= _at_rest(drive, OTHER_PEDAL[channel], vehicle.nominal.rest_pedal_frac)
    else:
        seen = _yaw_rate(drive, vehicle)
        if seen is None or not vehicle.nominal.wheelbase_m:
            return None
        yaw, fresh = between_fresh(*seen), seen[1]
        angle = np.arctan(vehicle.nominal.wheelbase_m * yaw / np.maximum(even, 0.05))
        effect = smooth_rate(angle, window, drive.dt_s)
    good &= np.isfinite(effect)
    return _Signals(asked[cut], even[cut], effect[cut], fresh[cut], good[cut], drive.dt_s, window)


def _at_rest(drive: Drive, pedal: str, rest: float) -> Array:
    """Where a pedal is not pressed, and has not been for CALM_S; everywhere where nothing is known of it."""
    for group in ("report", "command"):
        values = drive.get(f"{group}.{CHANNELS[pedal]}")
        if values is not None and np.isfinite(values).any():
            pressed = np.nan_to_num(values) > rest + AT_REST_FRAC
            reach = np.ones(max(round(CALM_S / drive.dt_s), 1))
            return np.convolve(pressed, reach)[: len(pressed)] < 0.5
    return np.ones(drive.ticks, dtype=bool)


def _yaw_rate(drive: Drive, vehicle: VehicleSpec) -> tuple[Array, Array] | None:
    name = first_told(drive, INS_FIRST_YAW_RATES)
    return yaw_by_wheels(drive, vehicle.nominal) if name is None else (drive.fields[name], drive.fresh[name])


def _knots(commands: Array) -> Array:
    """Places between which g is straight: evenly spread over the different commands that were given."""
    values = np.unique(np.round(commands, 3))
    return np.unique(np.quantile(values, np.linspace(0.0, 1.0, min(KNOTS, len(values)))))


def _columns(one: _Signals, channel: str, knots: Array, shift: int) -> Array:
    """What the law is linear in, [n, m]; the command's part stands behind the first three (pedals) or one (steer)."""
    moved = shifted(one.command, shift)
    if channel == "steer":
        return np.stack([np.ones(len(moved)), smooth_rate(np.nan_to_num(moved), one.window, one.dt_s)], axis=1)
    bends = [smooth_rate(bend, one.window, one.dt_s) for bend in _bends(np.nan_to_num(moved), knots)]
    return np.stack([np.ones(len(moved)), one.speed, one.speed * one.speed, *bends], axis=1)


def _bends(commands: Array, knots: Array) -> Iterator[Array]:
    """Ramps that rise between two knots and are level outside: their sum is any line with bends at the knots."""
    for low, high in pairwise(knots):
        yield np.clip(commands - low, 0.0, high - low)


def _fitted(some: Sequence[_Signals], channel: str, knots: Array, shift: int, top_mps: float) -> Law | None:
    """Least squares at one shift. None where the command explains nothing, or its effect goes the wrong way."""
    rows = [one.good & np.isfinite(shifted(one.command, shift)) for one in some]
    left = np.concatenate([_columns(one, channel, knots, shift)[row] for one, row in zip(some, rows, strict=True)])
    right = np.concatenate([one.effect[row] for one, row in zip(some, rows, strict=True)])
    if len(right) < LEAST_ROWS:
        return None
    found = np.linalg.lstsq(left, right, rcond=None)[0]
    share = 1.0 - float(np.var(right - left @ found)) / max(float(np.var(right)), 1e-12)
    ends = (share, SLOW_SHARE * top_mps, top_mps)
    if channel == "steer":
        slope = float(found[1])
        return Law(channel, found, knots, shift, 1.0 / slope, *ends) if slope > 1e-6 else None
    worth = float(found[3:] @ np.diff(knots))  # of the most that was commanded
    right_way = worth > 0.0 if channel == "throttle" else worth < 0.0
    return Law(channel, found, knots, shift, 0.0, *ends) if right_way else None


def _pair(law: Law, one: _Signals) -> tuple[Array, Array]:
    """(command, output), the command a bench's way later (learn/actuators/samples.py)."""
    moved = shifted(one.command, BENCH_TICKS)
    if law.channel == "steer":
        return moved, law.ratio * (one.effect - law.coefficients[0])
    c0, c1, c2, *bent = law.coefficients.tolist()
    worth = np.stack(list(_bends(moved, law.knots)), axis=1) @ np.array(bent)
    return worth, one.effect - c0 - c1 * one.speed - c2 * one.speed * one.speed


LEAST_EXPLAINED = 0.3  # of the rate of speed: a law that says less is no start
KNEE, HOLDS = 0.5, 0.8  # the drive's knee; what of the least command that held a speed is taken for its zero
FAST_SHARE = 0.7  # of the top speed, at which drag is taken


def suggested(laws: Mapping[str, Law], mass_kg: float) -> dict[str, float]:
    """Values by their names in [plant.params], for those constants that the laws say something of.

    creep_force_n is 0 where the laws show none: free, it would hold any car at the one speed that it mostly drove.
    """
    found: dict[str, float] = {}
    if "steer" in laws:
        found["steer_ratio"] = laws["steer"].ratio
    throttle = laws.get("throttle")
    if throttle is not None and throttle.explained >= LEAST_EXPLAINED and len(throttle.knots) > 1:
        found |= _along(throttle, mass_kg)
    if laws and (throttle is None or throttle.explained < LEAST_EXPLAINED or throttle.coefficients[0] <= 0.0):
        found["creep_force_n"] = 0.0
    brake = laws.get("brake")
    if brake is not None and brake.explained >= LEAST_EXPLAINED and len(brake.knots) > 1:
        worth = -float(brake.coefficients[3:] @ np.diff(brake.knots))
        found["brake_force_n_per_frac"] = mass_kg * worth / float(brake.knots[-1] - brake.knots[0])
    return found


def _along(law: Law, mass_kg: float) -> dict[str, float]:
    """Rolling and drag from what no pedal pushes, drive from what the pedal is worth."""
    still, slope, bend = (float(one) for one in law.coefficients[:3])
    worth = np.concatenate([[0.0], np.cumsum(law.coefficients[3:] * np.diff(law.knots))])
    rolling_mps2 = min(max(-still, 0.02), 3.0)
    fast_mps = FAST_SHARE * law.top_mps
    drag_mps2 = max(-(slope * fast_mps + bend * fast_mps * fast_mps), 0.02)
    moves = float(np.interp(rolling_mps2, np.maximum.accumulate(worth), law.knots))  # where it begins to pull away
    zero = float(law.knots[0]) + 0.7 * (moves - float(law.knots[0]))
    force_n = 1.5 * mass_kg * max(float(worth.max()), rolling_mps2)
    least, middle, speed_mps = law.held
    if middle > 0.0:  # a start must at least hold the speed that the car held
        zero = min(zero, HOLDS * least)
        resisted = rolling_mps2 + drag_mps2 * (speed_mps / fast_mps) ** 2
        share = (middle - zero) / max(1.0 - zero, 0.1)
        force_n = mass_kg * resisted / max(1.0 - math.exp(-share / KNEE), 1e-3)
    return {
        "rolling_frac": rolling_mps2 / G_MPS2,
        "drag_area_m2": mass_kg * drag_mps2 / (0.5 * AIR_DENSITY_KGPM3 * fast_mps * fast_mps),
        "throttle_zero_frac": zero,
        "drive_force_n": force_n,
        "drive_knee_frac": KNEE,
        "drive_power_w": 2.0 * force_n * law.top_mps,
    }
