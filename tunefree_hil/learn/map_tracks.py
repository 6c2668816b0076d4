"""What the open-loop map needs of a drive: speed, its rate, both pedals, and which rows are straight and level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GEAR_DRIVE
from tunefree_hil.learn.drives import Drive
from tunefree_hil.learn.fields import CHASSIS_FIRST_SPEEDS
from tunefree_hil.learn.series import name_of
from tunefree_hil.learn.told import told

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

Array = np.ndarray

LEAST_MPS = 0.2  # below it frames do not count (apollo_facts 5.1): at standstill a brake shows nothing
SMOOTH_S = 0.2  # 20 samples at 100 Hz (apollo_facts 5.2)
STRAIGHT_SHARE = 0.01  # of the steering limit (apollo_facts 5.2),
BENT_SHARE, BENT_MPS2 = 0.1, 0.4  # or up to here where the lateral acceleration says that it is as good as straight
LEVEL_MPS2, LEVEL_S = 0.25, 2.0  # of gravity along the road, as a mean over this long: a slope of 1.5 degrees
SLOPE_WINDOW_S, SLOPE_ORDER = 0.51, 3  # Savitzky-Golay (apollo_facts 5.3), where only the speed is known
TOUCH_SHARE = 0.005  # of a pedal's way: less is a pedal at rest
LEAST_S = 20.0  # of straight and level driving


class Track(NamedTuple):
    """One drive on its ticks. pedals: duty by 'throttle', 'brake', never below rest; good: rows that may be used.

    moving, straight: for what is said of a drive that is not enough.
    """

    name: str
    dt_s: float
    speed_mps: Array
    accel_mps2: Array
    pedals: Mapping[str, Array]
    good: Array
    moving: Array
    straight: Array


def tracks_of(drives: Sequence[Drive], vehicle: VehicleSpec) -> tuple[list[Track], list[str]]:
    """The drives as tracks, and what is to be said about them. InputError: no pedals, no speed, too little of use."""
    tracks = [track_of(drive, vehicle) for drive in drives]
    moving_s, straight_s, good_s = (
        sum(float(np.sum(getattr(track, kind))) * track.dt_s for track in tracks)
        for kind in ("moving", "straight", "good")
    )
    if good_s < LEAST_S:
        why = "too little straight driving" if straight_s < LEAST_S <= moving_s else "too little driving"
        raise InputError(
            f"{why}: of {moving_s:.0f} s moving {straight_s:.0f} s are straight and {good_s:.0f} s of these of use"
            " (level, forward gear, by-wire channels on)",
            code="too_little_driving",
            file=drives[0].name if len(drives) == 1 else "",
            key="LOG",
            hint=f"the map needs {LEAST_S:g} s at least, better ten minutes: `collect` drives what is missing",
        )
    words = [f"{good_s:.0f} s of {moving_s:.0f} s moving are straight, level and of use"]
    if not any("report.accel_mps2" in drive.fields for drive in drives):
        words.append("the road is taken as level: the vehicle reports no acceleration that gravity shows in")
    return tracks, words


def track_of(drive: Drive, vehicle: VehicleSpec) -> Track:
    """One drive. Raises InputError where it lacks the speed or a pedal."""
    speed = _first(drive, *CHASSIS_FIRST_SPEEDS)
    if speed is None:
        raise InputError(
            "the log holds no speed", code="no_speed", file=drive.name, hint="the map needs report.speed_mps"
        )
    accel = rate_of_speed(drive, speed, vehicle)
    pedals, obeyed = {}, np.ones(drive.ticks, dtype=bool)
    for pedal in ("throttle", "brake"):
        duty, mine = _pedal(drive, pedal)
        pedals[pedal] = np.maximum(duty, pedal_limits(vehicle, pedal)[0])  # NaN stays NaN
        obeyed &= mine
    known = np.isfinite(speed) & np.isfinite(accel) & np.isfinite(pedals["throttle"]) & np.isfinite(pedals["brake"])
    moving = known & (np.nan_to_num(speed) >= LEAST_MPS)
    straight = moving & is_straight(drive, vehicle)
    good = straight & obeyed & is_level(drive, accel) & _forward(drive)
    good &= told(drive, *(name for name in (name_of(drive, CHASSIS_FIRST_SPEEDS),) if name))
    filled = {name: _filled(values) for name, values in pedals.items()}
    return Track(drive.name, drive.dt_s, _filled(speed), _filled(accel), filled, good, moving, straight)


def pedal_limits(vehicle: VehicleSpec, pedal: str) -> tuple[float, float]:
    """(rest, limit) in duty."""
    limit = vehicle.limits.throttle_frac if pedal == "throttle" else vehicle.limits.brake_frac
    return vehicle.nominal.rest_pedal_frac, limit


def _pedal(drive: Drive, pedal: str) -> tuple[Array, Array]:
    """(duty, rows where it counts): the command where by-wire obeys it for most of the drive, else the output.

    A person drives on the pedals themselves: what is commanded meanwhile moves nothing.
    """
    asked, said = name_of(drive, (f"command.{pedal}_frac", f"report.{pedal}_command_frac")), f"report.{pedal}_frac"
    output = drive.get(said)
    if asked is not None and (output is None or float(np.mean(drive.enabled)) >= 0.5):
        return drive.fields[asked], drive.enabled & told(drive, asked)
    if output is not None:
        return output, told(drive, said)
    takes = "command.accel_mps2" in drive.fields
    raise InputError(
        f"the log holds neither command nor report of the {pedal}",
        code="no_pedals",
        file=drive.name,
        key=f"command.{pedal}_frac",
        hint="a vehicle that takes an acceleration needs no map"
        if takes
        else "the map is learned from pedals: is this the vehicle of the log?",
    )


def rate_of_speed(drive: Drive, speed: Array, vehicle: VehicleSpec) -> Array:
    """The INS's, where it is the rate of its speed; else the slope of the speed (Savitzky-Golay). NaN where unknown."""
    own = drive.get("ins.accel_mps2")
    if own is not None and not vehicle.ins["accel_mps2"].specific_force:
        return own
    from scipy.signal import savgol_filter

    window = 2 * round(0.5 * SLOPE_WINDOW_S / drive.dt_s) + 1
    if drive.ticks < window:
        return np.full(drive.ticks, np.nan)
    slope = np.asarray(savgol_filter(_filled(speed), window, SLOPE_ORDER, deriv=1, delta=drive.dt_s))
    return np.where(np.isfinite(speed), slope, np.nan)


def is_straight(drive: Drive, vehicle: VehicleSpec) -> Array:
    """Rows with the wheel within 1 % of its limit, or turned a little with hardly any lateral acceleration."""
    steer = _first(drive, "report.steer_rad", "command.steer_rad")
    lateral = _lateral(drive)
    share = None if steer is None else np.abs(_filled(steer)) / vehicle.limits.steer_rad
    calm = None if lateral is None else np.abs(mean_over(_filled(lateral), SMOOTH_S, drive.dt_s)) < BENT_MPS2
    if share is None:
        return np.ones(drive.ticks, dtype=bool) if calm is None else calm
    centred = share < STRAIGHT_SHARE
    return centred if calm is None else centred | (calm & (share < BENT_SHARE))


def _lateral(drive: Drive) -> Array | None:
    """The reported lateral acceleration, or speed times yaw rate."""
    own = drive.get("report.lateral_accel_mps2")
    if own is not None:
        return own
    speed = _first(drive, *CHASSIS_FIRST_SPEEDS)
    yaw_rate = _first(drive, "report.yaw_rate_radps", "ins.yaw_rate_radps")
    return None if speed is None or yaw_rate is None else speed * yaw_rate


def is_level(drive: Drive, accel: Array) -> Array:
    """Rows where specific force and rate of speed differ by no more than they do on this drive at most places.

    The difference is gravity along the road; what it is in the middle of the drive's values counts as the sensor's
    own offset. All rows where the vehicle reports no specific force.
    """
    force = drive.get("report.accel_mps2")
    if force is None:
        return np.ones(drive.ticks, dtype=bool)
    slope = _filled(force - accel)
    known = np.isfinite(force - accel)
    usual = float(np.median(slope[known])) if known.any() else 0.0
    return np.abs(mean_over(slope - usual, LEVEL_S, drive.dt_s)) < LEVEL_MPS2


def _forward(drive: Drive) -> Array:
    gear = drive.get("report.gear")
    return np.ones(drive.ticks, dtype=bool) if gear is None else _filled(gear) >= GEAR_DRIVE


def _first(drive: Drive, *names: str) -> Array | None:
    """The first of these fields that the drive has."""
    return next((values for name in names if (values := drive.get(name)) is not None), None)


def _filled(values: Array) -> Array:
    """0 for NaN: such rows are not good ones."""
    return np.nan_to_num(values, nan=0.0)


def mean_over(values: Array, window_s: float, dt_s: float) -> Array:
    """The centred moving mean; fewer rows at the ends."""
    rows = max(1, round(window_s / dt_s))
    before = rows // 2
    sums = np.concatenate([[0.0], np.cumsum(values)])
    at = np.arange(len(values))
    low, high = np.maximum(at - before, 0), np.minimum(at + rows - before, len(values))
    return (sums[high] - sums[low]) / (high - low)
