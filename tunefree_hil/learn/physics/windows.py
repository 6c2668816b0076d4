"""Windows of drives in which the car is let run free: recorded actuator outputs in, recorded motion to compare with.

Windows of a drive run free through the single track: what a car with these constants would have done in them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.kernel import kept, kernel
from tunefree_hil.base.records import GEAR_DRIVE, Actuation, Disturbance, Motion
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.effects._signals import SoftState, soft, step_soft
from tunefree_hil.learn.actuators.model import Way, answered
from tunefree_hil.learn.actuators.samples import accel_asked, channel_of
from tunefree_hil.learn.drives.drive import INS_FIRST_SPEEDS, INS_FIRST_YAW_RATES, Drive, Part
from tunefree_hil.learn.drives.road_slope import TOLD, offset_of
from tunefree_hil.learn.drives.runs import every_of, runs
from tunefree_hil.learn.drives.smoothing import between_fresh, earlier, mean_noise, rate_of, smooth, yaw_by_wheels
from tunefree_hil.learn.estimate import ActuatorFit
from tunefree_hil.plant.actuation.acceleration_interface import FULL_MPS2
from tunefree_hil.plant.data_sheet import constants_of
from tunefree_hil.plant.single_track import SingleTrackState, step_single_track
from tunefree_hil.plant.types import ChassisInput, ChassisParams

Array = np.ndarray

WINDOW_S = 8.0
EVERY_S = 0.1  # spacing of the rows that are compared
BEFORE_S = 2.0  # of throttle ahead of a window: by then the slowest lag of an engine has forgotten what was earlier
START_S = 0.21  # of the polynomial that gives the start of a window
LONGEST_SILENCE_S = 0.2
SLOWEST_MPS = 0.5  # a window that never is faster is left out
HILL_RAD = 0.02  # mean slope from which on a window is left out: the road is an input that nobody recorded
SLOPE_S = 2.0  # over which an accelerometer must tell it
LOOK_BACK_S = 0.5  # of specific force, for the slope
MOST_BIAS = 0.01  # of an accelerometer, in g, where the drive does not tell it from a road (learn/drives/road_slope.py)

# What is compared, in this order, and where it is read from; physics.FIRST_SCALE says what error counts as 1 at first.
TARGETS = ("speed_mps", "yaw_rate_radps", "heading_rad", "lateral_accel_mps2", "x_m", "y_m")
SOURCES = {
    "speed_mps": INS_FIRST_SPEEDS,
    "yaw_rate_radps": INS_FIRST_YAW_RATES,
    "heading_rad": ("ins.heading_rad",),
    "lateral_accel_mps2": ("report.lateral_accel_mps2",),
    "x_m": ("ins.x_m",),
    "y_m": ("ins.y_m",),
}
INPUTS = ("throttle_frac", "brake_frac", "steer_rad")


class Window(NamedTuple):
    """inputs [n, 4]: throttle, brake (duty), steer (rad), gear in the tick that ends at the row; row 0 is not used.

    before [k]: throttle (duty) in the ticks up to row 0, the newest last, as far back as BEFORE_S or as it is known; at
    least row 0's own. A lag behind it begins by it (learn/physics/windows.py).
    start: x, y, heading, speed, yaw rate at row 0. targets [m, 6]: TARGETS at rows `at` [m], NaN where not measured;
    heading continuous. standing: what the drive's accelerometer says of a slope throughout (learn/drives/road_slope.py), sin; 0.0
    where that is no more than sensors are off by.
    """

    name: str
    begin: int  # row of the drive
    inputs: Array
    before: Array
    start: tuple[float, float, float, float, float]
    at: Array
    targets: Array
    dt_s: float
    standing: float = 0.0


class Windows(NamedTuple):
    """words: what was left out. steered, pedals: whether those outputs are known, so that the car can be driven."""

    some: tuple[Window, ...]
    steered: bool
    pedals: bool
    words: tuple[str, ...]


def windows_of(
    parts: Iterable[Part],
    vehicle: VehicleSpec,
    window_s: float = WINDOW_S,
    channels: Mapping[str, ActuatorFit] | None = None,
) -> Windows:
    """Windows one behind the other in all parts, as far as outputs and motion are known and the gear is drive.

    channels: what was identified of them. Where a channel reports no output, its command through what was identified
    stands for it, wherever by-wire obeys.
    """
    some: list[Window] = []
    steered = pedals = False
    still = hills = 0
    for part in parts:
        signals = _Signals(part.drive, vehicle, channels or {})
        if signals.inputs is None:
            continue
        steered, pedals = steered or signals.steered, pedals or signals.pedals
        rows = round(window_s / part.drive.dt_s)
        for begin, end in runs(signals.good[part.begin : part.end], rows, part.begin):
            for first in range(begin, end - rows, rows):
                span = slice(first, first + rows + 1)
                if np.nanmax(signals.speed[span]) < SLOWEST_MPS:
                    still += 1
                elif signals.on_hill(span):
                    hills += 1
                else:
                    some.append(signals.window(span))
    words = [f"{_windows(still)} at a standstill left out"] if still else []
    words += [f"{_windows(hills)} on a slope left out: its grade was not recorded"] if hills else []
    return Windows(tuple(some), steered, pedals, tuple(words))


def _windows(count: int) -> str:
    return "1 window" if count == 1 else f"{count} windows"


class _Signals:
    """The signals of a drive, on every tick and in one frame of time."""

    def __init__(self, drive: Drive, vehicle: VehicleSpec, channels: Mapping[str, ActuatorFit]) -> None:
        self.drive, self.vehicle, self.channels = drive, vehicle, channels
        self.dt_s = drive.dt_s
        self.late = round(vehicle.ins_frame.latency_s / drive.dt_s)  # rows by which the INS speaks of the past
        self.start_window = max(round(START_S / drive.dt_s) | 1, 5)
        rest = vehicle.nominal.rest_pedal_frac
        columns = self._asked(rest) or [self._input(name, rest) for name in INPUTS]
        self.pedals = bool(np.isfinite(columns[0]).any() and np.isfinite(columns[1]).any())
        self.steered = bool(np.isfinite(columns[2]).any())
        self.targets = np.stack([self._target(name) for name in TARGETS], axis=1)
        self.speed = self.targets[:, 0]
        self.inputs: Array | None = None
        if (not self.steered and not self.pedals) or not np.isfinite(self.speed).any():
            return
        if not self.pedals:
            columns[0] = columns[1] = np.full(drive.ticks, rest)
        if not self.steered:
            columns[2] = np.zeros(drive.ticks)
        gear = drive.get("report.gear")
        known = gear is not None and np.isfinite(gear).any()
        columns.append(gear if known and gear is not None else np.full(drive.ticks, GEAR_DRIVE))
        self.inputs = np.stack(columns, axis=1)
        self.good = np.isfinite(self.inputs).all(axis=1) & np.isfinite(self.speed) & (self.inputs[:, 3] >= GEAR_DRIVE)
        heard = self._heard()
        self.good &= heard
        self.throttle_known = np.isfinite(self.inputs[:, 0]) & heard
        if not self.pedals:
            self.good &= self.speed > SLOWEST_MPS
        self.standing = offset_of(drive, vehicle)
        self.slope = self._slope()

    def _input(self, name: str, rest: float) -> Array:
        values = self.drive.get(f"report.{name}")
        if values is None or not np.isfinite(values).any():
            return self._from_command(name, rest)
        even = between_fresh(values, self.drive.fresh[f"report.{name}"])
        even[: int(np.argmax(np.isfinite(values)))] = np.nan
        return even

    def _from_command(self, name: str, rest: float) -> Array:
        """What a channel that reports nothing makes of its command; at rest where the vehicle has no such pedal."""
        channel, has = name.partition("_")[0], (self.vehicle.command, self.vehicle.report)
        if channel == "brake" and not any(name in fields for fields in has):
            return np.full(self.drive.ticks, rest)
        idle = 0.0 if channel == "steer" else rest
        command, _, obeyed = channel_of(self.drive, channel, idle)
        if channel not in self.channels or self.drive.get(f"command.{name}") is None:
            return np.full(self.drive.ticks, np.nan)
        return self._through(channel, command, obeyed, idle)

    def _asked(self, rest: float) -> list[Array]:
        """Pedals and steering of a car that is asked for an acceleration; empty for any other."""
        asked = accel_asked(self.drive)
        if asked is None or "accel" not in self.channels:
            return []
        made = self._through("accel", asked, np.isfinite(asked) & self.drive.enabled, 0.0)
        pedals = (rest + np.maximum(sign * made, 0.0) / FULL_MPS2 for sign in (1.0, -1.0))
        return [*pedals, self._input("steer_rad", 0.0)]

    def _through(self, channel: str, command: Array, obeyed: Array, idle: float) -> Array:
        """A command through its channel where it is obeyed, NaN elsewhere."""
        found = np.full(self.drive.ticks, np.nan)
        params = self.channels[channel].params(idle)
        for begin, end in runs(obeyed, 2):
            found[begin:end] = answered(Way(params), command[begin:end], self.dt_s)
        return found

    def _target(self, name: str) -> Array:
        """A measured signal between its fresh values; the INS's as many rows earlier as it is late."""
        for source in self._sources(name):
            values = self.drive.fields[source]
            fresh = self.drive.fresh[source] & np.isfinite(values)
            if name == "heading_rad":
                values = values.copy()
                values[fresh] = np.unwrap(values[fresh])
            even = between_fresh(values, fresh)
            even[: int(np.argmax(fresh))] = np.nan
            return earlier(even, self.late) if source.startswith("ins.") else even
        wheels = yaw_by_wheels(self.drive, self.vehicle.nominal) if name == "yaw_rate_radps" else None
        if wheels is not None:
            return between_fresh(*wheels)
        return np.full(self.drive.ticks, np.nan)

    def _heard(self) -> Array:
        """Rows at which neither an output nor the speed has been silent for long."""
        good = np.ones(self.drive.ticks, dtype=bool)
        names = [*(f"report.{name}" for name in INPUTS), *self._sources("speed_mps")[:1]]
        for name in names:
            fresh = self.drive.fresh.get(name)
            if fresh is None or not fresh.any():
                continue
            rows = np.append(np.flatnonzero(fresh), self.drive.ticks)  # one that falls silent is silent to the end
            gaps = np.flatnonzero(np.diff(rows) * self.dt_s > LONGEST_SILENCE_S)
            for i in gaps:
                good[rows[i] + 1 : rows[i + 1]] = False
        return good

    def _sources(self, target: str) -> list[str]:
        """Fields that say it, the best first: of several one that speaks often enough to be followed."""
        said = [name for name in SOURCES[target] if np.isfinite(self.drive.fields.get(name, np.nan)).any()]
        seldom = [name for name in said if every_of(self.drive.fresh[name]) * self.dt_s > 0.5 * LONGEST_SILENCE_S]
        return [name for name in said if name not in seldom] + seldom

    def _slope(self) -> Array | None:
        """sin(slope) by the accelerometer: specific force less rate of speed, as far as one is reported."""
        felt = self.drive.get("report.accel_mps2")
        if felt is None or not np.isfinite(felt).any():
            return None
        window = max(round(LOOK_BACK_S / self.dt_s) | 1, 5)
        rate = rate_of(self.speed, np.isfinite(self.speed), window, self.dt_s)
        fresh = self.drive.fresh["report.accel_mps2"]
        found = (between_fresh(felt, fresh) - rate) / G_MPS2
        if mean_noise(found, fresh, round(SLOPE_S / self.dt_s)) > 0.5 * HILL_RAD:
            return None  # it shakes too much to tell a slope
        return found - (self.standing or float(np.clip(np.nanmedian(found), -MOST_BIAS, MOST_BIAS)))

    def on_hill(self, span: slice) -> bool:
        """Whether the road under a window is not level."""
        if self.slope is None:
            return False
        moving = self.slope[span][self.speed[span] > 1.0]
        moving = moving[np.isfinite(moving)]
        return len(moving) > 10 and abs(float(np.median(moving))) > HILL_RAD

    def window(self, span: slice) -> Window:
        """Inputs, start and targets of a window."""
        assert self.inputs is not None
        every = max(round(EVERY_S / self.dt_s), 1)
        at = np.arange(every, span.stop - span.start, every)
        here = self.targets[span].copy()
        start = tuple(self._start(i, span.start) for i in (4, 5, 2, 0, 1))
        x, y, heading, speed, yaw = (0.0 if not np.isfinite(one) else one for one in start)
        return Window(
            self.drive.name,
            span.start,
            self.inputs[span],
            self._before(span.start),
            (x, y, heading, max(speed, 0.0), yaw),
            at,
            here[at],
            self.dt_s,
            self.standing if abs(self.standing) > TOLD else 0.0,
        )

    def _before(self, row: int) -> Array:
        """Throttle up to a row, from where it has been known without a break, BEFORE_S at most."""
        assert self.inputs is not None
        first = max(row - round(BEFORE_S / self.dt_s), 0)
        unknown = np.flatnonzero(~self.throttle_known[first:row])
        return self.inputs[first + (int(unknown[-1]) + 1 if len(unknown) else 0) : row + 1, 0]

    def _start(self, target: int, row: int) -> float:
        """A signal at a row, by a local polynomial about it."""
        half = self.start_window // 2
        first = max(row - half, 0)
        some = self.targets[first : row + half + 1, target]
        if not np.isfinite(some).all():
            return float(self.targets[row, target])
        return (
            float(smooth(some, len(some) if len(some) % 2 else len(some) - 1)[row - first])
            if len(some) >= 5
            else float(some[0])
        )


WIDTH = len(TARGETS)


class Off(NamedTuple):
    """What lies between a reported output and the car: added to the steering wheel (rad), taken off the brake (duty),
    lag of the throttle (s). road_share: of what the accelerometer says throughout (Window.standing) the part that is a
    slope of the road.
    """

    steer_rad: float = 0.0
    brake_frac: float = 0.0
    road_share: float = 0.0
    throttle_lag_s: float = 0.0


@kernel
def run_free(
    params: ChassisParams,
    state: SingleTrackState,
    push: SoftState,
    before: Any,
    inputs: Any,
    off: Off,
    grade_rad: float,
    outputs: Any,
    dt_s: float,
) -> int:
    """Drive the car with rows of (throttle, brake, steer, gear) from row 1 on; rows of TARGETS go into `outputs`. push:
    the lag of the throttle as it was ahead of `before`, the throttle up to row 0.
    """
    road = Disturbance(grade_rad, 1.0)
    for i in range(len(before)):
        push, _ = step_soft(0.0, push, float(before[i]), dt_s)
    rows = len(inputs) // 4
    idle = params.constants.rest_frac
    for i in range(1, rows):
        brake = float(inputs[4 * i + 1]) - off.brake_frac
        if brake < idle:
            brake = idle
        steer = float(inputs[4 * i + 2]) + off.steer_rad
        push, throttle = step_soft(0.0, push, float(inputs[4 * i]), dt_s)
        act = Actuation(throttle, brake, steer, float(inputs[4 * i + 3]))
        state, motion = step_single_track(params, state, ChassisInput(act, road), dt_s)
        outputs[6 * i] = motion.speed_mps
        outputs[6 * i + 1] = motion.yaw_rate_radps
        outputs[6 * i + 2] = motion.heading_rad
        outputs[6 * i + 3] = motion.lateral_accel_mps2
        outputs[6 * i + 4] = motion.x_m
        outputs[6 * i + 5] = motion.y_m
    return rows


kept(run_free)


def simulated(params: ChassisParams, window: Window, off: Off) -> Array:
    """TARGETS [m, 6] of a free run at the window's rows."""
    x_m, y_m, heading, speed, yaw = window.start
    p = params.constants
    grip = p.rear_stiffness * (p.front_axle_m + p.rear_axle_m)
    mass_kg = p.mass_kg * p.front_axle_m
    side = p.rear_axle_m * yaw - mass_kg * speed * speed * yaw / grip  # as it is in a steady turn
    first = Motion(x_m, y_m, heading, speed, side, yaw, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    outputs = np.zeros(len(window.inputs) * WIDTH)
    flat = np.ascontiguousarray(window.inputs).ravel()
    grade_rad = math.asin(max(-1.0, min(off.road_share * window.standing, 1.0)))
    lag = soft(off.throttle_lag_s, float(window.before[0]))  # held for ever at the first throttle that is known
    push, before = lag.init(lag.params, window.dt_s), np.ascontiguousarray(window.before)
    run_free(params, SingleTrackState(first, 0.0), push, before, flat, off, grade_rad, outputs, window.dt_s)
    return outputs.reshape(-1, WIDTH)[window.at]


def errors(params: Mapping[str, float], off: Off, some: Sequence[Window]) -> Array:
    """Simulated minus measured TARGETS [windows, m, 6]; NaN where nothing was measured."""
    chassis = ChassisParams(constants_of(params, BodyChange()))
    return np.stack([simulated(chassis, window, off) - window.targets for window in some])


def rms_of(misses: Array) -> dict[str, float]:
    """Root mean square of each target that was measured."""
    found = {}
    for i, name in enumerate(TARGETS):
        some = misses[:, :, i][np.isfinite(misses[:, :, i])]
        if len(some):
            found[name] = float(np.sqrt(np.mean(some * some)))
    return found
