"""Checks before anything is learned from drives: vehicle, frames, clock, and whether there is enough data.

Whether the signals agree with each other is checked in learn/checks/consistency.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tunefree_hil.learn.checks.consistency import check_consistency
from tunefree_hil.learn.checks.problem import LogProblem
from tunefree_hil.learn.checks.same_vehicle import check_same_vehicle
from tunefree_hil.learn.data_sheet import has_brake
from tunefree_hil.learn.drives.drive import (
    BRAKE_FIELDS,
    CHASSIS_FIRST_SPEEDS,
    MOVING_MPS,
    STEER_FIELDS,
    THROTTLE_FIELDS,
    Array,
    Drive,
    LogSummary,
    first_field_values,
    moving_rows,
)

if TYPE_CHECKING:
    from tunefree_hil.config.schema import FieldSpec, VehicleSpec


SPEED = CHASSIS_FIRST_SPEEDS[0]  # the field in problems of the speed
CUT_LOG = "cut the log in two there"


class FrameCriteria(NamedTuple):
    """Frames of a log against the vehicle folder; every value is an engineering choice."""

    max_missing_share: float = 0.5  # of the folder's chassis messages
    max_bad_share: float = 0.2  # of a message's frames: too short, or with a wrong CRC or data id
    min_rate_frames: int = 10  # of a message, to judge its rate; a log with fewer in total is too short
    min_rate_share: float = 0.7  # of the frames expected by a message's period
    rate_range: tuple[float, float] = (0.5, 1.7)  # median of these shares over all messages
    max_rate_ratio: float = 5.0  # above it, or below its inverse, the clock has other units


class ClockCriteria(NamedTuple):
    """Steps of the clock; every value is an engineering choice."""

    max_backward_s: float = 0.05  # step back that is allowed: receivers reorder frames by some ms
    min_gap_s: float = 0.2  # time without a frame that is examined
    max_gap_s: float = 10.0  # time without a frame, from which on the clock jumped or the recording was stopped
    max_distance_error_share: float = 0.5  # of the distance by the speed, in a gap ...
    max_distance_error_m: float = 1.0  # ... plus this


class AmountCriteria(NamedTuple):
    """How much data learning needs; every value is an engineering choice."""

    min_moving_s: float = 20.0  # driving time of all logs; less is refused
    few_moving_s: float = 300.0  # driving time of all logs; less is a warning
    min_speed_range_share: float = 0.15  # of the 95 % quantile of the speed, from the 5 % quantile up to it
    min_braking_s: float = 1.0  # time of braking while driving, of all logs; less is refused
    min_pressed_frac: float = 0.02  # of the brake, above rest, from which on it is pressed
    max_braking_mps2: float = -0.2  # of a commanded acceleration, below which it brakes


FRAMES = FrameCriteria()
CLOCK = ClockCriteria()
AMOUNT = AmountCriteria()


def check_drives(drives: Sequence[Drive], vehicle: VehicleSpec) -> list[LogProblem]:
    """All problems, refusals first, in the order of the drives.

    Args:
        drives: those that were not read from a log are not checked for frames and clock.
        vehicle: the folder that the drives were read with.
    """
    if not drives:
        return [LogProblem("refuse", "no_log", "", "", "no log was given: name at least one")]
    problems, long_enough = [], []
    for drive in drives:
        if drive.log_summary is not None and _is_too_small(drive.log_summary):
            problems.append(_too_small(drive, drive.log_summary))
        else:
            long_enough.append(drive)
    for drive in long_enough:
        if drive.log_summary is not None:
            problems += _check_missing_messages(drive, drive.log_summary, vehicle)
            problems += _check_bad_frames(drive, drive.log_summary, vehicle)
            problems += _check_rates(drive, drive.log_summary, vehicle)
            problems += _check_clock(drive, drive.log_summary)
        problems += _check_numbers(drive)
        problems += check_consistency(drive, vehicle)
    problems += check_same_vehicle(long_enough)
    problems += _check_amount(long_enough, vehicle) if long_enough else ()
    paths = {drive.name: drive.path for drive in drives}
    problems = [problem._replace(file=paths.get(problem.drive, "")) for problem in problems]
    return sorted(problems, key=lambda problem: problem.severity != "refuse")


def _is_too_small(summary: LogSummary) -> bool:
    """Whether a log has too few frames, or is a single instant with a few frames of each message."""
    most_frames = max(summary.frames_by_message.values(), default=0)
    is_instant = summary.span_s <= 0.0 and most_frames < FRAMES.min_rate_frames
    return is_instant or summary.frames < FRAMES.min_rate_frames


def _too_small(drive: Drive, summary: LogSummary) -> LogProblem:
    frames = f"{summary.frames} frame{'s' if summary.frames > 1 else ''}"
    message = (
        f"{drive.path} is too short: it has {frames} in {summary.span_s:g} s, but at least {AMOUNT.min_moving_s:g} s "
        "of driving are expected; record more, or leave it out"
    )
    return LogProblem("refuse", "scrap", drive.name, "", message)


# --- frames ----------------------------------------------------------------------------------------------------------


def _check_missing_messages(drive: Drive, summary: LogSummary, vehicle: VehicleSpec) -> Iterator[LogProblem]:
    chassis, ins = _fields_by_message(vehicle.report), _fields_by_message(vehicle.ins)
    absent = [name for name in _due_messages(vehicle, summary.span_s) if not summary.frames_by_message.get(name)]
    missing = [name for name in chassis if name in absent]
    if len(missing) > FRAMES.max_missing_share * len(chassis):
        ids = ", ".join(f"0x{can_id & 0x1FFFFFFF:X}" for can_id in list(summary.unknown_ids)[:6]) or "none"
        message = (
            f"{drive.path}: {len(missing)} of the {len(chassis)} expected chassis messages of {vehicle.name} are "
            f"missing ({', '.join(missing[:4])} ...; unknown ids in the log: {ids}); if the log is of another vehicle, "
            "use its folder"
        )
        yield LogProblem("refuse", "other_vehicle", drive.name, "", message)
        return
    for name in [*missing, *(name for name in ins if name in absent)]:
        fields = (chassis | ins)[name]
        message = f"{drive.path}: {name} is missing, so {', '.join(fields)} cannot be used; record with that device"
        yield LogProblem("warn", "missing", drive.name, fields[0], message)


def _check_bad_frames(drive: Drive, summary: LogSummary, vehicle: VehicleSpec) -> Iterator[LogProblem]:
    fields = _fields_by_message(vehicle.report) | _fields_by_message(vehicle.ins) | _fields_by_message(vehicle.command)
    for counts, defect, remedy in (
        (summary.short_frames, "are shorter than in the DBC", "check that it is the DBC of this vehicle"),
        (summary.corrupt_frames, "have a wrong CRC or data id", "check the data ids of this vehicle"),
    ):
        for name, count in counts.items():
            total = summary.frames_by_message[name]
            is_refused = count > FRAMES.max_bad_share * total
            severity, code = ("refuse", "other_vehicle") if is_refused else ("warn", "bad_frames")
            message = f"{drive.path}: {count} of {total} frames of {name} {defect} and are left out; {remedy}"
            yield LogProblem(severity, code, drive.name, fields.get(name, [""])[0], message)


def _due_messages(vehicle: VehicleSpec, span_s: float) -> set[str]:
    """Messages of which at least one frame is expected in this time."""
    specs = (*vehicle.report.values(), *vehicle.ins.values())
    return {spec.message for spec in specs if spec.period_ms * 1e-3 <= span_s}


def _fields_by_message(fields: dict[str, FieldSpec]) -> dict[str, list[str]]:
    by_message: dict[str, list[str]] = {}
    for name, spec in fields.items():
        by_message.setdefault(spec.message, []).append(name)
    return by_message


def _check_rates(drive: Drive, summary: LogSummary, vehicle: VehicleSpec) -> Iterator[LogProblem]:
    """The number of frames of each message against its period."""
    if summary.span_s <= 0.0:
        return
    frames, min_frames = summary.frames_by_message, FRAMES.min_rate_frames
    specs = (*vehicle.report.values(), *vehicle.ins.values())
    periods_s = {spec.message: spec.period_ms * 1e-3 for spec in specs}
    received = [name for name in periods_s if frames.get(name) and periods_s[name] > 0.0]
    expected = {name: summary.span_s / periods_s[name] for name in received}
    # a few frames show a rate only where many are expected
    shares = {
        name: frames[name] / expected[name] for name in received if max(frames[name], expected[name]) > min_frames - 1
    }
    if not shares:
        return
    reliable = [share for name, share in shares.items() if frames[name] >= min_frames]
    median = float(np.median(reliable or list(shares.values())))
    if not FRAMES.rate_range[0] <= median <= FRAMES.rate_range[1]:
        yield _wrong_rate(drive, median)
        return
    for name, share in shares.items():
        if share < FRAMES.min_rate_share:
            count = f"{frames[name]} frame{'s' if frames[name] > 1 else ''}"
            amount = count if frames[name] < min_frames else f"{100.0 * share:.0f} % of the frames"
            message = (
                f"{drive.path}: only {amount} of {name} came, but {expected[name]:.0f} are expected by its period of "
                f"{1000.0 * periods_s[name]:g} ms; see `tunefree-hil log check`"
            )
            yield LogProblem("warn", "missing_frames", drive.name, "", message)


def _wrong_rate(drive: Drive, ratio: float) -> LogProblem:
    if 1.0 / FRAMES.max_rate_ratio <= ratio <= FRAMES.max_rate_ratio:
        causes = "the log holds two vehicles (keep one channel), has a clock in other units, or is of another vehicle"
    else:
        causes = "its clock has other units (stamps are expected in seconds), or it is of another vehicle"
    message = (
        f"{drive.path}: messages come at {ratio:.4g} times the rate that is expected by the periods in vehicle.toml; "
        f"probably {causes}"
    )
    return LogProblem("refuse", "wrong_rate", drive.name, "", message)


# --- clock -----------------------------------------------------------------------------------------------------------


def _check_clock(drive: Drive, summary: LogSummary) -> Iterator[LogProblem]:
    name, path = drive.name, drive.path
    if summary.is_truncated:
        yield LogProblem("warn", "cut", name, "", f"{path}: the last line of the log is incomplete and was left out")
    if summary.span_s <= 0.0 and max(summary.frames_by_message.values(), default=0) >= FRAMES.min_rate_frames:
        message = (
            f"{path}: the clock stands still: all {summary.frames} frames have one stamp, but each is expected to have "
            "the time of its reception; record with time stamps"
        )
        yield LogProblem("refuse", "clock_stands", name, "", message)
    if summary.max_backward_step_s > CLOCK.max_backward_s:
        message = (
            f"{path}: the clock goes back by {summary.max_backward_step_s:.3f} s at stamp "
            f"{summary.backward_step_at_s:.6f}, but it is expected to go forward; {CUT_LOG}"
        )
        yield LogProblem("refuse", "clock_jump", name, "", message)
    if summary.max_forward_step_s >= CLOCK.min_gap_s:
        yield _check_gap(drive, summary)


def _check_gap(drive: Drive, summary: LogSummary) -> LogProblem:
    gap = f"there is no frame for {summary.max_forward_step_s:.2f} s before stamp {summary.forward_step_at_s:.6f}"
    if summary.max_forward_step_s > CLOCK.max_gap_s:
        message = f"{drive.path}: {gap}: the clock jumped ahead, or the recording was stopped; {CUT_LOG}"
        return LogProblem("refuse", "clock_jump", drive.name, "", message)
    distances = _gap_distances(drive)
    if distances is None or not distances.disagree():
        message = f"{drive.path}: {gap}; this gap is not used for learning"
        return LogProblem("warn", "gap", drive.name, "", message)
    message = (
        f"{drive.path}: {gap}, and the position moves by {distances.by_position_m:.1f} m where "
        f"{distances.by_speed_m:.1f} m are expected by the speed: the clock jumped; {CUT_LOG}"
    )
    return LogProblem("refuse", "clock_jump", drive.name, "ins.x_m", message)


class _GapDistances(NamedTuple):
    """The distance driven in a gap, by the positions at its ends and by the speed."""

    by_position_m: float
    by_speed_m: float

    def disagree(self) -> bool:
        """Whether the two differ by too much."""
        max_error_m = CLOCK.max_distance_error_share * self.by_speed_m + CLOCK.max_distance_error_m
        return abs(self.by_position_m - self.by_speed_m) > max_error_m


def _gap_distances(drive: Drive) -> _GapDistances | None:
    """Distances in the longest gap between two positions; None where position or speed is not recorded."""
    x, y, speed = drive.get("ins.x_m"), drive.get("ins.y_m"), first_field_values(drive, CHASSIS_FIRST_SPEEDS)
    if x is None or y is None or speed is None:
        return None
    rows = np.flatnonzero(np.logical_or.reduce([drive.fresh["ins.x_m"], drive.fresh["ins.y_m"]]))
    if len(rows) < 2:
        return None
    longest = int(np.diff(rows).argmax())
    begin, end = int(rows[longest]), int(rows[longest + 1])
    by_position_m = float(np.hypot(x[end] - x[begin], y[end] - y[begin]))
    by_speed_m = float(abs(speed[begin] + speed[end]) / 2.0 * (end - begin) * drive.dt_s)
    return _GapDistances(by_position_m, by_speed_m)


def _check_numbers(drive: Drive) -> Iterator[LogProblem]:
    """Fresh values that are not finite."""
    for name, values in drive.fields.items():
        is_bad = drive.fresh[name] & ~np.isfinite(values)
        if is_bad.any():
            first_s = float(np.flatnonzero(is_bad)[0]) * drive.dt_s
            message = (
                f"{drive.path}: {name} is not a finite number in {int(is_bad.sum())} frames, first {first_s:.2f} s "
                "after the start of the log, but measured values are expected; repair the sensor, or cut this "
                "stretch out"
            )
            yield LogProblem("refuse", "not_a_number", drive.name, name, message)


# --- amount of data --------------------------------------------------------------------------------------------------


def _check_amount(drives: Sequence[Drive], vehicle: VehicleSpec) -> Iterator[LogProblem]:
    """Duration, speeds, braking and inputs of all drives together."""
    known = [(drive, first_field_values(drive, CHASSIS_FIRST_SPEEDS)) for drive in drives]
    moving = [(drive.dt_s, speed[moving_rows(drive)]) for drive, speed in known if speed is not None]
    logs = _name_logs(drives)
    if not moving:
        message = (
            f"{logs}: there is no speed ({' or '.join(CHASSIS_FIRST_SPEEDS)}), which all learning needs; record the "
            "message that carries it"
        )
        yield LogProblem("refuse", "no_speed", "", SPEED, message)
        return
    speed = np.abs(np.concatenate([values for _, values in moving]))
    moving_s = sum(len(values) * dt_s for dt_s, values in moving)
    if moving_s < AMOUNT.min_moving_s:
        message = (
            f"{logs} hold {moving_s:.1f} s of driving above {MOVING_MPS:g} m/s: too short, at least "
            f"{AMOUNT.min_moving_s:g} s are expected; record more"
        )
        yield LogProblem("refuse", "too_short", "", SPEED, message)
        return
    if moving_s < AMOUNT.few_moving_s:
        verb = "holds" if len(drives) == 1 else "hold"
        message = f"{logs} {verb} only {moving_s:.0f} s of driving; the model will be rough"
        yield LogProblem("warn", "short", "", SPEED, message)
    yield from _check_speed_range(drives, speed)
    yield from _check_braking(drives, vehicle)
    yield from _check_inputs(drives)


def _check_speed_range(drives: Sequence[Drive], speed: Array) -> Iterator[LogProblem]:
    low, high = (float(quantile) for quantile in np.quantile(speed, (0.05, 0.95)))
    if high - low < AMOUNT.min_speed_range_share * high:
        message = (
            f"{_name_logs(drives)}: the vehicle drives at one speed only (90 % of the time {low:.2f} to {high:.2f} "
            "m/s), but several speeds are expected; drive slower and faster too"
        )
        yield LogProblem("refuse", "one_speed", "", SPEED, message)


def _check_braking(drives: Sequence[Drive], vehicle: VehicleSpec) -> Iterator[LogProblem]:
    """Whether the brake of a vehicle that has one was used while it moved."""
    is_accel_commanded = "accel_mps2" in vehicle.command
    if not (is_accel_commanded or has_brake(vehicle)):
        return
    field = "command.accel_mps2" if is_accel_commanded else BRAKE_FIELDS[0]
    pressed_frac, braking_s = vehicle.nominal.rest_pedal_frac + AMOUNT.min_pressed_frac, 0.0
    for drive in drives:
        brake, accel = first_field_values(drive, BRAKE_FIELDS), drive.get("command.accel_mps2")
        is_braking = np.zeros(drive.n_rows, dtype=bool)
        if brake is not None:
            is_braking |= brake > pressed_frac
        if accel is not None:
            is_braking |= accel < AMOUNT.max_braking_mps2
        braking_s += float((is_braking & moving_rows(drive)).sum()) * drive.dt_s
    if braking_s < AMOUNT.min_braking_s:
        message = (
            f"{_name_logs(drives)} hold {braking_s:.1f} s of braking while driving ({field}), but at least "
            f"{AMOUNT.min_braking_s:g} s are expected; brake gently and hard, from several speeds"
        )
        yield LogProblem("refuse", "no_braking", "", field, message)


def _check_inputs(drives: Sequence[Drive]) -> Iterator[LogProblem]:
    """Whether pedals and steering are recorded, and whether by-wire control was ever enabled."""
    drive_fields = (*THROTTLE_FIELDS, "command.accel_mps2", "report.accel_command_mps2")
    for fields, action in ((drive_fields, "driven"), (STEER_FIELDS, "steered")):
        if all(first_field_values(drive, fields) is None for drive in drives):
            message = (
                f"{_name_logs(drives)}: it is not recorded how the vehicle was {action} (none of {', '.join(fields)}); "
                "that part of the model cannot be learned"
            )
            yield LogProblem("warn", "no_input", "", fields[0], message)
    for drive in drives:
        if not drive.enabled.any():
            message = (
                f"{drive.path}: by-wire control is never enabled, so the commands had no effect; enable it, or use "
                "the reports alone"
            )
            yield LogProblem("warn", "never_enabled", drive.name, "", message)


def _name_logs(drives: Sequence[Drive]) -> str:
    return drives[0].path if len(drives) == 1 else f"the {len(drives)} logs together"
