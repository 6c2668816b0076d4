"""Print a log decoded, and check signal names given by the user."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.base.records import CanFrame
from tunefree_hil.episode.candump import ERROR, EXTENDED_BIT, RTR, LogFrame
from tunefree_hil.jobs.log.files import codec_for_log, describe_cut, has_vehicle_channels, open_log
from tunefree_hil.jobs.log.options import LogShowOptions

if TYPE_CHECKING:
    from tunefree_hil.bus.dbc.codec import Codec, MessageMap


def show(options: LogShowOptions) -> Iterator[Event]:
    """One line a frame on stdout: physical values of the DBC, then record fields in SI.

    `options.signals` has signal names or record fields ('speed_mps', 'report.speed_mps'); frames without them are left
    out.
    """
    signals = options.signals
    codec, where = codec_for_log(options.path, options.vehicle)
    yield Event("note", f"{options.path}, read as {where}")
    known = known_names(codec)
    for name in signals:
        require_known_signal(name, known, codec.name)
    log = open_log(options.path)
    if log.cut_line:
        yield Event("warning", describe_cut(log))
    shown, count, apart = 0, 0, has_vehicle_channels(log.frames(), codec)
    for frame in log.frames():
        count += 1
        message = find_message(frame, codec, apart)
        text = _decoded(frame, message, codec, signals)
        if text:
            shown += 1
            name = message.name if message is not None else "(foreign)"
            yield Event("line", f"{frame.time_s:.6f} {frame.channel} {frame.can_id & 0x1FFFFFFF:03X} {name} {text}")
    sentence = f"{shown} of {count} frames shown"
    yield Event("result", "", {"sentence": sentence, "frames": count, "shown": shown})


def find_message(frame: LogFrame, codec: Codec, by_channel: bool) -> MessageMap | None:
    """Message of a frame; None for a foreign, error or remote frame. by_channel: files.has_vehicle_channels."""
    if frame.flags & (ERROR | RTR):
        return None
    extended = bool(frame.can_id & EXTENDED_BIT)
    can_frame = CanFrame(frame.can_id & ~EXTENDED_BIT, frame.data, extended)
    return codec.find(can_frame, frame.channel if by_channel else "")


def field_names(message: MessageMap) -> dict[tuple[str, int], str]:
    """GROUP.FIELD of the record fields in a message, by group and index in the record."""
    return {(field.group, field.index): f"{field.group}.{field.name}" for field in message.fields}


def full_names(message: MessageMap) -> set[str]:
    """MESSAGE.SIGNAL and GROUP.FIELD of a message."""
    return {f"{message.name}.{name}" for name in message.signals} | set(field_names(message).values())


def known_names(codec: Codec) -> set[str]:
    """Signals and record fields, with and without their message or group."""
    full = {name for message in codec.by_name.values() for name in full_names(message)}
    return full | {name.partition(".")[2] for name in full}


def require_known_signal(name: str, known: set[str], vehicle: str) -> None:
    """Raise InputError with the nearest known name, unless `name` is known."""
    from tunefree_hil.config.find import nearest

    if name not in known:
        raise InputError(f"{vehicle} has no signal {name!r}", code="unknown_signal", hint=nearest(name, known))


def _decoded(frame: LogFrame, message: MessageMap | None, codec: Codec, wanted: Sequence[str]) -> str:
    """Text such as 'PO=0.15 report.throttle_frac=0.15', or '' where the frame has no wanted signal."""
    if message is None or not message.fits(frame.data):
        return "" if wanted else frame.data.hex().upper() or "-"
    decoded = codec.decode(message, frame.data)
    pairs = list(decoded.items())
    names = field_names(message)
    pairs += [(names[group, index], value) for group, index, value in codec.values(message, decoded)]
    if wanted:
        prefix = f"{message.name}."
        pairs = [
            (name, value)
            for name, value in pairs
            if name in wanted or name.partition(".")[2] in wanted or prefix + name in wanted
        ]
    return " ".join(f"{name}={value:.9g}" for name, value in pairs)
