"""The format of a log: by its first bytes when it is read, by its name when it is written."""

from __future__ import annotations

import importlib
from pathlib import Path

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.rows import Format

CANDUMP = "candump"  # read and written by episode/candump.py
# name -> module, its constant, the package of an extra, suffixes
PLACES = {
    "blf": ("blf", "FORMAT", "", (".blf",)),
    "asc": ("asc", "FORMAT", "", (".asc",)),
    "csv": ("csv_text", "FORMAT", "", (".csv",)),
    "mf4": ("mf4", "FORMAT", "asammdf", (".mf4", ".mdf")),
    "ros1": ("ros", "ROS1", "rosbags", (".bag",)),
    "ros2": ("ros", "FORMAT", "rosbags", (".ros2",)),
}
EXTRAS = {"asammdf": "mf4", "rosbags": "rosbag"}  # package -> the extra that brings it
CANDUMP_SUFFIXES = (".log", ".candump", ".txt")
NAMES = (CANDUMP, *PLACES)
_BEGINNINGS = {b"LOGG": "blf", b"MDF ": "mf4", b"#ROSBAG": "ros1", b"date ": "asc", b"time_s,": "csv"}
_BEGINNINGS |= {b"timestamp,arbitration_id": "csv", b"Begin Trigger": "asc", b"//": "asc"}


def format_of(path: Path) -> str:
    """The format of an existing log: a ROS 2 bag is a folder, others are known by their first bytes.

    With unknown first bytes the suffix decides, else it is candump text, whose reader reports the problem. Raises
    InputError for a file that is missing or empty.
    """
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return "ros2"
        hint = "a ROS 2 bag's folder has metadata.yaml; else name a file"
        raise InputError("a folder that is no ROS 2 bag", code="foreign_log", file=str(path), hint=hint)
    if not path.is_file():
        raise InputError("there is no such log", code="no_log", file=str(path), hint="check the path")
    if path.suffix in (".mcap", ".db3"):
        return "ros2"
    with path.open("rb") as file:
        begin = file.read(64)
    if not begin:
        raise InputError("the log is empty: 0 bytes", code="empty_log", file=str(path), hint="record it again")
    format_name = next((name for start, name in _BEGINNINGS.items() if begin.startswith(start)), "")
    if not format_name and not begin.lstrip().startswith(b"("):
        format_name = _by_suffix(path)
    return format_name or CANDUMP


def format_for(path: Path, name: str = "") -> str:
    """The format to write: `name`, or that of the suffix."""
    known = ", ".join([*CANDUMP_SUFFIXES[:1], *(suffixes[0] for _, _, _, suffixes in PLACES.values())])
    if name and name not in NAMES:
        hint = f"one of {', '.join(NAMES)}"
        raise InputError(f"no format {name!r}", code="unknown_format", key="--format", hint=hint)
    format_name = name or _by_suffix(path)
    if format_name == "ros1" and path.suffix != ".bag":
        hint = "ROS tools know a ROS 1 bag by that"
        raise InputError("a ROS 1 bag's name must end in .bag", code="unknown_format", key="OUT", hint=hint)
    if not format_name:
        hint = f"end its name with one of {known}, or say --format"
        raise InputError(
            f"the name {path.name!r} does not show its format", code="unknown_format", key="OUT", hint=hint
        )
    return format_name


def _by_suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix in CANDUMP_SUFFIXES:
        return CANDUMP
    return next((name for name, (*_, suffixes) in PLACES.items() if suffix in suffixes), "")


def load_format(name: str) -> Format:
    """The reader and writer of a format. Raises InputError that names the extra to install."""
    module, constant, package, _ = PLACES[name]
    try:
        loaded = importlib.import_module(f"tunefree_hil.bus.formats.{module}")
    except ModuleNotFoundError as error:
        if not package or (error.name or "").partition(".")[0] != package:
            raise
        raise InputError(
            f"{name} needs the package {package}, which is not installed",
            code="missing_extra",
            key=name,
            hint=f"pip install 'tunefree_hil[{EXTRAS[package]}]'",
        ) from error
    return getattr(loaded, constant)
