"""From drives to samples of the open-loop map: (speed, pedal command, the acceleration that the command led to).

The actuation delay is encoded (paper II.B): speed and acceleration are taken a delay after the command, one delay a
pedal, found in the data as the shift with which a static law of speed and command explains the accelerations best: dead
time, the lags' time to half, and transport of frames together. Straight driving in forward gear, level as far as it can
be told, means over 20 samples of 10 ms (apollo_facts 5.2).

What the open-loop map needs of a drive: speed, its rate, both pedals, and which rows are straight and level.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GEAR_DRIVE
from tunefree_hil.learn.data_sheet import channel_sheet
from tunefree_hil.learn.drives.drive import CHASSIS_FIRST_SPEEDS, Drive, name_of
from tunefree_hil.learn.drives.runs import throughout
from tunefree_hil.learn.drives.validity import told

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

THROTTLE, BRAKE = "throttle", "brake"
PEDALS = (THROTTLE, BRAKE)
OTHER = {THROTTLE: BRAKE, BRAKE: THROTTLE}
SIGN = {THROTTLE: 1.0, BRAKE: -1.0}  # of the acceleration that more of a pedal gives

LONGEST_S = 1.0  # of delays that are tried
RELEASED_S = 0.5  # so long the other pedal has been at rest: what it did has died away
HELD_S, HELD_SHARE = 0.3, 0.05  # a pedal is held that so long moves by no more than this share of its way
EVERY_S = 0.05  # neighbouring rows say the same: one of them is kept
KNOTS_MPS = (0.0, 1.0, 2.0, 4.0, 7.0, 10.0, 15.0, 20.0, 30.0)
KNOTS_SHARE = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0)  # of a pedal's way
RIDGE = 1e-6
LEAST_DEPTH = 1.1  # residual without a delay / with the best one, below which the delay is not believed
LEAST_USE_S = 3.0  # with a pedal pressed, straight and level
SURE, ALIKE = 3.0, 10.0  # deviations from which a slope is believed; neighbouring samples that say one thing


class Delay(NamedTuple):
    """From the stamp of a command to its acceleration. found: False where the data sheet's had to be taken."""

    seconds: float
    found: bool
    words: str


class Samples(NamedTuple):
    """What the map is made of. pedal: +1 throttle, -1 brake, 0 both at rest; command_frac: duty of the pedal in use.

    held: 1 where the pedal had hardly moved for a while, so that no lag can blur what it does.
    """

    speed_mps: Array
    command_frac: Array
    accel_mps2: Array
    pedal: Array
    held: Array

    def of(self, pedal: str) -> Samples:
        """Those with this pedal pressed and those with both at rest."""
        mine = (self.pedal == SIGN[pedal]) | (self.pedal == 0.0)
        return Samples(*(column[mine] for column in self))


def samples_of(tracks: Sequence[Track], delays: Mapping[str, Delay], vehicle: VehicleSpec) -> Samples:
    """All samples of these drives. Raises InputError where a pedal was hardly used, or works the wrong way."""
    found = [_samples_of(track, delays, vehicle) for track in tracks]
    samples = Samples(*(np.concatenate(columns) for columns in zip(*found, strict=True)))
    for pedal in PEDALS:
        _require_use(samples, pedal, tracks)
    _require_signs(samples)
    return samples


def find_delay(tracks: Sequence[Track], pedal: str, vehicle: VehicleSpec) -> Delay:
    """The shift of least residual, between ticks by a parabola; the data sheet's where the data show none."""
    dt_s = tracks[0].dt_s
    shifts = round(LONGEST_S / dt_s) + 1
    rest, limit = pedal_limits(vehicle, pedal)
    size = len(KNOTS_MPS) * len(KNOTS_SHARE)
    gram, against, square, rows = np.zeros((size, size)), np.zeros((size, shifts)), np.zeros(shifts), 0
    for track in tracks:
        at = _usable_rows(track, pedal, vehicle, LONGEST_S)
        share = (mean_over(track.pedals[pedal], SMOOTH_S, dt_s)[at] - rest) / (limit - rest)
        basis = _products(_hats(track.speed_mps[at], KNOTS_MPS), _hats(share, KNOTS_SHARE))
        later = track.accel_mps2[at[:, None] + np.arange(shifts)]
        gram += basis.T @ basis
        against += basis.T @ later
        square += np.sum(later * later, axis=0)
        rows += len(at)
    if rows < 4 * size:
        return _of_data_sheet(vehicle, pedal, dt_s, "too few rows to find one")
    law = np.linalg.solve(gram + RIDGE * rows * np.eye(size), against)
    left = square - 2.0 * np.sum(law * against, axis=0) + np.sum(law * (gram @ law), axis=0)
    best = int(np.argmin(left))
    if best in (0, shifts - 1) or left[0] < LEAST_DEPTH * left[best]:
        return _of_data_sheet(vehicle, pedal, dt_s, "the pedal hardly moved, or moved too slowly to show one")
    seconds = dt_s * (best + _vertex(left[best - 1], left[best], left[best + 1]))
    return Delay(seconds, True, f"{pedal}: {1e3 * seconds:.0f} ms from command to acceleration, found in the data")


def _vertex(before: float, lowest: float, after: float) -> float:
    """Where the parabola through three neighbours is lowest, -0.5 to 0.5."""
    bend = before - 2.0 * lowest + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend > 0.0 else 0.0


def _of_data_sheet(vehicle: VehicleSpec, pedal: str, dt_s: float, why: str) -> Delay:
    """Dead time, time constant, and a tick of transport each way."""
    sheet = channel_sheet(vehicle, pedal)
    seconds = 2.0 * dt_s + (sheet.dead_time_s + sheet.lag_s)
    return Delay(seconds, False, f"{pedal}: {1e3 * seconds:.0f} ms of delay as the data sheet says ({why})")


def _usable_rows(track: Track, pedal: str, vehicle: VehicleSpec, ahead_s: float) -> Array:
    """Rows at whose command only this pedal, or none, is pressed, and that stay good for `ahead_s`; one in EVERY_S."""
    dt_s = track.dt_s
    half, ahead = round(0.5 * SMOOTH_S / dt_s), round(ahead_s / dt_s)
    good = throughout(track.good, half, ahead + half)
    alone = throughout(_at_rest(track, OTHER[pedal], vehicle), round(RELEASED_S / dt_s), ahead)
    return np.flatnonzero(good & alone)[:: max(1, round(EVERY_S / dt_s))]


def _at_rest(track: Track, pedal: str, vehicle: VehicleSpec) -> Array:
    rest, limit = pedal_limits(vehicle, pedal)
    return track.pedals[pedal] <= rest + TOUCH_SHARE * (limit - rest)


def _hats(values: Array, knots: Sequence[float]) -> Array:
    """[n, knots]: the weights of linear interpolation between the knots, held at the ends."""
    places = np.interp(values, knots, np.arange(len(knots)))
    return np.clip(1.0 - np.abs(places[:, None] - np.arange(len(knots))), 0.0, 1.0)


def _products(left: Array, right: Array) -> Array:
    """[n, a], [n, b] -> [n, a * b]."""
    return (left[:, :, None] * right[:, None, :]).reshape(len(left), left.shape[1] * right.shape[1])


def _samples_of(track: Track, delays: Mapping[str, Delay], vehicle: VehicleSpec) -> Samples:
    """Of one drive: rows of each pedal, and those with both at rest once."""
    columns: list[tuple[Array, ...]] = []
    for pedal in PEDALS:
        rest, limit = pedal_limits(vehicle, pedal)
        at = _usable_rows(track, pedal, vehicle, delays[pedal].seconds)
        command = mean_over(track.pedals[pedal], SMOOTH_S, track.dt_s)[at]
        still = throughout(_at_rest(track, pedal, vehicle), round(RELEASED_S / track.dt_s), 0)[at]
        pressed = command > rest + TOUCH_SHARE * (limit - rest)
        kept = pressed | still if pedal == THROTTLE else pressed  # rest rows of both are the same ones
        later = at[kept] + delays[pedal].seconds / track.dt_s
        rows = np.arange(len(track.good))
        columns.append(
            (
                np.interp(later, rows, mean_over(track.speed_mps, SMOOTH_S, track.dt_s)),
                np.where(pressed, command, rest)[kept],
                np.interp(later, rows, mean_over(track.accel_mps2, SMOOTH_S, track.dt_s)),
                np.where(pressed, SIGN[pedal], 0.0)[kept],
                is_held(track.pedals[pedal], HELD_SHARE * (limit - rest), track.dt_s)[at[kept]],
            )
        )
    return Samples(*(np.concatenate(parts) for parts in zip(*columns, strict=True)))


def is_held(duty: Array, within: float, dt_s: float) -> Array:
    """1.0 in rows up to which, for HELD_S and the smoothing's reach, the duty stayed `within`; else 0.0."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    ahead = round(0.5 * SMOOTH_S / dt_s)
    before = round(HELD_S / dt_s) + ahead
    rows = before + ahead + 1
    spread = maximum_filter1d(duty, rows) - minimum_filter1d(duty, rows)
    middle = np.clip(np.arange(len(duty)) - (before - ahead) // 2, 0, len(duty) - 1)
    return (spread[middle] <= within).astype(np.float64)


def _require_use(samples: Samples, pedal: str, tracks: Sequence[Track]) -> None:
    """A pedal that was never pressed cannot be learned."""
    used_s = EVERY_S * int(np.sum(samples.pedal == SIGN[pedal]))
    if used_s >= LEAST_USE_S:
        return
    driven_s = sum(len(track.good) * track.dt_s for track in tracks)
    did = "no braking" if pedal == BRAKE else "no throttle"
    said = did if used_s == 0.0 else f"only {used_s:.1f} s with the {pedal} pressed"
    raise InputError(
        f"{said} in {driven_s:.0f} s of logs, straight and level in forward gear: the map needs both pedals",
        code=f"no_{pedal}",
        key="LOG",
        hint=f"drive straight on and press the {pedal} at several speeds, at least {LEAST_USE_S:g} s in all",
    )


def _require_signs(samples: Samples) -> None:
    """More throttle accelerates, more brake slows down; both the other way round is a pair of swapped pedals."""
    found = {pedal: slope_of(samples.of(pedal)) for pedal in PEDALS}
    wrong = [pedal for pedal, (slope, deviation) in found.items() if slope * SIGN[pedal] < -SURE * deviation]
    if not wrong:
        return
    if len(wrong) == len(PEDALS):
        what, code = (
            "throttle and brake seem to be swapped: throttle slows down, brake accelerates",
            "swapped_pedals",
        )
    else:
        does = "slows down" if wrong == [THROTTLE] else "accelerates"
        what, code = f"more {wrong[0]} {does}", "wrong_sign"
    raise InputError(
        f"{what} in these logs (m/s² per duty: throttle {found[THROTTLE][0]:+.1f}, brake {found[BRAKE][0]:+.1f})",
        code=code,
        key="LOG",
        hint="check the signals of command.throttle_frac and command.brake_frac in vehicle.toml, and the vehicle named",
    )


def slope_of(samples: Samples) -> tuple[float, float]:
    """m/s2 per duty at equal speeds, and its standard deviation: least squares beside a square law of the speed."""
    v = samples.speed_mps
    laws = np.stack([np.ones_like(v), v, v * v, samples.command_frac], axis=1)
    inverse = np.linalg.pinv(laws.T @ laws)
    fitted = inverse @ laws.T @ samples.accel_mps2
    left = samples.accel_mps2 - laws @ fitted
    variance = ALIKE * float(np.mean(left * left)) * max(float(inverse[-1, -1]), 0.0)
    return float(fitted[-1]), float(np.sqrt(variance))


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
