"""Whether something may be learned from these drives: all that would teach nonsense is found before training.

Of which vehicle they are, whether clock and frames are whole, whether they hold enough; what signals say of each other
is in learn/checks/consistency.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from tunefree_hil.learn.checks.consistency import check_motion
from tunefree_hil.learn.checks.problem import Problem
from tunefree_hil.learn.checks.same_vehicle import check_same_vehicle
from tunefree_hil.learn.drives.drive import (
    BRAKES,
    CHASSIS_FIRST_SPEEDS,
    MOVING_MPS,
    THROTTLES,
    TURNS,
    Drive,
    Reading,
    first_of,
    moving,
    name_of,
)

if TYPE_CHECKING:
    from tunefree_hil.config.schema import FieldSpec, VehicleSpec

__all__ = ["Problem", "check_drives"]

Array = np.ndarray

SPEED = CHASSIS_FIRST_SPEEDS[0]  # the field that is named where the speed is at fault
LEAST_MOVING_S, FEW_MOVING_S = 20.0, 300.0
LEAST_SPREAD = 0.15  # of the speeds driven: from the slowest 5 % to the fastest 5 %, by the latter
LEAST_BRAKING_S = 1.0
PRESSED_FRAC, BRAKING_MPS2 = 0.02, -0.2
MOST_MISSING = 0.5  # of the folder's chassis messages
MOST_BAD = 0.2  # of a message's frames: short ones, or with a CRC that does not fit
BACK_S = 0.05  # receivers put frames of a few ms out of order; a clock that goes back further was set
SILENT_S, STOPPED_S = 0.2, 10.0
LEAST_SHARE, LOW_SHARE, HIGH_SHARE = 0.7, 0.5, 1.7  # of the frames that a period makes one expect
FAR = 5.0  # times that: no second vehicle makes it so
FEW_FRAMES = 9  # of a message: so many are too few to tell its rate


def check_drives(drives: Sequence[Drive], vehicle: VehicleSpec) -> list[Problem]:
    """All that is wrong, refusals first, in the order of the drives; empty where nothing is.

    vehicle: the folder that the drives were read with. Drives that were not read from logs (learn/drives/read.py) have no
    Reading; what their frames were like is then not judged.
    """
    if not drives:
        return [Problem("refuse", "no_log", "", "", "no log was given: name at least one")]
    found = [_scrap(drive, drive.reading) for drive in drives if drive.reading is not None and _is_scrap(drive.reading)]
    whole = [drive for drive in drives if drive.reading is None or not _is_scrap(drive.reading)]
    for drive in whole:
        if drive.reading is not None:
            found += _frames(drive, drive.reading, vehicle)
            found += _clock(drive, drive.reading)
        found += _numbers(drive)
        found += check_motion(drive, vehicle)
    found += check_same_vehicle(whole)
    found += _enough(whole, vehicle) if whole else ()
    paths = {drive.name: drive.path for drive in drives}
    found = [one._replace(file=paths.get(one.drive, "")) for one in found]
    return sorted(found, key=lambda one: one.severity != "refuse")


def _is_scrap(reading: Reading) -> bool:
    """So few frames say nothing, not even whose they are; nor do those of an instant, a few of each message."""
    instant = reading.span_s <= 0.0 and max(reading.heard.values(), default=0) <= FEW_FRAMES
    return instant or reading.frames <= FEW_FRAMES


def _scrap(drive: Drive, reading: Reading) -> Problem:
    frames = f"{reading.frames} frame{'s' if reading.frames > 1 else ''}"
    words = f"{drive.path} is too short: it holds {frames} in {reading.span_s:g} s, where at least "
    words += f"{LEAST_MOVING_S:g} s of driving are expected; record more, or leave it out"
    return Problem("refuse", "scrap", drive.name, "", words)


# --- of this vehicle? ------------------------------------------------------------------------------------------------


def _frames(drive: Drive, reading: Reading, vehicle: VehicleSpec) -> Iterator[Problem]:
    """Ids, lengths, CRCs and rates against the folder."""
    chassis, others = _fields_by_message(vehicle.report), _fields_by_message(vehicle.ins)
    silent = [name for name in _due(vehicle, reading.span_s) if not reading.heard.get(name)]
    missing = [name for name in chassis if name in silent]
    if len(missing) > MOST_MISSING * len(chassis):
        ids = ", ".join(f"0x{number & 0x1FFFFFFF:X}" for number in list(reading.foreign)[:6]) or "no foreign ones"
        words = f"{drive.path}: {len(missing)} of the {len(chassis)} chassis messages of {vehicle.name} never come "
        words += f"({', '.join(missing[:4])} ...; ids in their place: {ids}): the log of another vehicle is expected "
        yield Problem("refuse", "other_vehicle", drive.name, "", words + "to be read with that one's folder")
    else:
        for name in [*missing, *(one for one in others if one in silent)]:
            fields = (chassis | others)[name]
            words = f"{drive.path}: {name} never comes, so {', '.join(fields)} cannot be used; record with that device"
            yield Problem("warn", "missing", drive.name, fields[0], words)
    for counts, what, why in (
        (reading.short, "are shorter than the DBC says", "is it the DBC of this vehicle?"),
        (reading.broken, "have a CRC or data id that does not fit", "are the data ids those of this vehicle?"),
    ):
        for name, count in counts.items():
            bad = count > MOST_BAD * reading.heard[name]
            words = f"{drive.path}: {count} of {reading.heard[name]} frames of {name} {what} and are left out"
            code = "other_vehicle" if bad else "bad_frames"
            field = (chassis | others | _fields_by_message(vehicle.command)).get(name, [""])[0]
            yield Problem("refuse" if bad else "warn", code, drive.name, field, f"{words}; {why}")
    yield from _rates(drive, reading, vehicle)


def _due(vehicle: VehicleSpec, span_s: float) -> set[str]:
    """Messages of which a frame is expected in so long: a log of an instant is no other vehicle's."""
    fields = (*vehicle.report.values(), *vehicle.ins.values())
    return {one.message for one in fields if one.period_ms * 1e-3 <= span_s}


def _fields_by_message(fields: dict[str, FieldSpec]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name, spec in fields.items():
        found.setdefault(spec.message, []).append(name)
    return found


def _rates(drive: Drive, reading: Reading, vehicle: VehicleSpec) -> Iterator[Problem]:
    """How many frames came of those that the periods make one expect."""
    if reading.span_s <= 0.0:
        return
    periods_s = {one.message: one.period_ms * 1e-3 for one in (*vehicle.report.values(), *vehicle.ins.values())}
    heard = {name: reading.heard[name] for name in periods_s if reading.heard.get(name) and periods_s[name] > 0.0}
    expected = {name: reading.span_s / periods_s[name] for name in heard}
    # few frames tell a rate where many are expected, or where many came though few are
    judged = [name for name in heard if max(heard[name], expected[name]) > FEW_FRAMES]
    shares = {name: heard[name] / expected[name] for name in judged}
    many = [share for name, share in shares.items() if heard[name] > FEW_FRAMES]
    if not shares:
        return
    usual = float(np.median(many or list(shares.values())))
    if not LOW_SHARE <= usual <= HIGH_SHARE:
        words = f"{drive.path}: messages come at {usual:.4g} times the rate that the periods of vehicle.toml make one "
        far = not 1.0 / FAR <= usual <= FAR
        why = "two vehicles in it (keep one channel), a clock in other units, or another vehicle?"
        words += (
            f"expect: {'a clock in other units (stamps are expected in seconds), or another vehicle?' if far else why}"
        )
        yield Problem("refuse", "wrong_rate", drive.name, "", words)
        return
    for name, share in shares.items():
        if share < LEAST_SHARE:
            some = f"{heard[name]} frame{'s' if heard[name] > 1 else ''}" if heard[name] <= FEW_FRAMES else ""
            words = f"{drive.path}: only {some or f'{100.0 * share:.0f} % of the frames'} of {name} came "
            words += f"where its period of {1000.0 * periods_s[name]:g} ms makes one expect {expected[name]:.0f}; "
            yield Problem("warn", "missing_frames", drive.name, "", words + "see `tunefree-hil log check`")


# --- is the clock one clock? -----------------------------------------------------------------------------------------


def _clock(drive: Drive, reading: Reading) -> Iterator[Problem]:
    name, path, cut = drive.name, drive.path, "cut the log in two there"
    if reading.cut:
        yield Problem("warn", "cut", name, "", f"{path}: the last line of the log is cut off and was left out")
    if reading.span_s <= 0.0 and max(reading.heard.values(), default=0) > FEW_FRAMES:
        words = (
            f"{path}: the clock stands still: all {reading.frames} frames have one stamp, where each is expected to "
        )
        yield Problem("refuse", "clock_stands", name, "", words + "have the time it was heard; record with time stamps")
    if reading.back_s > BACK_S:
        words = f"{path}: the clock goes back by {reading.back_s:.3f} s at stamp {reading.back_at_s:.6f}, where it is "
        yield Problem("refuse", "clock_jump", name, "", f"{words}expected to run on; {cut}")
    if reading.ahead_s < SILENT_S:
        return
    there = f"{reading.ahead_s:.2f} s before stamp {reading.ahead_at_s:.6f}"
    if reading.ahead_s > STOPPED_S:
        words = f"{path}: no frame comes for {there}: the clock jumped ahead, or the recording was stopped; {cut}"
        yield Problem("refuse", "clock_jump", name, "", words)
    elif (apart := _way_does_not_fit(drive)) is not None:
        words = f"{path}: no frame comes for {there}, in which {apart[0]:.1f} m were driven where {apart[1]:.1f} m are "
        yield Problem("refuse", "clock_jump", name, "ins.x_m", f"{words}expected by the speed: a clock jump; {cut}")
    else:
        yield Problem("warn", "gap", name, "", f"{path}: no frame comes for {there}: a gap, which is not learned from")


def _way_does_not_fit(drive: Drive) -> tuple[float, float] | None:
    """(way between the positions at the ends of the longest silence, way by speed), where they are not the same."""
    x, y, speed = drive.get("ins.x_m"), drive.get("ins.y_m"), first_of(drive, CHASSIS_FIRST_SPEEDS)
    if x is None or y is None or speed is None:
        return None
    rows = np.flatnonzero(np.logical_or.reduce([drive.fresh["ins.x_m"], drive.fresh["ins.y_m"]]))
    if len(rows) < 2:
        return None
    longest = int(np.diff(rows).argmax())
    begin, end = int(rows[longest]), int(rows[longest + 1])
    way = float(np.hypot(x[end] - x[begin], y[end] - y[begin]))
    by_speed = float(abs(speed[begin] + speed[end]) / 2.0 * (end - begin) * drive.dt_s)
    return (way, by_speed) if abs(way - by_speed) > 0.5 * by_speed + 1.0 else None


def _numbers(drive: Drive) -> Iterator[Problem]:
    """Values that are no finite number, where a frame brought them."""
    for name, values in drive.fields.items():
        bad = drive.fresh[name] & ~np.isfinite(values)
        if bad.any():
            first_s = float(np.flatnonzero(bad)[0]) * drive.dt_s
            words = f"{drive.path}: {name} is no finite number in {int(bad.sum())} frames, the first {first_s:.2f} s "
            words += "after the log's beginning, where measured values are expected; mend the sensor, or cut that out"
            yield Problem("refuse", "not_a_number", drive.name, name, words)


# --- is there enough in them? ----------------------------------------------------------------------------------------


def _enough(drives: Sequence[Drive], vehicle: VehicleSpec) -> Iterator[Problem]:
    """Time, speeds, braking and inputs of all drives together."""
    told = [drive for drive in drives if name_of(drive, CHASSIS_FIRST_SPEEDS) is not None]
    speeds = [drive.fields[name_of(drive, CHASSIS_FIRST_SPEEDS) or ""][moving(drive)] for drive in told]
    if not speeds:
        words = f"none of {_all(drives)} holds a speed ({' or '.join(CHASSIS_FIRST_SPEEDS)}), without which nothing "
        yield Problem("refuse", "no_speed", "", SPEED, words + "can be learned; record the message that carries it")
        return
    speed = np.abs(np.concatenate(speeds))
    driven_s = sum(len(some) * drive.dt_s for some, drive in zip(speeds, told, strict=True))
    if driven_s < LEAST_MOVING_S:
        words = f"{_all(drives)} hold {driven_s:.1f} s of driving above {MOVING_MPS:g} m/s: too short, at least "
        yield Problem("refuse", "too_short", "", SPEED, f"{words}{LEAST_MOVING_S:g} s are expected; record more")
        return
    if driven_s < FEW_MOVING_S:
        verb = "holds" if len(drives) == 1 else "hold"
        words = f"{_all(drives)} {verb} only {driven_s:.0f} s of driving; what is learned will be rough"
        yield Problem("warn", "short", "", SPEED, words)
    yield from _speeds(drives, speed)
    yield from _braking(drives, vehicle)
    yield from _inputs(drives)


def _speeds(drives: Sequence[Drive], speed: Array) -> Iterator[Problem]:
    low, high = (float(one) for one in np.quantile(speed, (0.05, 0.95)))
    if high - low < LEAST_SPREAD * high:
        words = f"{_all(drives)} are driven at one speed only (90 % of the time {low:.2f} to {high:.2f} m/s), where "
        words += "several are expected; drive slower and faster too"
        yield Problem("refuse", "one_speed", "", SPEED, words)


def _braking(drives: Sequence[Drive], vehicle: VehicleSpec) -> Iterator[Problem]:
    """Whether the brake, where the vehicle has one, was used while it moved."""
    by_accel = "accel_mps2" in vehicle.command
    has_brake = "brake_frac" in vehicle.command or "brake_frac" in vehicle.report
    if not (by_accel or has_brake):
        return
    rest, braked_s, field = vehicle.nominal.rest_pedal_frac, 0.0, "command.accel_mps2" if by_accel else BRAKES[0]
    for drive in drives:
        brake, accel = first_of(drive, BRAKES), drive.get("command.accel_mps2")
        used = np.zeros(drive.ticks, dtype=bool)
        if brake is not None:
            used |= brake > rest + PRESSED_FRAC
        if accel is not None:
            used |= accel < BRAKING_MPS2
        braked_s += float((used & moving(drive)).sum()) * drive.dt_s
    if braked_s < LEAST_BRAKING_S:
        words = f"{_all(drives)} hold {braked_s:.1f} s of braking while driving ({field}), where at least "
        words += f"{LEAST_BRAKING_S:g} s are expected; brake, gently and hard, from several speeds"
        yield Problem("refuse", "no_braking", "", field, words)


def _inputs(drives: Sequence[Drive]) -> Iterator[Problem]:
    """Whether anything says how it was driven and steered; and whether by-wire ever obeyed."""
    drive_inputs = (*THROTTLES, "command.accel_mps2", "report.accel_command_mps2")
    for fields, what in ((drive_inputs, "driven"), (TURNS, "steered")):
        if all(first_of(drive, fields) is None for drive in drives):
            words = f"{_all(drives)} do not say how the vehicle was {what} (none of {', '.join(fields)}); "
            yield Problem("warn", "no_input", "", fields[0], words + "that part of it cannot be learned")
    for drive in drives:
        if not drive.enabled.any():
            words = f"{drive.path}: by-wire control is never enabled, so commands say nothing of what followed; enable "
            yield Problem("warn", "never_enabled", drive.name, "", words + "it, or let the reports alone be used")


def _all(drives: Sequence[Drive]) -> str:
    return drives[0].path if len(drives) == 1 else f"the {len(drives)} logs together"
