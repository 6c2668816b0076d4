"""Samples of the open-loop map from drives: (speed, pedal command, acceleration).

The actuation delay is encoded (Baidu paper, section II.B): speed and acceleration are taken one delay after the
command. The delay of a pedal is the shift at which a static law of speed and command explains the accelerations best;
it comprises dead time, lags and transport. Only straight and level driving in forward gear is used, averaged over
0.2 s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.signal import savgol_filter

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GEAR_DRIVE
from tunefree_hil.learn.data_sheet import read_channel_sheet
from tunefree_hil.learn.drives.drive import (
    CHASSIS_FIRST_SPEEDS,
    CHASSIS_FIRST_YAW_RATES,
    Array,
    Drive,
    first_field_name,
    first_field_values,
)
from tunefree_hil.learn.drives.runs import true_throughout
from tunefree_hil.learn.drives.validity import valid_rows

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

THROTTLE, BRAKE = "throttle", "brake"
PEDALS = (THROTTLE, BRAKE)
OTHER_PEDAL = {THROTTLE: BRAKE, BRAKE: THROTTLE}
PEDAL_SIGN = {THROTTLE: 1.0, BRAKE: -1.0}  # sign of the acceleration per duty

SMOOTHING_S = 0.2  # moving mean, 20 samples at 100 Hz as in Apollo's data pipeline
SAMPLE_SPACING_S = 0.05
RATE_WINDOW_S, RATE_ORDER = 0.51, 3  # Savitzky-Golay filter, where only the speed is known
KNOTS_MPS = (0.0, 1.0, 2.0, 4.0, 7.0, 10.0, 15.0, 20.0, 30.0)
KNOTS_SHARE = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0)  # of pedal travel
RIDGE = 1e-6


class RowCriteria(NamedTuple):
    """Which rows of a drive are used (docs/results/criteria.md)."""

    min_speed_mps: float = 0.2  # at standstill a brake has no visible effect; as in Apollo's data pipeline
    # of the steering limit, that counts as straight; as in Apollo's data pipeline
    max_straight_steer_share: float = 0.01
    max_gentle_steer_share: float = 0.1  # of the steering limit, that counts as straight below max_gentle_lateral_mps2
    max_gentle_lateral_mps2: float = 0.4  # lateral acceleration that counts as straight
    max_grade_accel_mps2: float = 0.25  # gravity along the road, as a mean over grade_filter_s: a slope of 1.5 degrees
    grade_filter_s: float = 2.0  # length of that mean
    released_share: float = 0.005  # of pedal travel; below it the pedal counts as released
    release_time_s: float = 0.5  # since the release of the other pedal, whose effect has then decayed
    # a pedal that moved by at most max_hold_share for so long counts as held; no lag blurs its effect
    hold_time_s: float = 0.3
    max_hold_share: float = 0.05  # of pedal travel


class DataCriteria(NamedTuple):
    """How much data the map needs (docs/results/criteria.md)."""

    min_usable_s: float = 20.0  # straight and level driving in all
    min_pedal_use_s: float = 3.0  # with a pedal pressed
    max_delay_s: float = 1.0  # longest delay that is tried
    # residual without delay over that at the best one, below which no delay is accepted
    min_residual_ratio: float = 1.1
    min_rows_per_parameter: int = 4  # of the static law
    min_gain_sigmas: float = 3.0  # standard deviations from zero at which the sign of a pedal gain is certain
    correlated_samples: float = 10.0  # consecutive samples that count as one, because neighbours are correlated


ROWS = RowCriteria()
DATA = DataCriteria()


class ActuationDelay(NamedTuple):
    """From the stamp of a command to its acceleration. is_identified: False: it is the data sheet's."""

    seconds: float
    is_identified: bool
    note: str


class MapSamples(NamedTuple):
    """Samples of the map, arrays of shape (n_samples,).

    Attributes:
        command_frac: Duty of the pressed pedal, or at rest.
        pedal: +1 throttle, -1 brake, 0 both released.
        is_held: 1 where the pedal hardly moved, so that no lag blurs its effect; else 0.
    """

    speed_mps: Array
    command_frac: Array
    accel_mps2: Array
    pedal: Array
    is_held: Array

    def select_pedal(self, pedal: str) -> MapSamples:
        """Samples with this pedal pressed or both released."""
        selected = (self.pedal == PEDAL_SIGN[pedal]) | (self.pedal == 0.0)
        return MapSamples(*(column[selected] for column in self))


class PedalGain(NamedTuple):
    """Acceleration per duty at equal speed, m/s2, and its standard deviation."""

    gain_mps2: float
    std_dev: float


class PedalTrack(NamedTuple):
    """Longitudinal signals of a drive on its ticks.

    Attributes:
        accel_mps2: Rate of speed.
        pedals: Duty by 'throttle' and 'brake', never below rest.
        is_good: Usable rows.
        is_moving: Rows in motion (only for messages).
        is_straight: Rows in straight motion (only for messages).
    """

    name: str
    dt_s: float
    speed_mps: Array
    accel_mps2: Array
    pedals: Mapping[str, Array]
    is_good: Array
    is_moving: Array
    is_straight: Array


def make_samples(
    tracks: Sequence[PedalTrack], delays: Mapping[str, ActuationDelay], vehicle: VehicleSpec
) -> MapSamples:
    """All samples of the tracks.

    Raises:
        InputError: A pedal was hardly used, or works the wrong way.
    """
    by_track = [_make_track_samples(track, delays, vehicle) for track in tracks]
    samples = MapSamples(*(np.concatenate(columns) for columns in zip(*by_track, strict=True)))
    for pedal in PEDALS:
        _require_pedal_use(samples, pedal, tracks)
    _require_pedal_signs(samples)
    return samples


def identify_delay(tracks: Sequence[PedalTrack], pedal: str, vehicle: VehicleSpec) -> ActuationDelay:
    """The shift with the least residual, refined by a parabola; the data sheet's delay where the data show none."""
    dt_s = tracks[0].dt_s
    shifts = round(DATA.max_delay_s / dt_s) + 1
    rest, limit = find_pedal_range(vehicle, pedal)
    size = len(KNOTS_MPS) * len(KNOTS_SHARE)
    gram_matrix, cross_products, square, n_rows = np.zeros((size, size)), np.zeros((size, shifts)), np.zeros(shifts), 0
    for track in tracks:
        rows = _find_usable_rows(track, pedal, vehicle, DATA.max_delay_s)
        share = (moving_mean(track.pedals[pedal], SMOOTHING_S, dt_s)[rows] - rest) / (limit - rest)
        basis = _row_products(_hat_weights(track.speed_mps[rows], KNOTS_MPS), _hat_weights(share, KNOTS_SHARE))
        later = track.accel_mps2[rows[:, None] + np.arange(shifts)]
        gram_matrix += basis.T @ basis
        cross_products += basis.T @ later
        square += np.sum(later * later, axis=0)
        n_rows += len(rows)
    if n_rows < DATA.min_rows_per_parameter * size:
        return _delay_from_data_sheet(vehicle, pedal, dt_s, "too few rows to identify one")
    law = np.linalg.solve(gram_matrix + RIDGE * n_rows * np.eye(size), cross_products)
    residual = square - 2.0 * np.sum(law * cross_products, axis=0) + np.sum(law * (gram_matrix @ law), axis=0)
    best = int(np.argmin(residual))
    if best in (0, shifts - 1) or residual[0] < DATA.min_residual_ratio * residual[best]:
        why = "the pedal hardly moved, or moved too slowly to show one"
        return _delay_from_data_sheet(vehicle, pedal, dt_s, why)
    seconds = dt_s * (best + parabola_vertex(residual[best - 1], residual[best], residual[best + 1]))
    note = f"{pedal}: {1e3 * seconds:.0f} ms from command to acceleration, identified from the data"
    return ActuationDelay(seconds, True, note)


def parabola_vertex(before: float, lowest: float, after: float) -> float:
    """Vertex of the parabola through three neighbours, -0.5 to 0.5."""
    curvature = before - 2.0 * lowest + after
    return float(np.clip(0.5 * (before - after) / curvature, -0.5, 0.5)) if curvature > 0.0 else 0.0


def _delay_from_data_sheet(vehicle: VehicleSpec, pedal: str, dt_s: float, why: str) -> ActuationDelay:
    """Dead time, time constant, and one tick of transport each way."""
    sheet = read_channel_sheet(vehicle, pedal)
    seconds = 2.0 * dt_s + (sheet.dead_time_s + sheet.lag_s)
    return ActuationDelay(seconds, False, f"{pedal}: {1e3 * seconds:.0f} ms of delay from the data sheet ({why})")


def _find_usable_rows(track: PedalTrack, pedal: str, vehicle: VehicleSpec, ahead_s: float) -> Array:
    """Rows, SAMPLE_SPACING_S apart, with the other pedal released, that stay usable for `ahead_s`."""
    dt_s = track.dt_s
    half, ahead = round(0.5 * SMOOTHING_S / dt_s), round(ahead_s / dt_s)
    good = true_throughout(track.is_good, half, ahead + half)
    is_released = _is_at_rest(track, OTHER_PEDAL[pedal], vehicle)
    alone = true_throughout(is_released, round(ROWS.release_time_s / dt_s), ahead)
    return np.flatnonzero(good & alone)[:: max(1, round(SAMPLE_SPACING_S / dt_s))]


def _is_at_rest(track: PedalTrack, pedal: str, vehicle: VehicleSpec) -> Array:
    rest, limit = find_pedal_range(vehicle, pedal)
    return track.pedals[pedal] <= rest + ROWS.released_share * (limit - rest)


def _hat_weights(values: Array, knots: Sequence[float]) -> Array:
    """Weights of linear interpolation between the knots, constant beyond them, shape (n_values, n_knots)."""
    positions = np.interp(values, knots, np.arange(len(knots)))
    return np.clip(1.0 - np.abs(positions[:, None] - np.arange(len(knots))), 0.0, 1.0)


def _row_products(left: Array, right: Array) -> Array:
    """Products within rows: shapes (n, a) and (n, b) to (n, a * b)."""
    return (left[:, :, None] * right[:, None, :]).reshape(len(left), left.shape[1] * right.shape[1])


def _make_track_samples(track: PedalTrack, delays: Mapping[str, ActuationDelay], vehicle: VehicleSpec) -> MapSamples:
    """Samples of one track: rows of each pedal, and once those with both released."""
    columns: list[MapSamples] = []
    for pedal in PEDALS:
        rest, limit = find_pedal_range(vehicle, pedal)
        usable = _find_usable_rows(track, pedal, vehicle, delays[pedal].seconds)
        command = moving_mean(track.pedals[pedal], SMOOTHING_S, track.dt_s)[usable]
        is_at_rest = _is_at_rest(track, pedal, vehicle)
        released = true_throughout(is_at_rest, round(ROWS.release_time_s / track.dt_s), 0)[usable]
        pressed = command > rest + ROWS.released_share * (limit - rest)
        selected = pressed | released if pedal == THROTTLE else pressed  # both pedals have the same released rows
        later = usable[selected] + delays[pedal].seconds / track.dt_s
        rows = np.arange(len(track.is_good))
        max_move = ROWS.max_hold_share * (limit - rest)
        columns.append(
            MapSamples(
                speed_mps=np.interp(later, rows, moving_mean(track.speed_mps, SMOOTHING_S, track.dt_s)),
                command_frac=np.where(pressed, command, rest)[selected],
                accel_mps2=np.interp(later, rows, moving_mean(track.accel_mps2, SMOOTHING_S, track.dt_s)),
                pedal=np.where(pressed, PEDAL_SIGN[pedal], 0.0)[selected],
                is_held=is_pedal_held(track.pedals[pedal], max_move, track.dt_s)[usable[selected]],
            )
        )
    return MapSamples(*(np.concatenate(parts) for parts in zip(*columns, strict=True)))


def is_pedal_held(duty: Array, max_move: float, dt_s: float) -> Array:
    """1.0 in rows at which the duty moved by at most `max_move` during hold_time_s and the smoothing; else 0.0."""
    ahead = round(0.5 * SMOOTHING_S / dt_s)
    before = round(ROWS.hold_time_s / dt_s) + ahead
    rows = before + ahead + 1
    spread = maximum_filter1d(duty, rows) - minimum_filter1d(duty, rows)
    middle = np.clip(np.arange(len(duty)) - (before - ahead) // 2, 0, len(duty) - 1)
    return (spread[middle] <= max_move).astype(np.float64)


def _require_pedal_use(samples: MapSamples, pedal: str, tracks: Sequence[PedalTrack]) -> None:
    used_s = SAMPLE_SPACING_S * int(np.sum(samples.pedal == PEDAL_SIGN[pedal]))
    if used_s >= DATA.min_pedal_use_s:
        return
    driven_s = sum(len(track.is_good) * track.dt_s for track in tracks)
    nothing = "no braking" if pedal == BRAKE else "no throttle"
    use = nothing if used_s == 0.0 else f"only {used_s:.1f} s with the {pedal} pressed"
    raise InputError(
        f"{use} in {driven_s:.0f} s of logs, straight and level in forward gear: the map needs both pedals",
        code=f"no_{pedal}",
        key="LOG",
        hint=f"drive straight on and press the {pedal} at several speeds, at least {DATA.min_pedal_use_s:g} s in all",
    )


def _require_pedal_signs(samples: MapSamples) -> None:
    """Raise InputError where more throttle slows down or more brake accelerates."""
    gains = {pedal: fit_pedal_gain(samples.select_pedal(pedal)) for pedal in PEDALS}
    wrong = [
        pedal for pedal, (gain, std_dev) in gains.items() if gain * PEDAL_SIGN[pedal] < -DATA.min_gain_sigmas * std_dev
    ]
    if not wrong:
        return
    if len(wrong) == len(PEDALS):
        code = "swapped_pedals"
        problem = "throttle and brake seem to be swapped: throttle slows down, brake accelerates"
    else:
        code = "wrong_sign"
        problem = f"more {wrong[0]} {'slows down' if wrong == [THROTTLE] else 'accelerates'}"
    throttle, brake = gains[THROTTLE].gain_mps2, gains[BRAKE].gain_mps2
    raise InputError(
        f"{problem} in these logs (m/s² per duty: throttle {throttle:+.1f}, brake {brake:+.1f})",
        code=code,
        key="LOG",
        hint="check the signals of command.throttle_frac and command.brake_frac in vehicle.toml, and the vehicle named",
    )


def fit_pedal_gain(samples: MapSamples) -> PedalGain:
    """Least squares of the acceleration on the command and a square law of the speed."""
    v = samples.speed_mps
    laws = np.stack([np.ones_like(v), v, v * v, samples.command_frac], axis=1)
    inverse = np.linalg.pinv(laws.T @ laws)
    fitted = inverse @ laws.T @ samples.accel_mps2
    residuals = samples.accel_mps2 - laws @ fitted
    variance = DATA.correlated_samples * float(np.mean(residuals * residuals)) * max(float(inverse[-1, -1]), 0.0)
    return PedalGain(float(fitted[-1]), float(np.sqrt(variance)))


def make_pedal_tracks(drives: Sequence[Drive], vehicle: VehicleSpec) -> tuple[list[PedalTrack], list[str]]:
    """The tracks of drives, and notes about them.

    Raises:
        InputError: No pedals, no speed, or too little usable driving.
    """
    tracks = [make_pedal_track(drive, vehicle) for drive in drives]
    moving_s, straight_s, good_s = (
        sum(float(np.sum(getattr(track, kind))) * track.dt_s for track in tracks)
        for kind in ("is_moving", "is_straight", "is_good")
    )
    if good_s < DATA.min_usable_s:
        why = "too little straight driving" if straight_s < DATA.min_usable_s <= moving_s else "too little driving"
        raise InputError(
            f"{why}: of {moving_s:.0f} s moving {straight_s:.0f} s are straight and {good_s:.0f} s of these usable"
            " (level, forward gear, by-wire channels on)",
            code="too_little_driving",
            file=drives[0].name if len(drives) == 1 else "",
            key="LOG",
            hint=f"the map needs {DATA.min_usable_s:g} s at least, better ten minutes:"
            " `collect` drives what is missing",
        )
    notes = [f"{good_s:.0f} s of {moving_s:.0f} s moving are straight, level and usable"]
    if not any("report.accel_mps2" in drive.fields for drive in drives):
        notes.append("the road is taken as level: the vehicle reports no acceleration that gravity shows in")
    return tracks, notes


def make_pedal_track(drive: Drive, vehicle: VehicleSpec) -> PedalTrack:
    """The track of one drive.

    Raises:
        InputError: It has no speed or no pedal.
    """
    speed_name = first_field_name(drive, CHASSIS_FIRST_SPEEDS)
    if speed_name is None:
        raise InputError(
            "the log holds no speed", code="no_speed", file=drive.name, hint="the map needs report.speed_mps"
        )
    speed = drive.fields[speed_name]
    accel = derive_acceleration(drive, speed, vehicle)
    pedals, is_actuated = {}, np.ones(drive.n_rows, dtype=bool)
    for pedal in PEDALS:
        duty, is_valid = _select_pedal_signal(drive, pedal)
        pedals[pedal] = np.maximum(duty, find_pedal_range(vehicle, pedal)[0])  # NaN stays NaN
        is_actuated &= is_valid
    known = np.isfinite(speed) & np.isfinite(accel) & np.isfinite(pedals["throttle"]) & np.isfinite(pedals["brake"])
    moving = known & (np.nan_to_num(speed) >= ROWS.min_speed_mps)
    straight = moving & is_straight(drive, vehicle)
    good = straight & is_actuated & is_level(drive, accel) & _is_forward(drive) & valid_rows(drive, speed_name)
    return PedalTrack(
        name=drive.name,
        dt_s=drive.dt_s,
        speed_mps=np.nan_to_num(speed),
        accel_mps2=np.nan_to_num(accel),
        pedals={name: np.nan_to_num(values) for name, values in pedals.items()},
        is_good=good,
        is_moving=moving,
        is_straight=straight,
    )


def find_pedal_range(vehicle: VehicleSpec, pedal: str) -> tuple[float, float]:
    """Duty at rest and limit."""
    limit = vehicle.limits.throttle_frac if pedal == "throttle" else vehicle.limits.brake_frac
    return vehicle.nominal.rest_pedal_frac, limit


def _select_pedal_signal(drive: Drive, pedal: str) -> tuple[Array, Array]:
    """Duty and its valid rows: the command where by-wire control is on for most of the drive, else the output.

    With a human driver commands have no effect.
    """
    command = first_field_name(drive, (f"command.{pedal}_frac", f"report.{pedal}_command_frac"))
    report = f"report.{pedal}_frac"
    output = drive.get(report)
    if command is not None and (output is None or float(np.mean(drive.enabled)) >= 0.5):
        return drive.fields[command], drive.enabled & valid_rows(drive, command)
    if output is not None:
        return output, valid_rows(drive, report)
    takes_accel = "command.accel_mps2" in drive.fields
    raise InputError(
        f"the log holds neither command nor report of the {pedal}",
        code="no_pedals",
        file=drive.name,
        key=f"command.{pedal}_frac",
        hint="a vehicle that takes an acceleration needs no map"
        if takes_accel
        else "the map is learned from pedals: is this the vehicle of the log?",
    )


def derive_acceleration(drive: Drive, speed: Array, vehicle: VehicleSpec) -> Array:
    """Rate of speed: of the INS if it reports that, else by a Savitzky-Golay filter; NaN where unknown."""
    reported = drive.get("ins.accel_mps2")
    if reported is not None and not vehicle.ins["accel_mps2"].specific_force:
        return reported
    window = 2 * round(0.5 * RATE_WINDOW_S / drive.dt_s) + 1
    if drive.n_rows < window:
        return np.full(drive.n_rows, np.nan)
    rate = np.asarray(savgol_filter(np.nan_to_num(speed), window, RATE_ORDER, deriv=1, delta=drive.dt_s))
    return np.where(np.isfinite(speed), rate, np.nan)


def is_straight(drive: Drive, vehicle: VehicleSpec) -> Array:
    """Rows with the steering wheel centred, or turned a little with hardly any lateral acceleration."""
    steer = first_field_values(drive, ("report.steer_rad", "command.steer_rad"))
    lateral = _lateral_acceleration(drive)
    share = None if steer is None else np.abs(np.nan_to_num(steer)) / vehicle.limits.steer_rad
    gentle = None
    if lateral is not None:
        gentle = np.abs(moving_mean(np.nan_to_num(lateral), SMOOTHING_S, drive.dt_s)) < ROWS.max_gentle_lateral_mps2
    if share is None:
        return np.ones(drive.n_rows, dtype=bool) if gentle is None else gentle
    centred = share < ROWS.max_straight_steer_share
    return centred if gentle is None else centred | (gentle & (share < ROWS.max_gentle_steer_share))


def _lateral_acceleration(drive: Drive) -> Array | None:
    """As reported, or speed times yaw rate."""
    reported = drive.get("report.lateral_accel_mps2")
    if reported is not None:
        return reported
    speed = first_field_values(drive, CHASSIS_FIRST_SPEEDS)
    yaw_rate = first_field_values(drive, CHASSIS_FIRST_YAW_RATES)
    return None if speed is None or yaw_rate is None else speed * yaw_rate


def is_level(drive: Drive, accel: Array) -> Array:
    """Rows where specific force minus rate of speed is close to its median over the drive.

    The difference is gravity along the road; its median counts as the sensor offset. All rows are level where the
    vehicle reports no specific force.
    """
    force = drive.get("report.accel_mps2")
    if force is None:
        return np.ones(drive.n_rows, dtype=bool)
    gravity = np.nan_to_num(force - accel)
    known = np.isfinite(force - accel)
    offset = float(np.median(gravity[known])) if known.any() else 0.0
    return np.abs(moving_mean(gravity - offset, ROWS.grade_filter_s, drive.dt_s)) < ROWS.max_grade_accel_mps2


def _is_forward(drive: Drive) -> Array:
    gear = drive.get("report.gear")
    return np.ones(drive.n_rows, dtype=bool) if gear is None else np.nan_to_num(gear) >= GEAR_DRIVE


def moving_mean(values: Array, window_s: float, dt_s: float) -> Array:
    """The centred moving mean; over fewer rows at the ends."""
    rows = max(1, round(window_s / dt_s))
    before = rows // 2
    sums = np.concatenate([[0.0], np.cumsum(values)])
    index = np.arange(len(values))
    low, high = np.maximum(index - before, 0), np.minimum(index + rows - before, len(values))
    return (sums[high] - sums[low]) / (high - low)
