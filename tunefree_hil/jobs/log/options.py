"""The options of `log check`, `show`, `plot`, `convert` and `import`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

from tunefree_hil.jobs.options.option import Argument, Option, Vehicle

LogPath = Annotated[Path, Argument("a log: candump, blf, asc, csv, mf4, ROS bag", metavar="LOG")]


class LogCheckOptions(NamedTuple):
    """The options of `log check`."""

    path: LogPath
    vehicle: Vehicle = None


class LogShowOptions(NamedTuple):
    """The options of `log show`. signals: empty for all."""

    path: LogPath
    vehicle: Vehicle = None
    signals: Annotated[Sequence[str], Option("only this signal or record field; may be repeated", "--signal")] = ()


class LogPlotOptions(NamedTuple):
    """The options of `log plot`."""

    path: LogPath
    signals: Annotated[Sequence[str], Argument("report.speed_mps, MESSAGE.SIGNAL ...", metavar="SIGNALS...")]
    vehicle: Vehicle = None
    out: Annotated[Path | None, Option("PNG to write; default: the log's name with .png")] = None


class LogConvertOptions(NamedTuple):
    """The options of `log convert`. channels: empty for all. to: '' for the format of the target's suffix."""

    source: LogPath
    target: Annotated[Path, Argument("ends in .log .blf .asc .csv .mf4 .bag or .ros2", metavar="OUT")]
    channels: Annotated[Sequence[str], Option("only this channel; may be repeated", "--channel")] = ()
    to: Annotated[str, Option("candump, blf, asc, csv, mf4, ros1 or ros2", "--format")] = ""


class LogImportOptions(NamedTuple):
    """The options of `log import`."""

    path: Annotated[Path, Argument("a test drive: a header line, one row a sample", metavar="CSV")]
    mapping: Annotated[Path, Option("mapping file: column -> record field, unit, clock", "--map")]
    out: Annotated[Path, Option("folder to write: drive.log and the vehicle folder to read it with")]
