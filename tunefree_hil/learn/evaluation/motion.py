"""What a stretch of a drive says of the motion and of what caused it, aligned: the ground of training and free run.

Row k of a track is one instant of the vehicle: its motion as reported in tick k, and the commands that acted during the
step that led there (from row k - 1 to row k), in the frame of time of learn/actuators/samples.py.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base import parts
from tunefree_hil.base.contracts import BodyChange, make_effect
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block, series
from tunefree_hil.base.records import GEAR_DRIVE
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.config.schema import ActuatorSpec, ModelSpec, VehicleSpec, value_of
from tunefree_hil.learn.actuators.samples import accel_asked, asked_pedals, channel_of
from tunefree_hil.learn.data_sheet import rear_behind_m
from tunefree_hil.learn.drives.drive import INS_FIRST_SPEEDS, INS_FIRST_YAW_RATES, Array, Drive, Part
from tunefree_hil.learn.drives.road_slope import offset_of
from tunefree_hil.learn.drives.runs import runs
from tunefree_hil.learn.drives.smoothing import between_fresh, earlier, first_between_fresh, mean_noise, yaw_by_wheels
from tunefree_hil.learn.drives.validity import DRIVEN_BY, POSE, acted_told, between_poses, motion_told
from tunefree_hil.plant.actuation.acceleration_interface import pedals_of
from tunefree_hil.plant.actuation.actuators import ActuatorParams, actuator

WINDOW, ORDER = 51, 3  # Savitzky-Golay of the labels (apollo_facts 5.3)
GRADE_ROWS = 201  # the accelerometer's view of the road is smoothed over these
HILL_RAD = 0.015  # from here on a stretch counts as a hill; what a bias leaves (learn/drives/road_slope.py) is below it
MOST_DOUBT_RAD = 0.5 * HILL_RAD  # of a slope: an accelerometer that shakes more than that says nothing about the road
SLOW_MPS = 1.0  # below it an accelerometer says little about the road: stick, pitch, brakes
SETTLED_S = 10.0  # for which an effect behind an actuator has had its first value, so that it begins as if for ever


class Track(NamedTuple):
    """A stretch without gaps. All arrays have a row a tick, unless said otherwise.

    heading_rad is continuous; accel_mps2 the rate of speed; speed, yaw rate and accel are Savitzky-Golay smoothed.
    grade_rad: what the accelerometer says beyond the rate of speed, 0 on what counts as level. commands, recorded:
    [n, 3] throttle, brake (duty), steer (rad): what was asked, and what the report says was put out (NaN where it says
    nothing). obeyed: [n, 3] whether the command acted (else the recorded output is all there is). good: fit for use.
    placed: whether position and heading were measured and not summed up from speed and yaw rate. asked_mps2: of a car
    that is asked for an acceleration what was asked, [n]; its pedals in `commands` are those of plant/actuation/acceleration_interface.py.
    """

    name: str
    log_hash: str
    begin: int  # row of the drive
    dt_s: float
    speed_mps: Array
    yaw_rate_radps: Array
    accel_mps2: Array
    heading_rad: Array
    x_m: Array
    y_m: Array
    grade_rad: Array
    commands: Array
    recorded: Array
    obeyed: Array
    good: Array
    placed: bool
    asked_mps2: Array | None = None

    @property
    def rows(self) -> int:
        """How many."""
        return len(self.speed_mps)


def tracks_of(parts: Iterable[Part], vehicle: VehicleSpec, least_rows: int = 0, road_share: float = 0.0) -> list[Track]:
    """A track of every part that is long enough (at least WINDOW rows).

    road_share: of what an accelerometer says wherever the car heads (learn/drives/road_slope.py) the part that is a slope. Raises
    InputError where the vehicle reports no speed or no yaw rate at all.
    """
    least = max(least_rows, WINDOW)
    return [track_of(part, vehicle, road_share) for part in parts if part.end - part.begin >= least]


def track_of(part: Part, vehicle: VehicleSpec, road_share: float = 0.0) -> Track:
    """One stretch; see Track, and tracks_of."""
    drive, cut = part.drive, slice(part.begin, part.end)
    late = round(vehicle.ins_frame.latency_s / drive.dt_s)
    driven = _first(drive, INS_FIRST_SPEEDS, late)[cut]
    speed, accel = smooth(driven), smooth(driven, drive.dt_s)
    yaw = smooth(_yaw_rate(drive, vehicle, late)[cut])
    heading, x, y, placed = _pose(drive, cut, late, speed, yaw)
    rest = vehicle.nominal.rest_pedal_frac
    columns = [channel_of(drive, name, 0.0 if name == "steer" else rest) for name in DRIVEN_BY]
    asked = accel_asked(drive)
    if asked is not None:
        columns[:2] = asked_pedals(asked, drive.enabled, rest)
    commands, recorded, obeyed = (np.stack([one[i][cut] for one in columns], axis=1) for i in range(3))
    usable = np.where(obeyed, commands, recorded)
    good = np.isfinite(np.stack([speed, yaw, accel, heading, x, y], axis=1)).all(axis=1)
    good &= np.isfinite(usable).all(axis=1) & (speed > -0.1)
    good &= (motion_told(drive, late, placed) & acted_told(drive, [one[2] for one in columns]))[cut]
    gear = drive.get("report.gear")
    if gear is not None and not np.isnan(gear).all():
        good &= gear[cut] == GEAR_DRIVE
    grade = _grade(drive, cut, speed, yaw, accel, vehicle, (1.0 - road_share) * offset_of(drive, vehicle))
    return Track(
        drive.name, drive.log_hash, part.begin, drive.dt_s, np.maximum(speed, 0.0), yaw, accel, heading, x, y, grade,
        commands, recorded, obeyed, good, placed, None if asked is None else asked[cut],
    )  # fmt: skip


def smooth(values: Array, dt_s: float = 0.0) -> Array:
    """Savitzky-Golay over the finite rows, or with dt_s its rate per s; NaN where fewer than WINDOW lie together."""
    from scipy.signal import savgol_filter

    found = np.full(len(values), np.nan)
    for begin, end in runs(np.isfinite(values)):
        if end - begin >= WINDOW:
            more = {"deriv": 1, "delta": dt_s} if dt_s else {}
            found[begin:end] = savgol_filter(values[begin:end], WINDOW, ORDER, **more)
    return found


def _first(drive: Drive, names: Sequence[str], late: int) -> Array:
    """The first field that says anything; what the INS says stands `late` rows too low and is moved up."""
    even = first_between_fresh(drive, names, late)
    if even is not None:
        return even
    raise InputError(
        f"the logs say nothing of {' or '.join(names)}",
        code="no_motion",
        file=drive.name,
        key=names[0],
        hint="speed and yaw rate are needed, from the chassis or from an INS",
    )


def _yaw_rate(drive: Drive, vehicle: VehicleSpec, late: int) -> Array:
    """The INS's, the chassis's, or what the rear wheels make of it."""
    wheels = yaw_by_wheels(drive, vehicle.nominal)
    if wheels is not None and all(drive.get(name) is None for name in INS_FIRST_YAW_RATES):
        return between_fresh(*wheels)
    return _first(drive, INS_FIRST_YAW_RATES, late)


def _pose(drive: Drive, cut: slice, late: int, speed: Array, yaw: Array) -> tuple[Array, Array, Array, bool]:
    """(heading, x, y, measured): the INS's, smoothed, or summed up from speed and yaw rate where it has none."""
    found = [drive.get(name) for name in POSE]
    if all(one is not None and not np.isnan(one).all() for one in found):
        heading, x, y = (earlier(one, late)[cut] for one in between_poses(drive))
        return smooth(heading), smooth(x), smooth(y), True
    mean_yaw = 0.5 * (yaw[1:] + yaw[:-1])
    heading = np.concatenate([[0.0], np.cumsum(np.nan_to_num(mean_yaw) * drive.dt_s)])
    middle, along = 0.5 * (heading[1:] + heading[:-1]), np.nan_to_num(0.5 * (speed[1:] + speed[:-1])) * drive.dt_s
    x = np.concatenate([[0.0], np.cumsum(along * np.cos(middle))])
    y = np.concatenate([[0.0], np.cumsum(along * np.sin(middle))])
    return heading, x, y, False


def _grade(drive: Drive, cut: slice, speed: Array, yaw: Array, accel: Array, vehicle: VehicleSpec, own: float) -> Array:
    """Slope of the road from specific force beyond the rate of speed; 0 where it is level, slow or not measured. own:
    what the accelerometer says too much, in g.
    """
    said = drive.get("report.accel_mps2")
    flat = np.zeros(len(speed))
    if said is None or len(speed) < GRADE_ROWS:
        return flat
    outwards_mps2 = rear_behind_m(vehicle.nominal) * yaw * yaw  # the centre of mass slides outwards at b * yaw rate
    beyond = (said[cut] - accel + outwards_mps2) / G_MPS2
    beyond -= own
    usable = np.isfinite(beyond) & (speed > SLOW_MPS)
    if mean_noise(np.where(usable, beyond, np.nan), drive.fresh["report.accel_mps2"][cut], GRADE_ROWS) > MOST_DOUBT_RAD:
        return flat
    weight = np.convolve(usable, np.ones(GRADE_ROWS), "same")
    mean = np.convolve(np.where(usable, beyond, 0.0), np.ones(GRADE_ROWS), "same") / np.maximum(weight, 1.0)
    slope = np.arcsin(np.clip(mean, -0.5, 0.5))
    return np.where((weight > 0.25 * GRADE_ROWS) & (abs(slope) >= HILL_RAD), slope, flat)


def actuator_params(spec: ActuatorSpec, rest: float, initial: float) -> ActuatorParams:
    """The kernel's params of a channel of [actuators] that has held `initial` for ever."""
    values = {
        name: float(value_of(getattr(spec, name))) for name in spec.__struct_fields__ if name in ActuatorParams._fields
    }
    return ActuatorParams(**values)._replace(rest=rest, initial=initial)


def outputs_of(track: Track, model: ModelSpec, rest: float, identity: bool = False) -> Array:
    """[n, 3]: what the model's own actuators, and its effects before and behind them, make of the commands.

    Where the vehicle did not obey its commands (or had none) the recorded output stands for that of the actuator, and
    has the effects behind it all the same. identity: a plant that takes commands (kind paper) has no actuators.
    """
    found = np.stack(
        [_as_felt(track, model, i, 0.0 if name == "steer" else rest) for i, name in enumerate(DRIVEN_BY)], axis=1
    )
    by_accel = track.asked_mps2 is not None and not identity
    for column, name in enumerate(DRIVEN_BY):
        if by_accel and name != "steer":
            continue
        idle = 0.0 if name == "steer" else rest
        for begin, end in runs(track.obeyed[:, column]):
            commands = track.commands[begin:end, column]
            block = _channel_block(model, name, idle, float(commands[0]), identity)
            found[begin:end, column] = _driven(block, commands, track.dt_s)
    if by_accel:
        _by_accel(track, model, rest, found)
    return found


def _as_felt(track: Track, model: ModelSpec, column: int, idle: float) -> Array:
    """[n]: the recorded outputs of a channel with the effects that lie between them and the car, where it did not obey.
    These have had the first value for long.
    """
    found = np.array(track.recorded[:, column], dtype=np.float64)
    if behind := _effects_at(model, f"{DRIVEN_BY[column]} B", idle):
        before = math.ceil(SETTLED_S / track.dt_s)
        for begin, end in runs(~track.obeyed[:, column] & np.isfinite(found)):
            held = np.concatenate([np.full(before, found[begin]), found[begin:end]])
            found[begin:end] = _driven(_in_series(behind), held, track.dt_s)[before:]
    return found


def _by_accel(track: Track, model: ModelSpec, rest: float, found: Array) -> None:
    """Fill in the pedals of a car that is asked for an acceleration: through its channel 'accel'."""
    assert track.asked_mps2 is not None
    for begin, end in runs(track.obeyed[:, 0]):
        asked = track.asked_mps2[begin:end]
        block = _channel_block(model, "accel", 0.0, float(asked[0]), False)
        made = _driven(block, asked, track.dt_s)
        found[begin:end, :2] = [pedals_of(accel_mps2, rest) for accel_mps2 in made]


def body_change(model: ModelSpec) -> BodyChange:
    """What the model's effects change of the body and its forces."""
    change = BodyChange()
    for spec in model.effects:
        made = make_effect(parts.load("tunefree_hil.effects", spec.name, "EFFECT"), spec.params, name=spec.name)
        if not isinstance(made, Block):
            change = made(change)
    return change


def _channel_block(model: ModelSpec, name: str, rest: float, initial: float, identity: bool) -> Block:
    """Effects A, actuator, effects on its output, effects B of one channel, in series."""
    before, ends, behind = (_effects_at(model, f"{name} {place}", rest) for place in ("A", "out A", "B"))
    spec = model.actuators.get(name, ActuatorSpec())
    own = ActuatorParams(rest=rest, initial=initial) if identity else actuator_params(spec, rest, initial)
    return _in_series([*before, actuator(own), *ends, *behind])


def _effects_at(model: ModelSpec, port: str, rest: float) -> list[Block]:
    """The model's own effects at a port, in its order."""
    found = []
    for spec in model.effects:
        effect = parts.load("tunefree_hil.effects", spec.name, "EFFECT")
        made = make_effect(effect, spec.params, rest=rest, name=spec.name) if effect.port.value == port else None
        if isinstance(made, Block):
            found.append(made)
    return found


def _in_series(chain: Sequence[Block]) -> Block:
    block = chain[0]
    for one in chain[1:]:
        block = series(block, one)
    return block


def _driven(block: Block, commands: Array, dt_s: float) -> list[float]:
    step, params, outputs = block.step, block.params, []
    state = block.init(params, dt_s)
    for command in commands.tolist():
        state, output = step(params, state, command, dt_s)
        outputs.append(output)
    return outputs


def starts_of(track: Track, warm_rows: int, ahead_rows: int, every_rows: int) -> list[int]:
    """Rows at which a free run can begin: good from warm_rows before to ahead_rows behind, and moving."""
    found = []
    for begin, end in runs(track.good):
        for row in range(begin + warm_rows, end - ahead_rows, every_rows):
            if float(track.speed_mps[row : row + ahead_rows + 1].mean()) > 0.3:
                found.append(row)
    return found


def is_hill(track: Track, row: int, ahead_rows: int) -> bool:
    """Whether the road ahead of a start is not level."""
    return bool(np.any(track.grade_rad[row : row + ahead_rows + 1]))


def wrapped(angle_rad: Array) -> Array:
    """The same angles within [-pi, pi)."""
    return (np.asarray(angle_rad) + math.pi) % (2.0 * math.pi) - math.pi
