"""Whether the signals of a drive agree with each other: units, signs and pedals (learn/checks/drive_checks.py)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tunefree_hil.config.import_schema import si_unit
from tunefree_hil.episode.plausible import HIGHEST, HIGHEST_OF, check_units
from tunefree_hil.episode.plausible_pairs import Pair, pairs_of
from tunefree_hil.learn.checks.problem import LogProblem
from tunefree_hil.learn.checks.stuck_signals import check_stuck_signals
from tunefree_hil.learn.drives.drive import (
    BRAKE_FIELDS,
    CHASSIS_FIRST_SPEEDS,
    STEER_FIELDS,
    THROTTLE_FIELDS,
    Array,
    Drive,
    csv_drive_from_drive,
    first_field_name,
    first_field_values,
    moving_rows,
    reversing_rows,
)
from tunefree_hil.learn.drives.runs import true_throughout
from tunefree_hil.learn.drives.smoothing import interpolate_fresh

if TYPE_CHECKING:
    from tunefree_hil.config.schema import NominalSpec, VehicleSpec


STEER = "report.steer_rad"
STEERING_CHECK = "steer_and_yaw_rate"
WARNING_CHECKS = ("accel_and_speed",)  # a hill changes only one of the two
# Wheelbase in m and steering ratio of an unknown vehicle, between a scale model's and a van's: good enough for a sign.
DEFAULT_WHEELBASE_M, DEFAULT_STEER_RATIO = 1.0, 40.0


class ConsistencyCriteria(NamedTuple):
    """When signals can be compared; every value is an engineering choice."""

    min_steer_range_share: float = 0.05  # of the largest angle, to judge a sign: an offset may be as large
    min_pressed_frac: float = 0.03  # above rest, from which on a pedal is pressed
    max_released_frac: float = 0.01  # above rest, up to which a pedal is released
    delay_s: float = 0.1  # until a pedal acts on the speed, or a steering command on the wheel
    accel_window_s: float = 0.5  # over which the effect of a pedal is measured
    min_pressed_s: float = 1.0  # of comparable rows, in all
    min_accel_difference_mps2: float = 0.2  # between the effects of two pedals
    min_accel_std_mps2: float = 0.2  # standard deviation that shows a change of acceleration
    min_pedal_std_frac: float = 0.03  # standard deviation that shows a moving pedal
    # of a pedal or a commanded acceleration with the measured one: below it the sign is wrong
    max_wrong_correlation: float = -0.5


class SteerTrackingCriteria(NamedTuple):
    """When a reported steering angle follows its command at least sometimes; every value is an engineering choice."""

    move_s: float = 0.1  # over which moves are compared
    min_move_share: float = 0.3  # of the largest move of the command, that a compared one has
    min_followed_share: float = 0.67  # of a command's move or angle, that the report must reach
    min_followed_s: float = 0.5  # of moves that are followed, in all
    min_followed_moves_share: float = 0.05  # of the compared moves; chance reaches fewer
    max_inside_share: float = 0.7  # of the largest reported angle, up to which an angle is far inside
    min_inside_share: float = 0.2  # of it, from which on an angle is compared
    min_inside_s: float = 2.0  # of angles far inside, in all


CONSISTENCY = ConsistencyCriteria()
STEER_TRACKING = SteerTrackingCriteria()


def check_consistency(drive: Drive, vehicle: VehicleSpec) -> Iterator[LogProblem]:
    """All problems of one drive. Signals that hardly change are not checked."""
    yield from _check_ranges(drive)
    yield from _check_pairs(drive, vehicle.nominal, vehicle.limits.steer_rad)
    yield from _check_pedals(drive, vehicle.nominal.rest_pedal_frac)
    yield from _check_accel_command(drive)
    yield from check_stuck_signals(drive)


def _check_ranges(drive: Drive) -> Iterator[LogProblem]:
    """Impossibly large values, which mean a wrong unit."""
    for name, values in drive.fields.items():
        field = name.partition(".")[2]
        highest = HIGHEST_OF.get(field, HIGHEST.get(si_unit(field)))
        sizes = np.abs(values[drive.fresh[name] & np.isfinite(values)])
        if highest is not None and sizes.size and sizes.max() > highest:
            message = (
                f"{drive.path}: {name} reaches {sizes.max():.4g}, but at most {highest:g} is expected; check its unit "
                "and scale in vehicle.toml"
            )
            yield LogProblem("refuse", "units", drive.name, name, message)


def _check_pairs(drive: Drive, nominal: NominalSpec, max_steer_rad: float) -> Iterator[LogProblem]:
    """Fields that measure the same quantity and do not agree."""
    steer = first_field_name(drive, STEER_FIELDS)
    substitutes = {STEER: steer} if steer and STEER not in drive.fields else {}
    columns = csv_drive_from_drive(drive, substitutes)
    is_known = bool(nominal.wheelbase_m and nominal.steer_ratio)
    wheelbase_m = nominal.wheelbase_m if is_known else DEFAULT_WHEELBASE_M
    steer_ratio = nominal.steer_ratio if is_known else DEFAULT_STEER_RATIO
    constants = (wheelbase_m, steer_ratio, nominal.wheel_radius_m)
    pairs = [pair for pair in pairs_of(*constants) if all(name in columns.columns for name in _fields_of(pair))]
    findings = [finding for finding in check_units(columns, *constants) if finding.check != "range"]
    substituted = {*substitutes, *substitutes.values()}
    for pair, finding in zip(pairs, findings, strict=True):
        holds, factor = finding.holds, finding.factor
        if holds is None or factor is None or set(_fields_of(pair)) <= substituted:
            continue
        if pair.check == STEERING_CHECK and not is_known:
            # for an unknown vehicle only the sign counts, and that only where steering angles are large enough
            steer_range = np.ptp(drive.fields[steer or STEER][moving_rows(drive)])
            if steer_range < CONSISTENCY.min_steer_range_share * max_steer_rad:
                continue
            holds = factor > 0.0
        if not holds:
            yield _describe_mismatch(drive, pair, factor, substitutes)


def _fields_of(pair: Pair) -> tuple[str, ...]:
    return (*pair.first, *pair.second)


def _describe_mismatch(drive: Drive, pair: Pair, factor: float, substitutes: Mapping[str, str]) -> LogProblem:
    """A pair whose ratio is not allowed. substitutes: by the name of a field, the one that stands in for it."""
    first, second = (" and ".join(substitutes.get(name, name) for name in names) for names in (pair.first, pair.second))
    field = substitutes.get(pair.first[0], pair.first[0])
    low, high = pair.allowed
    if factor < 0.0:
        code = "steer_sign" if "steer" in first else "wrong_sign"
        message = (
            f"{drive.path}: {second} has the opposite sign of {first} (factor {factor:.2f}), but the same sign is "
            "expected (ISO 8855: left and forward are positive); change the sign of one of them in vehicle.toml"
        )
    else:
        # a wrong unit scales every move; a wheel that stops short of its command may be a property of the car
        is_steer = not substitutes and pair.second == (STEER,)
        is_short = is_steer and factor < low and _follows_command_sometimes(drive, pair.first[0])
        code = "short_of_command" if is_short else "units"
        message = (
            f"{drive.path}: {second} is {factor:.3g} times what is expected from {first} (allowed {low:.2g} to "
            f"{high:.2g}); check units and scales in vehicle.toml, and whether the log is of this vehicle"
        )
    return LogProblem("warn" if pair.check in WARNING_CHECKS else "refuse", code, drive.name, field, message)


def _follows_command_sometimes(drive: Drive, command_name: str) -> bool:
    """Whether the reported steering follows its command part of the time, as with a stop, a slow motor or play.

    With a wrong unit every move and every angle would be too small.
    """
    criteria = STEER_TRACKING
    command, report = (interpolate_fresh(drive.fields[name], drive.fresh[name]) for name in (command_name, STEER))
    delay, window = round(CONSISTENCY.delay_s / drive.dt_s), max(1, round(criteria.move_s / drive.dt_s))
    if drive.n_rows <= 2 * (delay + window):
        return False
    command_move = (command[window:] - command[:-window])[: -delay or None]
    report_move = (report[window:] - report[:-window])[delay:]
    is_large = np.abs(command_move) > criteria.min_move_share * np.nanmax(np.abs(command_move), initial=0.0)
    is_followed = report_move[is_large] / command_move[is_large] > criteria.min_followed_share
    followed_s = is_followed.sum() * drive.dt_s
    follows_moves = bool(
        followed_s > criteria.min_followed_s and is_followed.mean() > criteria.min_followed_moves_share
    )
    return follows_moves or _reaches_small_angles(command[: -delay or None], report[delay:], drive.dt_s)


def _reaches_small_angles(command: Array, report: Array, dt_s: float) -> bool:
    """Whether angles far inside of the reported range match their command.

    A wheel that most commands drive against its stop makes few complete moves.
    """
    criteria = STEER_TRACKING
    largest = np.nanmax(np.abs(report), initial=0.0)
    is_inside = np.isfinite(report) & (np.abs(command) < criteria.max_inside_share * largest)
    is_inside &= np.abs(command) > criteria.min_inside_share * largest
    if is_inside.sum() * dt_s <= criteria.min_inside_s:
        return False
    return float(np.median(report[is_inside] / command[is_inside])) > criteria.min_followed_share


def _check_pedals(drive: Drive, rest_frac: float) -> Iterator[LogProblem]:
    """Whether the throttle accelerates and the brake decelerates, by every source of both."""
    accel = _following_accel(drive)
    if accel is None:
        return
    for throttle_name, brake_name in zip(THROTTLE_FIELDS, BRAKE_FIELDS, strict=True):
        throttle, brake = drive.get(throttle_name), drive.get(brake_name)
        if throttle is None:
            continue
        rows = _judged_rows(drive, accel, by_command=throttle_name.startswith("command."))
        if brake is None:
            yield from _check_single_pedal(drive, throttle_name, accel, rows)
            continue
        pressed_frac = rest_frac + CONSISTENCY.min_pressed_frac
        released_frac = rest_frac + CONSISTENCY.max_released_frac
        is_driven = rows & _stays_pressed((throttle > pressed_frac) & (brake < released_frac), drive.dt_s)
        is_braked = rows & _stays_pressed((brake > pressed_frac) & (throttle < released_frac), drive.dt_s)
        if min(is_driven.sum(), is_braked.sum()) * drive.dt_s < CONSISTENCY.min_pressed_s:
            continue
        throttle_accel, brake_accel = float(accel[is_driven].mean()), float(accel[is_braked].mean())
        if throttle_accel < brake_accel - CONSISTENCY.min_accel_difference_mps2:
            message = (
                f"{drive.path}: with {throttle_name} pressed the speed changes by {throttle_accel:+.2f} m/s^2 and with "
                f"{brake_name} by {brake_accel:+.2f} m/s^2, but the throttle is expected to accelerate: swapped "
                "pedals; swap them in vehicle.toml"
            )
            yield LogProblem("refuse", "swapped_pedals", drive.name, throttle_name, message)


def _check_single_pedal(drive: Drive, name: str, accel: Array, rows: Array) -> Iterator[LogProblem]:
    """For a vehicle without a brake: more throttle must not decelerate."""
    throttle = drive.fields[name]
    is_short = rows.sum() * drive.dt_s < CONSISTENCY.min_pressed_s
    if is_short or np.std(throttle[rows]) < CONSISTENCY.min_pedal_std_frac:
        return
    if np.std(accel[rows]) > CONSISTENCY.min_accel_std_mps2:
        remedy = "check whether it is the brake, or has the wrong sign"
        yield from _refuse_wrong_correlation(drive, name, _correlation(throttle[rows], accel[rows]), remedy)


def _check_accel_command(drive: Drive) -> Iterator[LogProblem]:
    """Whether the vehicle accelerates in the direction of a commanded acceleration."""
    name, accel = "command.accel_mps2", _following_accel(drive)
    command = drive.get(name)
    if command is None or accel is None:
        return
    rows = _judged_rows(drive, accel, by_command=True) & np.isfinite(command)
    if rows.sum() * drive.dt_s < CONSISTENCY.min_pressed_s:
        return
    if min(np.std(command[rows]), np.std(accel[rows])) < CONSISTENCY.min_accel_std_mps2:
        return
    remedy = "change its sign in vehicle.toml"
    yield from _refuse_wrong_correlation(drive, name, _correlation(command[rows], accel[rows]), remedy)


def _refuse_wrong_correlation(drive: Drive, name: str, correlation: float, remedy: str) -> Iterator[LogProblem]:
    if correlation < CONSISTENCY.max_wrong_correlation:
        message = (
            f"{drive.path}: the speed falls when {name} rises (correlation {correlation:.2f}), but it is expected to "
            f"rise; {remedy}"
        )
        yield LogProblem("refuse", "swapped_pedals", drive.name, name, message)


def _following_accel(drive: Drive) -> Array | None:
    """The rate of speed after the delay, shape (n_rows,), NaN at the end; None without a speed."""
    speed = first_field_values(drive, CHASSIS_FIRST_SPEEDS)
    if speed is None:
        return None
    delay, window = _effect_rows(drive.dt_s)
    accel = np.full(drive.n_rows, np.nan)
    rows = max(0, drive.n_rows - delay - window)
    accel[:rows] = (speed[delay + window :][:rows] - speed[delay:][:rows]) / (window * drive.dt_s)
    return accel


def _effect_rows(dt_s: float) -> tuple[int, int]:
    """(rows until a pedal acts, rows over which its effect is measured)."""
    return round(CONSISTENCY.delay_s / dt_s), max(1, round(CONSISTENCY.accel_window_s / dt_s))


def _stays_pressed(is_pressed: Array, dt_s: float) -> Array:
    """Rows from which a pedal stays pressed until its effect is measured, so that the other pedal does not act."""
    return true_throughout(is_pressed, 0, sum(_effect_rows(dt_s)))


def _judged_rows(drive: Drive, accel: Array, *, by_command: bool) -> Array:
    rows = moving_rows(drive) & ~reversing_rows(drive) & np.isfinite(accel)
    return rows & drive.enabled if by_command else rows


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    squares = float(a @ a) * float(b @ b)
    return float(a @ b) / squares**0.5 if squares > 0.0 else 0.0
