"""A drive opened at its measured intermediates: command, echo, reported output, motion as chassis and INS say it.

    command -> echo -> actuator -> reported output -> car -> chassis reports, INS

Every link is judged by what was measured before it, so that one that is broken does not break those behind it. What a
log does not hold is said by link: that link cannot be told.

Speed and yaw rate of an INS that says places and heading and no rates: their slopes over a few values.

A motion capture, or a receiver with two antennae, says where a car is and which way it heads. What that comes to in
speed along the car and in yaw rate is the only second opinion that such a recording has on wheels and gyro.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Link
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GEAR_DRIVE
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.gap.measured.observability import OUTPUTS, lost_of, unknown_channels
from tunefree_hil.gap.measured.signals import INS, Signal, as_told, carried, says_little, signals_of, well_covered
from tunefree_hil.gap.model.graph import CHANNELS, Inputs
from tunefree_hil.learn.actuators.samples import ECHOES, accel_asked, asked_pedals, channel_of
from tunefree_hil.learn.data_sheet import rear_behind_m
from tunefree_hil.learn.drives.drive import CHASSIS_FIRST_YAW_RATES, Drive
from tunefree_hil.learn.drives.runs import every_of, runs
from tunefree_hil.learn.drives.smoothing import between_fresh, rate_of, smooth, yaw_by_wheels

Array = np.ndarray

PIN_WINDOW_S = 0.21  # of the polynomial through the measured speed that the car is told
ROAD_CAR_M = 2.7  # wheelbase
STANDING_MPS = 0.5  # no bend is told by slower wheels
SMALL = 0.5  # of it: no road car is shorter
NOTHING: Mapping[str, int] = {}
NO_TIME: Mapping[str, float] = {}
AFTER_S = 1.0  # after a stretch in which a channel did not obey its commands, its output is still another's


class Opened(NamedTuple):
    """One drive. signals: by field name. follows: [n, 3] rows in which the commands of a channel acted.

    lost: what of the chain this log cannot show, by link, in words. pace: of a model car its wheelbase as a share of a
    road car's, else 1: what counts as driving is so many wheelbases a second. derived: fields of `signals` that nobody
    measured and others tell, with the ticks that are under a slope there (1: none is). unsure: in words, what was left
    out of that. most_steer_rad: the vehicle's greatest steering angle. acted_s: by channel, how long its commands
    acted; unknown: channels of which nothing is said (gap/measured/observability.py).
    """

    name: str
    log_hash: str
    dt_s: float
    inputs: Inputs
    signals: Mapping[str, Signal]
    follows: Array
    moving: Array
    lost: Mapping[Link, str]
    pace: float = 1.0
    derived: Mapping[str, int] = NOTHING
    most_steer_rad: float = 8.0
    unsure: tuple[str, ...] = ()
    wheelbase_m: float = ROAD_CAR_M
    acted_s: Mapping[str, float] = NO_TIME
    unknown: frozenset[str] = frozenset()

    @property
    def ticks(self) -> int:
        """Rows."""
        return len(self.moving)

    @property
    def by_wheels(self) -> bool:
        """Whether the chassis's yaw rate is made from its wheels: there is no gyro."""
        return CHASSIS_FIRST_YAW_RATES[0] in self.derived

    @property
    def bend(self) -> Array:
        """The path's bend [n] over a wheelbase, which is about the road wheels' angle, rad."""
        return self.wheelbase_m * self.inputs.yaw_rate_radps / np.maximum(self.inputs.speed_mps, STANDING_MPS)

    def has(self, *names: str) -> bool:
        """Whether all of these fields were measured."""
        return all(name in self.signals for name in names)


class _Told(NamedTuple):
    """Signals as a question takes them; derived, left_out: as in `Opened`; source: the one that says the speed."""

    signals: Mapping[str, Signal]
    derived: Mapping[str, int]
    left_out: tuple[str, ...]
    source: str


def open_chain(drive: Drive, vehicle: VehicleSpec) -> Opened:
    """Raises InputError where neither INS nor chassis says the speed: nothing of the motion can be told then."""
    signals, derived, left_out, source = _told(drive, vehicle)
    if source not in signals:
        raise InputError(
            "the log says nothing of the speed",
            code="no_motion",
            file=drive.name,
            key="report.speed_mps",
            hint="speed is needed, from the chassis or from an INS",
        )
    inputs, follows, known = _inputs(drive, vehicle, signals, source)
    speed = signals[source]
    moving = known & speed.there & (inputs.gear >= GEAR_DRIVE)
    acted_s = {name: float(drive.dt_s * follows[:, i].sum()) for i, name in enumerate(CHANNELS)}
    return Opened(
        drive.name, drive.log_hash, drive.dt_s, inputs, signals, follows, moving,
        lost_of(signals, source.startswith(INS)),
        pace_of(vehicle), derived, vehicle.limits.steer_rad, left_out,
        vehicle.nominal.wheelbase_m or ROAD_CAR_M, acted_s, unknown_channels(drive, vehicle),
    )  # fmt: skip


def says_speed(drive: Drive, vehicle: VehicleSpec) -> bool:
    """Whether anything of the motion can be told."""
    told = _told(drive, vehicle)
    return told.source in told.signals


def _told(drive: Drive, vehicle: VehicleSpec) -> _Told:
    """What a drive says, with what is made of it where nobody says it."""
    said = signals_of(drive, vehicle.ins_frame.latency_s / drive.dt_s)
    unsaid = _unsaid(drive, vehicle, said)
    signals, left_out = well_covered(said | unsaid, drive.name)
    derived = {
        name: 1 if name.startswith("report.") else window_of(said[HEADING].fresh) for name in unsaid if name in signals
    }
    source = "ins.speed_mps" if "ins.speed_mps" in signals else "report.speed_mps"
    return _Told(signals, derived, left_out + _unsure(drive, said), source)


def commanded(opened: Opened) -> tuple[bool, bool, bool]:
    """Of throttle, brake, steer: whether commands acted anywhere in a recording."""
    throttle, brake, steer = (bool((opened.follows[:, i] > 0.5).any()) for i in range(3))
    return throttle, brake, steer


def is_driven(opened: Opened, rows: slice) -> bool:
    """Whether a stretch can be run: in gear, inputs known, and nobody takes over from a channel's commands."""
    return bool(opened.moving[rows].all() and (opened.follows[rows] > 0.5)[:, list(commanded(opened))].all())


def pace_of(vehicle: VehicleSpec) -> float:
    """Of a car smaller than any road car its wheelbase as a share of one's; else 1."""
    share = (vehicle.nominal.wheelbase_m or ROAD_CAR_M) / ROAD_CAR_M
    return share if share < SMALL else 1.0


def _unsaid(drive: Drive, vehicle: VehicleSpec, signals: Mapping[str, Signal]) -> dict[str, Signal]:
    """What nobody says and others tell: an INS's rates by its pose; a yaw rate, where there is none, by the wheels."""
    values = {name: one.values for name, one in signals.items()}
    rates = rates_by_pose(values, {name: one.fresh for name, one in signals.items()}, drive.dt_s)
    there = {name: np.all([signals[one].there for one in MADE_FROM[name]], axis=0) for name in rates}
    found = {
        name: signals[HEADING]._replace(values=np.nan_to_num(one), there=there[name]) for name, one in rates.items()
    }
    wheels = yaw_by_wheels(drive, vehicle.nominal)
    by_chassis, by_ins = CHASSIS_FIRST_YAW_RATES
    if by_chassis in signals or wheels is None or (wheels[1] & np.isfinite(wheels[0])).sum() < 2:
        return found
    told = {**signals, **found, by_chassis: as_told(*wheels, drive.dt_s)}
    if by_ins not in told or says_little(told, by_ins, by_chassis):
        found[by_chassis] = told[by_chassis]
    return found


def _unsure(drive: Drive, signals: Mapping[str, Signal]) -> tuple[str, ...]:
    """What a pose does not tell because it jumps."""
    values = {name: one.values for name, one in signals.items()}
    jump = jumps_of(values, {name: one.fresh for name, one in signals.items()}, drive.dt_s)
    return (f"{drive.name}: {', '.join(jump)} jumps, so that no rate is made from it",) if jump else ()


def _inputs(
    drive: Drive, vehicle: VehicleSpec, signals: Mapping[str, Signal], source: str
) -> tuple[Inputs, Array, Array]:
    """(inputs, rows whose commands acted [n, 3], rows in which the chassis's inputs are known)."""
    rest, n = vehicle.nominal.rest_pedal_frac, drive.ticks
    commands, outputs, follows = (np.zeros((n, 3)) for _ in range(3))
    known, measured, echoed = np.ones(n, dtype=bool), [], []
    accel = accel_asked(drive)
    pedals = [] if accel is None else asked_pedals(accel, drive.enabled, rest)
    for i, name in enumerate(CHANNELS):
        idle = 0.0 if name == "steer" else rest
        asked, _, obeyed = pedals[i] if i < len(pedals) else channel_of(drive, name, idle)
        obeyed = obeyed & drive.enabled & np.isfinite(asked) & carried(signals, _carriers(name), n)
        report = signals.get(f"report.{OUTPUTS[name]}")
        output = np.nan_to_num(asked, nan=idle) if report is None else report.values
        commands[:, i] = np.where(obeyed, np.nan_to_num(asked, nan=idle), output)
        outputs[:, i] = output
        follows[:, i] = _settled(obeyed, drive.dt_s)
        known &= follows[:, i] > 0.5 if report is None else report.there
        measured.append(report is not None)
        echoed.append(f"report.{ECHOES['accel' if i < len(pedals) else name]}" in signals)
    gear = signals.get("report.gear")
    held = np.full(n, GEAR_DRIVE) if gear is None else np.round(_held(drive, "report.gear"))
    window = max(round(PIN_WINDOW_S / drive.dt_s) | 1, 5)
    speed = np.maximum(smooth(signals[source].values, window), 0.0)
    yaw_name = "ins.yaw_rate_radps" if "ins.yaw_rate_radps" in signals else "report.yaw_rate_radps"
    yaw = smooth(signals[yaw_name].values, window) if yaw_name in signals else np.zeros(n)
    behind_m = rear_behind_m(vehicle.nominal)
    rate = np.nan_to_num(rate_of(speed, np.ones(n, dtype=bool), window, drive.dt_s))
    inputs = Inputs(
        commands, outputs, held, speed, yaw, behind_m * yaw, rate, np.ones(n), tuple(measured), tuple(echoed),
        source.startswith("ins."), drive.dt_s,
    )  # fmt: skip
    return inputs, follows > 0.5, known


def _carriers(channel: str) -> tuple[str, ...]:
    """What says a channel's commands, the first that there is: what was asked in a gap of it nobody knows."""
    said = (f"report.{ECHOES[channel]}", f"command.{OUTPUTS[channel]}")
    return said if channel == "steer" else (*said, f"report.{ECHOES['accel']}", "command.accel_mps2")


def _held(drive: Drive, name: str) -> Array:
    """A signal of steps: the newest value, the first one before it."""
    values = drive.fields[name].copy()
    good = np.flatnonzero(np.isfinite(values))
    values[: good[0]] = values[good[0]]
    return np.nan_to_num(values, nan=GEAR_DRIVE)


def _settled(obeyed: Array, dt_s: float) -> Array:
    """Rows that lie at least AFTER_S behind the beginning of a stretch in which commands acted."""
    found = np.zeros(len(obeyed))
    wait = round(AFTER_S / dt_s)
    for begin, end in runs(obeyed, wait + 1):
        found[begin + wait : end] = 1.0
    return found


X, Y, HEADING, SPEED, YAW_RATE = (
    "ins.x_m", "ins.y_m", "ins.heading_rad", "ins.speed_mps", "ins.yaw_rate_radps"
)  # fmt: skip
MADE_FROM = {YAW_RATE: (HEADING,), SPEED: (HEADING, X, Y)}
VALUES = 5  # under a slope: over more, what a quick car does would be taken off
SLOWEST_S = 0.06  # between two values: a slope over more than a quarter of a second is no rate
LEAST_VALUES = 20
USUAL, JUMP = 0.99, 5.0  # a step so many times as long as 99 of 100 others is no motion


def rates_by_pose(fields: Mapping[str, Array], fresh: Mapping[str, Array], dt_s: float) -> dict[str, Array]:
    """The rates [m/s, rad/s] that an INS does not say and its pose tells, on every tick; fresh where HEADING is.

    Empty where it says them itself, where values come too seldom for slopes, and where the pose jumps (a camera that
    lost the car, a correction): of such a pose no slope is sure. Speed is that along the heading, of the point whose
    places they are. NaN before the first pose.
    """
    found: dict[str, Array] = {}
    jump = jumps_of(fields, fresh, dt_s)
    if not _often(fresh, (HEADING,), dt_s) or HEADING in jump:
        return found
    heading = _unwrapped(fields[HEADING], fresh[HEADING])
    if YAW_RATE not in fields:
        found[YAW_RATE] = _slope(heading, fresh[HEADING], dt_s)
    if SPEED not in fields and _often(fresh, (X, Y), dt_s) and not jump:
        even = between_fresh(heading, fresh[HEADING])
        east, north = (_slope(fields[name], fresh[name], dt_s) for name in (X, Y))
        found[SPEED] = east * np.cos(even) + north * np.sin(even)
    return found


def jumps_of(fields: Mapping[str, Array], fresh: Mapping[str, Array], dt_s: float) -> tuple[str, ...]:
    """The fields of a pose that jump, of those whose slopes would be taken."""
    if not _often(fresh, (HEADING,), dt_s):
        return ()
    asked = ((HEADING,) if YAW_RATE not in fields else ()) + ((HEADING, X, Y) if SPEED not in fields else ())
    return tuple(
        name
        for name in dict.fromkeys(asked)
        if _often(fresh, (name,), dt_s)
        and _jumps(_unwrapped(fields[name], fresh[name]) if name == HEADING else fields[name], fresh[name])
    )


def window_of(fresh: Array) -> int:
    """Ticks under a slope."""
    return (VALUES - 1) * round(every_of(fresh)) | 1


def _jumps(values: Array, fresh: Array) -> bool:
    """Whether a value is far from where the one before it was, for the time between them: over frames that are lost a
    car goes on.
    """
    rows = np.flatnonzero(fresh & np.isfinite(values))
    pace = np.abs(np.diff(values[rows])) / np.diff(rows)
    return bool(pace.max() > JUMP * max(float(np.quantile(pace, USUAL)), 1e-12))


def _often(fresh: Mapping[str, Array], names: tuple[str, ...], dt_s: float) -> bool:
    """Whether values of all of these are there, and come often enough for slopes."""
    if any(name not in fresh or fresh[name].sum() < LEAST_VALUES for name in names):
        return False
    return all(round(every_of(fresh[name])) * dt_s <= SLOWEST_S for name in names)


def _unwrapped(values: Array, fresh: Array) -> Array:
    found, rows = values.copy(), np.flatnonzero(fresh & np.isfinite(values))
    found[rows] = np.unwrap(values[rows])
    return found


def _slope(values: Array, fresh: Array, dt_s: float) -> Array:
    """Rate per s; NaN before the first value."""
    return rate_of(values, fresh, window_of(fresh), dt_s)
