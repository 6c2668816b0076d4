"""Rows in which a drive's fields are valid, and the removal of spikes and of a frozen position.

A field keeps the value of its last frame on every tick (drives/drive.py). In a gap of the recording, and after a
message has stopped, that value is no measurement.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from tunefree_hil.learn.actuators.samples import CHANNELS, ECHOES
from tunefree_hil.learn.drives.drive import (
    CHASSIS_FIRST_SPEEDS,
    INS_FIRST_SPEEDS,
    INS_FIRST_YAW_RATES,
    Array,
    Drive,
    first_field_name,
    first_field_values,
    first_valid_field,
)
from tunefree_hil.learn.drives.runs import covered_rows, find_runs, sample_interval_ticks
from tunefree_hil.learn.drives.smoothing import estimate_quantum, interpolate_from_first, shift_earlier

DRIVING_CHANNELS = ("throttle", "brake", "steer")
POSITION_FIELDS = ("ins.x_m", "ins.y_m")
POSE_FIELDS = ("ins.heading_rad", *POSITION_FIELDS)
OUTPUT_FIELDS = ("report.throttle_frac", "report.brake_frac", "report.steer_rad")
DISCRETE_FIELDS = ("report.gear",)  # no quantity that moves from value to value


class OnDemandCriteria(NamedTuple):
    """A message that is sent only on demand keeps its last value through its pauses."""

    min_pauses: int = 3  # pauses in a drive; a message that stops only once has failed
    max_covered_share: float = 0.5  # of the drive's rows


class SpikeCriteria(NamedTuple):
    """A spike is a single value far from both of its neighbours."""

    min_height_steps: float = 25.0  # multiple of the usual step between values; white noise reaches 6 in 1e6 values
    max_neighbour_share: float = 0.2  # of the height, by which the values around it may differ
    step_window_values: int = 21  # window of the usual step
    max_share: float = 0.01  # of a signal's values; a sensor with more spikes keeps them
    min_values: int = 50  # shorter signals are not searched
    max_output_interval_s: float = 0.03  # with slower reports one value may be a short real move of the actuator


class FrozenPositionCriteria(NamedTuple):
    """An INS without satellites repeats its position while the car drives on."""

    min_duration_s: float = 1.0  # of an unchanged position
    min_distance_m: float = 1.0  # driven meanwhile, by the speed
    min_frames: int = 4  # that repeat the position; for a slow INS


ON_DEMAND = OnDemandCriteria()
SPIKE = SpikeCriteria()
FROZEN_POSITION = FrozenPositionCriteria()


def is_on_demand(is_covered: Array) -> bool:
    """Whether a message pauses often and for most of a drive. is_covered: shape (n_rows,), from covered_rows."""
    pauses = int((np.diff(is_covered.astype(int)) < 0).sum())
    return pauses >= ON_DEMAND.min_pauses and bool(is_covered.mean() < ON_DEMAND.max_covered_share)


def valid_rows(drive: Drive, *fields: str, ins_delay_rows: int = 0) -> Array:
    """Rows in which each of these fields was received recently.

    Args:
        ins_delay_rows: by how many rows the INS reports late; its validity moves back by as many.

    Returns:
        Shape (n_rows,).
    """
    is_valid = np.ones(drive.n_rows, dtype=bool)
    for name in fields:
        if name not in drive.fresh:
            continue  # without `fresh` a drive has every field in each row
        is_covered = covered_rows(drive.fresh[name] & np.isfinite(drive.fields[name]), drive.dt_s)
        is_ins = name.startswith("ins.")
        if is_on_demand(is_covered) and not is_ins:
            continue
        is_valid &= (shift_earlier(is_covered.astype(float), ins_delay_rows) > 0.5) if is_ins else is_covered
    return is_valid


def motion_valid_rows(drive: Drive, ins_delay_rows: int, has_pose: bool) -> Array:
    """Rows with a valid speed and yaw rate, and with a valid pose where `has_pose`; shape (n_rows,)."""
    sources = (first_valid_field(drive, names) for names in (INS_FIRST_SPEEDS, INS_FIRST_YAW_RATES))
    fields = (*(name for name in sources if name is not None), *(POSE_FIELDS if has_pose else ()))
    return valid_rows(drive, *fields, ins_delay_rows=ins_delay_rows)


def interpolate_pose(drive: Drive) -> list[Array]:
    """Unwrapped heading, x and y on every tick, each of shape (n_rows,); NaN before their first frame.

    A held value would be late by up to the interval of the frames.
    """
    return [interpolate_from_first(drive, name) for name in POSE_FIELDS]


def actuation_valid_rows(drive: Drive, is_by_command: Sequence[Array]) -> Array:
    """Rows in which the inputs of the vehicle are known.

    Args:
        is_by_command: for throttle, brake and steering, rows in which the command acts and not the recorded output;
            each of shape (n_rows,).
    """
    rows = np.ones(drive.n_rows, dtype=bool)
    for channel, follows_command in zip(DRIVING_CHANNELS, is_by_command, strict=True):
        output = f"report.{CHANNELS[channel]}"
        has_output = valid_rows(drive, output) if output in drive.fields else np.ones(drive.n_rows, dtype=bool)
        rows &= np.where(follows_command, _command_valid_rows(drive, channel), has_output)
    return rows


def _command_valid_rows(drive: Drive, channel: str) -> Array:
    """Rows with a valid echo of the command, or else a valid command; for pedals also a commanded acceleration."""
    names = [f"report.{ECHOES[channel]}", f"command.{CHANNELS[channel]}"]
    if channel != "steer":
        names += [f"report.{ECHOES['accel']}", f"command.{CHANNELS['accel']}"]
    name = first_field_name(drive, names)
    return np.ones(drive.n_rows, dtype=bool) if name is None else valid_rows(drive, name)


def drop_incomplete_drives(drives: Sequence[Drive]) -> tuple[list[Drive], list[str]]:
    """(the drives with every channel that any drive has, a message for each other drive); all, if none has them all."""
    channels = [{channel for channel in DRIVING_CHANNELS if _has_channel_values(drive, channel)} for drive in drives]
    all_channels = set[str]().union(*channels)
    if all_channels not in channels:
        return list(drives), []
    messages = [
        f"{drive.path} is left out: it has no {' and '.join(sorted(all_channels - present))} data, the other logs do"
        for drive, present in zip(drives, channels, strict=True)
        if present != all_channels
    ]
    return [drive for drive, present in zip(drives, channels, strict=True) if present == all_channels], messages


def _has_channel_values(drive: Drive, channel: str) -> bool:
    names = (f"command.{CHANNELS[channel]}", f"report.{CHANNELS[channel]}", f"report.{ECHOES[channel]}")
    return any(name in drive.fields and np.isfinite(drive.fields[name]).any() for name in names)


def remove_spikes(drive: Drive) -> tuple[Drive, dict[str, int]]:
    """(the drive without spikes, their number by field). A removed value is not fresh and repeats the one before it.

    A spike hardly changes a mean but distorts a rate: one speed of 0 looks like an emergency stop. Commands and their
    echoes are left alone, because a controller may command anything.
    """
    fields, fresh, counts = dict(drive.fields), dict(drive.fresh), {}
    for name in _measured_fields(drive):
        rows = np.flatnonzero(drive.fresh[name] & np.isfinite(drive.fields[name]))
        interval_s = drive.dt_s * float(np.median(np.diff(rows))) if len(rows) > 1 else 0.0
        if name in OUTPUT_FIELDS and interval_s > SPIKE.max_output_interval_s:
            continue
        values = drive.fields[name][rows]
        spike_rows = rows[find_spikes(np.unwrap(values) if name.endswith("heading_rad") else values)]
        if 0 < len(spike_rows) <= max(1.0, SPIKE.max_share * len(rows)):
            fresh[name] = drive.fresh[name].copy()
            fresh[name][spike_rows] = False
            fields[name] = _repeat_previous(drive.fields[name], drive.fresh[name], spike_rows)
            counts[name] = len(spike_rows)
    return (drive._replace(fields=fields, fresh=fresh), counts) if counts else (drive, counts)


def find_spikes(values: Array) -> Array:
    """Which of some successive values are spikes, shape (n_values,). The first and the last value never are.

    A spike lies far beyond both neighbours, while the two values before it and the two after it hardly move.
    """
    is_spike = np.zeros(len(values), dtype=bool)
    if len(values) < SPIKE.min_values:
        return is_spike
    steps = np.abs(np.diff(values))
    local_step = median_filter(steps, SPIKE.step_window_values, mode="nearest")
    usual_step = np.maximum(local_step, float(np.median(steps))) + estimate_quantum(values)
    previous, centre, following = values[:-2], values[1:-1], values[2:]
    height = np.maximum(centre - np.maximum(previous, following), np.minimum(previous, following) - centre)
    outer_step = np.maximum(np.concatenate([[0.0], steps[:-2]]), np.concatenate([steps[2:], [0.0]]))
    is_calm = np.maximum(np.abs(following - previous), outer_step) < SPIKE.max_neighbour_share * height
    is_spike[1:-1] = is_calm & (height > SPIKE.min_height_steps * np.maximum(usual_step[:-1], usual_step[1:]))
    return is_spike


def _measured_fields(drive: Drive) -> Iterator[str]:
    echoes = {f"report.{name}" for name in ECHOES.values()}
    for name in drive.fields:
        if name.startswith(("report.", "ins.")) and name not in echoes and name not in DISCRETE_FIELDS:
            yield name


def _repeat_previous(values: Array, fresh: Array, spike_rows: Array) -> Array:
    """A field in which the value before each spike lasts until the next frame."""
    repaired, frame_rows = values.copy(), np.flatnonzero(fresh)
    for row in spike_rows:
        i = int(np.searchsorted(frame_rows, row))
        end = frame_rows[i + 1] if i + 1 < len(frame_rows) else len(values)
        repaired[row:end] = repaired[row - 1]
    return repaired


def drop_position(drive: Drive) -> Drive:
    """The drive without its position."""
    fields = {name: values for name, values in drive.fields.items() if name not in POSITION_FIELDS}
    return drive._replace(fields=fields, fresh={name: drive.fresh[name] for name in fields})


def drop_frozen_position(drive: Drive) -> tuple[Drive, float]:
    """(the drive without its position where the INS repeats it while the car drives, for how many seconds).

    An INS that does so for most of a drive is at fault and is refused (learn/checks/stuck_signals.py).
    """
    speed = first_field_values(drive, CHASSIS_FIRST_SPEEDS)
    if speed is None or any(name not in drive.fields for name in POSITION_FIELDS):
        return drive, 0.0
    is_frozen = np.zeros(drive.n_rows, dtype=bool)
    is_repeated = np.all([np.diff(drive.fields[name], prepend=np.nan) == 0.0 for name in POSITION_FIELDS], axis=0)
    frame_rows = round(FROZEN_POSITION.min_frames * sample_interval_ticks(drive.fresh[POSITION_FIELDS[0]]))
    min_rows = max(round(FROZEN_POSITION.min_duration_s / drive.dt_s), frame_rows)
    for begin, end in find_runs(is_repeated, min_rows):
        distance_m = float(np.nansum(np.abs(speed[begin:end]))) * drive.dt_s
        is_frozen[begin:end] = distance_m > FROZEN_POSITION.min_distance_m
    if not is_frozen.any():
        return drive, 0.0
    fields, fresh = dict(drive.fields), dict(drive.fresh)
    for name in POSITION_FIELDS:
        fields[name] = np.where(is_frozen, np.nan, fields[name])
        fresh[name] = fresh[name] & ~is_frozen
    return drive._replace(fields=fields, fresh=fresh), float(is_frozen.sum()) * drive.dt_s
