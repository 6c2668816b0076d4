"""Logs of any format as rows and frames, and the codec to decode them, for all `log` commands."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.find import CANDUMP, format_of, load_format
from tunefree_hil.bus.formats.rows import Row
from tunefree_hil.episode.candump import LogFrame, cut_line, read_rows

if TYPE_CHECKING:
    from tunefree_hil.bus.dbc.codec import Codec

KEPT_FLAGS = 31  # of a Row that a LogFrame has


class LogFile(NamedTuple):
    """A log that can be read repeatedly without loading it into memory.

    format: its name. cut_line: the incomplete last line of a candump text, else ''; `frames` leaves it out, `rows`
    raises an error for it.
    """

    path: Path
    format: str
    cut_line: str

    def rows(self) -> Iterator[Row]:
        """All rows. Raises InputError for an empty, truncated or unknown log."""
        return self._rows(allow_cut=False)

    def frames(self) -> Iterator[LogFrame]:
        """All frames, without the row data that only other formats use."""
        for row in self._rows(allow_cut=True):
            yield LogFrame(*row[:4], row[4] & KEPT_FLAGS)

    def _rows(self, allow_cut: bool) -> Iterator[Row]:
        if self.format == CANDUMP:
            yield from read_rows(self.path, allow_cut=allow_cut)
            return
        is_empty = True
        for row in load_format(self.format).read(bag_folder(self.path)):
            is_empty = False
            yield row
        if is_empty:
            hint = "record or export it again"
            message = "the log is empty: it contains no frame"
            raise InputError(message, code="empty_log", file=str(self.path), hint=hint)


def open_log(path: Path) -> LogFile:
    """Open a log; its format is detected from its first bytes. Raises InputError for a missing or empty file."""
    name = format_of(path)
    return LogFile(path, name, cut_line(path) if name == CANDUMP else "")


def describe_cut(log: LogFile) -> str:
    """Warning about an incomplete last line; '' where it is complete."""
    return f"the last line of the log is incomplete and left out: {log.cut_line[:60]!r}" if log.cut_line else ""


class LoadedLog(NamedTuple):
    """All frames of a log; cut_warning: about an incomplete last line, or ''."""

    frames: list[LogFrame]
    cut_warning: str


def load_log(path: Path) -> LoadedLog:
    """Load a whole log into memory."""
    log = open_log(path)
    return LoadedLog(list(log.frames()), describe_cut(log))


def bag_folder(path: Path) -> Path:
    """The folder of a ROS 2 bag where `path` is a file in it, else `path`."""
    inside = path.suffix in (".mcap", ".db3") and (path.parent / "metadata.yaml").is_file()
    return path.parent if inside else path


def has_vehicle_channels(frames: Iterable[LogFrame], codec: Codec) -> bool:
    """Whether the log has the channel names of the vehicle folder (Codec.has_channels)."""
    return codec.has_channels(frame.channel for frame in frames)


def codec_for_log(path: Path, vehicle: str | None) -> tuple[Codec, str]:
    """Codec and folder of a log's vehicle: the named one, the one beside the log, or that of the log's run.

    Raises InputError when the vehicle is not known.
    """
    from tunefree_hil.bus.dbc.codec import Codec
    from tunefree_hil.config.load import load_bench, load_vehicle

    near: Path | None = None
    if vehicle is None:
        folder = path.resolve().parent
        if (folder / "vehicle.toml").is_file():
            vehicle = str(folder)
        else:
            near = _bench_above(path)
            vehicle = load_bench(near).vehicle
    spec = load_vehicle(vehicle, near)
    return Codec(spec), spec.folder


def _bench_above(path: Path) -> Path:
    benches = [folder / "bench.toml" for folder in path.resolve().parents]
    near = next((file for file in benches if file.is_file()), None)
    if near is None:
        message = "the log is not in a run folder, so its vehicle is not known"
        hint = "name the vehicle: --vehicle mkz_bywire, or --vehicle path/to/folder"
        raise InputError(message, code="which_vehicle", key="--vehicle", file=str(path), hint=hint)
    return near
