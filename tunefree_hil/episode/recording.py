"""The recording of a drive: the columns of docs/reference/files.md, one row a tick, and `columns.npz` on disk."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import BenchError, InputError

Array = np.ndarray

ERROR_COLUMNS = (
    "station_error_m",
    "speed_error_mps",
    "lateral_error_m",
    "lateral_error_rate_mps",
    "heading_error_rad",
    "heading_error_rate_radps",
)
REFERENCE_COLUMNS = (
    "ref_x_m",
    "ref_y_m",
    "ref_heading_rad",
    "ref_speed_mps",
    "ref_accel_mps2",
    "ref_curvature_1pm",
    *ERROR_COLUMNS,
)
COMMAND_COLUMNS = ("cmd_throttle_frac", "cmd_brake_frac", "cmd_steer_rad")
VEHICLE_COLUMNS = (
    "out_throttle_frac",
    "out_brake_frac",
    "out_steer_rad",
    "speed_mps",
    "accel_mps2",
    "lateral_accel_mps2",
    "yaw_rate_radps",
    "x_m",
    "y_m",
    "heading_rad",
)
COLUMNS = ("t_s", "tick", *REFERENCE_COLUMNS, *COMMAND_COLUMNS, *VEHICLE_COLUMNS, "replan")

_INSTEAD = "instead"  # optional entry of the .npz beside the columns


class Recording(NamedTuple):
    """One drive. `columns`: name -> float64 array, all of one length; a column without values is absent.

    `instead`: column -> the substitute record field, where the vehicle lacks its own ('ins.speed_mps').
    """

    columns: dict[str, Array]
    dt_s: float
    instead: dict[str, str] = {}  # noqa: RUF012 - never mutated

    @property
    def ticks(self) -> int:
        """Rows."""
        return len(self.columns["tick"])

    def get(self, name: str) -> Array | None:
        """A column, or None where it is absent."""
        return self.columns.get(name)


def make_recording(columns: dict[str, Array], dt_s: float, instead: dict[str, str] | None = None) -> Recording:
    """A Recording in the order of COLUMNS, t_s and tick added, columns without any number left out.

    Raises ValueError for a name that is not in COLUMNS and for unequal lengths.
    """
    unknown = sorted(set(columns) - set(COLUMNS))
    if unknown:
        raise ValueError(f"not columns of a recording: {', '.join(unknown)}")
    lengths = {len(values) for values in columns.values()}
    if len(lengths) != 1:
        raise ValueError(f"columns of one length are needed, got {sorted(lengths)}")
    tick = np.arange(lengths.pop(), dtype=float)
    all_columns = {"t_s": tick * dt_s, "tick": tick, **columns}
    finite_columns = {}
    for name in COLUMNS:
        if name in all_columns:
            values = np.asarray(all_columns[name], dtype=float)
            if name == "tick" or not np.isnan(values).all():
                finite_columns[name] = values
    return Recording(
        finite_columns, dt_s, {name: text for name, text in (instead or {}).items() if name in finite_columns}
    )


def save_recording(recording: Recording, path: Path) -> None:
    """Write columns.npz atomically. Raises BenchError when it cannot be written."""
    entries = {"dt_s": np.array(recording.dt_s), **recording.columns}
    if recording.instead:
        entries[_INSTEAD] = np.array([f"{name}={text}" for name, text in sorted(recording.instead.items())])
    part = path.with_name(path.name + ".part")
    try:
        with part.open("wb") as file:
            np.savez(file, allow_pickle=False, **entries)
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise BenchError(
            f"cannot write: {error.strerror}", code="disk", file=str(path), hint="make room, then run the same command"
        ) from error


def load_recording(path: Path) -> Recording:
    """Read columns.npz. Raises InputError for a missing file or another format."""
    if not path.is_file():
        raise InputError("there is no such file", code="no_columns", file=str(path))
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
            columns = {name: data[name] for name in data.files}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"not a readable .npz ({error})", code="bad_columns", file=str(path)) from error
    if "tick" not in columns or "dt_s" not in columns:
        raise InputError("has no columns 'tick' and 'dt_s'", code="bad_columns", file=str(path))
    instead = dict(text.split("=", 1) for text in columns.pop(_INSTEAD, np.array([], dtype=str)).tolist())
    dt_s = float(columns.pop("dt_s"))
    return Recording({name: columns[name] for name in COLUMNS if name in columns}, dt_s, instead)
