"""Logs of any format as rows and frames, and the vehicle they are read as: what the `log` commands share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.find import CANDUMP, format_of, load_format
from tunefree_hil.bus.formats.rows import Row
from tunefree_hil.episode.candump import LogFrame, read_candump, read_rows

if TYPE_CHECKING:
    from tunefree_hil.bus.codec import Codec

KEPT_FLAGS = 31  # of a Row that a LogFrame has


class Log(NamedTuple):
    """A log's frames; `cut`: what to say when its last line was cut off, else ''."""

    frames: list[LogFrame]
    cut: str


def load_rows(path: Path) -> tuple[list[Row], str]:
    """(rows, format) of a log in any format. InputError for one that is missing, empty, cut off or foreign."""
    name = format_of(path)
    rows = read_rows(path) if name == CANDUMP else load_format(name).read(bag_of(path))
    if not rows:
        raise InputError("the log is empty: there is not one frame in it", code="empty_log", file=str(path))
    return rows, name


def bag_of(path: Path) -> Path:
    """A ROS 2 bag's folder, where one file of it is named."""
    inside = path.suffix in (".mcap", ".db3") and (path.parent / "metadata.yaml").is_file()
    return path.parent if inside else path


def load_log(path: Path) -> Log:
    """The frames of a log in any format; of candump text whose last line is cut off, all before it."""
    if format_of(path) != CANDUMP:
        rows, _ = load_rows(path)
        return Log([LogFrame(*row[:4], row.flags & KEPT_FLAGS) for row in rows], "")
    try:
        return Log(read_candump(path), "")
    except InputError as error:
        if error.code != "truncated_log":
            raise
        return Log(read_candump(path, allow_cut=True), error.message)


def by_channel(frames: Sequence[LogFrame], codec: Codec) -> bool:
    """Whether the log's channel names are those of vehicle.toml; the bench's own logs have one channel only."""
    named = {message.channel for message in (*codec.commands, *codec.telemetry)} - {""}
    return bool(named) and named <= {frame.channel for frame in frames}


def codec_for(path: Path, vehicle: str | None) -> tuple[Codec, str]:
    """The codec of the vehicle that was named, that lies beside the log, or that the log's run was made with.

    And its folder. Raises InputError when the vehicle is not known.
    """
    from tunefree_hil.bus.codec import Codec
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
