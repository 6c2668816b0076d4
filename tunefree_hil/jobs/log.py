"""Looks into a log of CAN frames (candump text): is it whole, and what do the frames say?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event

if TYPE_CHECKING:
    from tunefree_hil.bus.codec import Codec, MessageMap
    from tunefree_hil.episode.candump import LogFrame

HEAD = f"{'message':<24}{'id':>8}{'frames':>8}{'Hz':>8}{'wanted':>8}{'gap ms':>8}{'late':>6}{'lost':>6}{'short':>7}"


def check(path: Path, vehicle: str | None) -> Iterator[Event]:
    """One line a message on stdout, then what is wrong. Exit 1 when something is."""
    from tunefree_hil.bus.log_check import check_frames

    codec, where = _codec_for(path, vehicle)
    yield Event("note", f"{path}, read as {where}")
    frames, cut = _frames(path)
    health = check_frames(frames, codec, _by_channel(frames, codec))
    yield Event("line", HEAD)
    for row in health.messages:
        yield Event("line", _row(row, codec))
    for can_id, count in health.foreign.items():
        yield Event("line", f"{'(foreign)':<24}{can_id & 0x1FFFFFFF:>#8x}{count:>8}")
    problems = ([cut] if cut else []) + health.problems
    for problem in problems:
        yield Event("line", f"fault: {problem}")
    seconds = frames[-1].time_s - frames[0].time_s
    holds = f"{len(problems)} faults" if len(problems) != 1 else "1 fault"
    sentence = f"{len(frames)} frames in {seconds:.2f} s: " + (holds if problems else "the log is whole")
    data = {"messages": health.messages, "foreign": health.foreign, "problems": problems, "vehicle": where}
    yield Event("result", "", {**data, "frames": len(frames), "sentence": sentence, "exit": 1 if problems else 0})


def _row(row: Any, codec: Codec) -> str:
    wanted_hz = 1000.0 / row.period_ms
    gap = f"{1000.0 * row.longest_gap_s:8.1f}" if row.frames > 1 else f"{'-':>8}"
    rate = f"{row.rate_hz:8.1f}" if row.frames > 1 else f"{'-':>8}"
    counts = f"{row.late:>6}{row.lost:>6}{row.short:>7}"
    can_id = codec.by_name[row.name].can_id
    return f"{row.name:<24}{can_id:>#8x}{row.frames:>8}{rate}{wanted_hz:8.1f}{gap}{counts}"


def show(path: Path, vehicle: str | None, signals: Sequence[str]) -> Iterator[Event]:
    """One line a frame on stdout: the DBC's physical values, then the record fields in SI.

    `signals`: signal names or record fields ('speed_mps', 'report.speed_mps'); frames without any are left out.
    """
    codec, where = _codec_for(path, vehicle)
    yield Event("note", f"{path}, read as {where}")
    _refuse_unknown(signals, codec)
    frames, cut = _frames(path)
    if cut:
        yield Event("warning", cut)
    shown, by_channel = 0, _by_channel(frames, codec)
    for frame in frames:
        message = _message_of(frame, codec, by_channel)
        words = _decoded(frame, message, codec, signals)
        if words:
            shown += 1
            name = message.name if message is not None else "(foreign)"
            yield Event("line", f"{frame.time_s:.6f} {frame.channel} {frame.can_id & 0x1FFFFFFF:03X} {name} {words}")
    sentence = f"{shown} of {len(frames)} frames shown"
    yield Event("result", "", {"sentence": sentence, "frames": len(frames), "shown": shown})


def _by_channel(frames: Sequence[LogFrame], codec: Codec) -> bool:
    """Whether the log's channel names are those of vehicle.toml; the bench's own logs have one channel only."""
    named = {message.channel for message in (*codec.commands, *codec.telemetry)} - {""}
    return bool(named) and named <= {frame.channel for frame in frames}


def _message_of(frame: LogFrame, codec: Codec, by_channel: bool) -> MessageMap | None:
    from tunefree_hil.base.records import CanFrame
    from tunefree_hil.episode.candump import ERROR, EXTENDED_BIT, RTR

    if frame.flags & (ERROR | RTR):
        return None
    extended = bool(frame.can_id & EXTENDED_BIT)
    heard = CanFrame(frame.can_id & ~EXTENDED_BIT, frame.data, extended)
    return codec.find(heard, frame.channel if by_channel else "")


def _decoded(frame: LogFrame, message: MessageMap | None, codec: Codec, wanted: Sequence[str]) -> str:
    """'PO=0.15 report.throttle_frac=0.15', or '' where nothing was asked of this frame."""
    if message is None or not codec.fits(message, frame.data):
        return "" if wanted else frame.data.hex().upper() or "-"
    decoded = codec.decode(message, frame.data)
    pairs = list(decoded.items())
    names = {(field.group, field.index): field.name for field in message.fields}
    pairs += [(f"{group}.{names[group, index]}", value) for group, index, value in codec.values(message, decoded)]
    if wanted:
        pairs = [(name, value) for name, value in pairs if name in wanted or name.partition(".")[2] in wanted]
    return " ".join(f"{name}={value:.9g}" for name, value in pairs)


def _refuse_unknown(signals: Sequence[str], codec: Codec) -> None:
    from tunefree_hil.config.find import nearest

    known = {name for message in codec.by_name.values() for name in message.signals}
    fields = [field for message in codec.by_name.values() for field in message.fields]
    known |= {field.name for field in fields} | {f"{field.group}.{field.name}" for field in fields}
    for name in signals:
        if name not in known:
            raise InputError(f"{codec.name} has no signal {name!r}", code="unknown_signal", hint=nearest(name, known))


def _frames(path: Path) -> tuple[list[LogFrame], str]:
    """The log's frames, and what to say when its last line was cut off."""
    from tunefree_hil.episode.candump import read_candump

    try:
        return read_candump(path), ""
    except InputError as error:
        if error.code != "truncated_log":
            raise
        return read_candump(path, allow_cut=True), error.message


def _codec_for(path: Path, vehicle: str | None) -> tuple[Codec, str]:
    """The codec of the vehicle that was named, or of the run that the log lies in, and its folder."""
    from tunefree_hil.bus.codec import Codec
    from tunefree_hil.config.load import load_bench, load_vehicle

    near: Path | None = None
    if vehicle is None:
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
        vehicle = load_bench(near).vehicle
    spec = load_vehicle(vehicle, near)
    return Codec(spec), spec.folder
