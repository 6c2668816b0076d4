"""Logs of any format as rows and frames, and the vehicle they are read as: what the `log` commands share."""

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


class Log(NamedTuple):
    """A log that is read as often as one likes, never held as a whole.

    format: its name. cut: of candump text what is left of a last line that was cut off, else ''; `frames` leaves that
    line out, `rows` refuses it.
    """

    path: Path
    format: str
    cut: str

    def rows(self) -> Iterator[Row]:
        """All of it. InputError for a log that is empty, cut off or foreign; an OSError where the disk fails."""
        return self._rows(allow_cut=False)

    def frames(self) -> Iterator[LogFrame]:
        """The frames without what only other formats ask for."""
        for row in self._rows(allow_cut=True):
            yield LogFrame(*row[:4], row[4] & KEPT_FLAGS)

    def _rows(self, allow_cut: bool) -> Iterator[Row]:
        if self.format == CANDUMP:
            yield from read_rows(self.path, allow_cut=allow_cut)
            return
        heard = False
        for row in load_format(self.format).read(bag_of(self.path)):
            heard = True
            yield row
        if not heard:
            hint = "record it again, or export it anew"
            message = "the log is empty: there is not one frame in it"
            raise InputError(message, code="empty_log", file=str(self.path), hint=hint)


def open_log(path: Path) -> Log:
    """A log in any format, told by how it begins. InputError for one that is missing or has no byte."""
    name = format_of(path)
    return Log(path, name, cut_line(path) if name == CANDUMP else "")


def cut_warning(log: Log) -> str:
    """What to say of a log whose last line was cut off; '' where it was not."""
    return f"the log is cut off in its last line, which is left out: {log.cut[:60]!r}" if log.cut else ""


class Whole(NamedTuple):
    """All frames at once; cut: what to say of the last line."""

    frames: list[LogFrame]
    cut: str


def load_log(path: Path) -> Whole:
    """A whole log in memory, for what needs all of it (grading a drive)."""
    log = open_log(path)
    return Whole(list(log.frames()), cut_warning(log))


def bag_of(path: Path) -> Path:
    """A ROS 2 bag's folder, where one file of it is named."""
    inside = path.suffix in (".mcap", ".db3") and (path.parent / "metadata.yaml").is_file()
    return path.parent if inside else path


def by_channel(frames: Iterable[LogFrame], codec: Codec) -> bool:
    """Whether the log's channels are the folder's (Codec.has_channels); frames are looked at only until it is sure."""
    return codec.has_channels(frame.channel for frame in frames)


def codec_for(path: Path, vehicle: str | None) -> tuple[Codec, str]:
    """The codec of the vehicle that was named, that lies beside the log, or that the log's run was made with.

    And its folder. Raises InputError when the vehicle is not known.
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
    near = next((one for one in benches if one.is_file()), None)
    if near is None:
        raise InputError(
            "the log lies in no run folder, so its vehicle is not known",
            code="which_vehicle",
            key="--vehicle",
            file=str(path),
            hint="name the vehicle: --vehicle mkz_bywire, or --vehicle path/to/folder",
        )
    return near
