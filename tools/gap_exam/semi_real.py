"""Effects planted in recordings of real cars by rewriting their frames: of sensing, of timing, of actuators' reports.

A delay moves frames' stamps (a later report, an earlier command), as a logger would see it; a scale, an offset or a
filter changes a signal's bits and nothing else. Checksums of the car's maker are made good again.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cantools

from tools.gap_exam.cases import Case, Effects
from tools.gap_exam.files import Run

# The recordings, and what can be planted so that the car's other signals can show it
DART = ("speed_scale", "yaw_rate_bias", "yaw_rate_scale", "yaw_rate_filter", "report_latency", "ins_latency",
        "steer_dead_time")  # fmt: skip
RAV4 = ("steer_report_offset", "report_latency")
SOURCES: dict[str, tuple[tuple[str, ...], int]] = {  # effects, logs of each
    "dart_a": (DART, 3),
    "dart_b": (DART, 2),
    "dart_c": (DART, 2),
    "rav4": (RAV4, 2),  # a minute: shorter than most that are asked about
}
LEAST_SIZE = 0.55  # a shaking car of 1.6 kg, sampled at 10 Hz, hides what is just noticeable on a good car
WHEELS = "wheel_speed_radps"


class Frame(NamedTuple):
    """One line of a log."""

    stamp: str
    channel: str
    can_id: int
    data: bytes
    number: str  # as written


def read(text: str) -> list[Frame]:
    """Frames of candump text."""
    frames = []
    for line in text.splitlines():
        stamp, channel, rest = line.split()[:3]
        number, _, payload = rest.partition("#")
        frames.append(Frame(stamp.strip("()"), channel, int(number, 16), bytes.fromhex(payload), number))
    return frames


def written(frames: list[Frame]) -> str:
    """Candump text, in the order of the stamps."""
    ordered = sorted(frames, key=lambda one: float(one.stamp))
    return "".join(f"({one.stamp}) {one.channel} {one.number}#{one.data.hex().upper()}\n" for one in ordered)


class Car:
    """A vehicle folder as far as rewriting needs it."""

    def __init__(self, folder: Path) -> None:
        self.spec: dict[str, Any] = tomllib.loads((folder / "vehicle.toml").read_text())
        self.dbc: Any = cantools.database.load_file(folder / self.spec["dbc"][0], strict=False)

    def messages(self, group: str) -> dict[int, str]:
        """Ids of the messages that carry fields of a group, with the channel that vehicle.toml names ('' = any)."""
        entries = self.spec.get(group, {}).values()
        return {self.dbc.get_message_by_name(one["message"]).frame_id: one.get("channel", "") for one in entries}

    def signals(self, field: str) -> tuple[int, str, list[str], float]:
        """(id, channel, signals, SI value of a physical one) of a field."""
        group, _, name = field.partition(".")
        one = self.spec[group][name]
        names = [term["name"] for term in one["signals"]] if "signals" in one else one["signal"]
        names = names if isinstance(names, list) else [names]
        number = self.dbc.get_message_by_name(one["message"]).frame_id
        return number, one.get("channel", ""), names, float(one.get("scale", 1.0))


def planted(text: str, folder: Path, effects: Effects) -> str:
    """A log with the effects in it. Raises ValueError for one that cannot be planted by rewriting."""
    car, frames = Car(folder), read(text)
    for name, params in effects.items():
        if name not in _WAYS:
            raise ValueError(f"{name} cannot be planted in a recording; there are {', '.join(_WAYS)}")
        frames = _WAYS[name](car, frames, next(iter(params.values())))
    return written(frames)


def _moved(group: str, sign: int) -> Callable[[Car, list[Frame], float], list[Frame]]:
    """Frames of a group later (or earlier) by the delay."""

    def way(car: Car, frames: list[Frame], delay_s: float) -> list[Frame]:
        found = car.messages(group)
        return [one._replace(stamp=_later(one.stamp, sign * delay_s)) if _is(one, found) else one for one in frames]

    return way


def _later(stamp: str, by_s: float) -> str:
    whole, _, parts = stamp.partition(".")
    digits = len(parts)
    total = int(whole + parts) + round(by_s * 10**digits)
    return f"{total // 10**digits}.{total % 10**digits:0{digits}d}"


def _is(frame: Frame, found: dict[int, str]) -> bool:
    return frame.can_id in found and found[frame.can_id] in ("", frame.channel)


def _steer_earlier(car: Car, frames: list[Frame], delay_s: float) -> list[Frame]:
    """The steering command earlier: all that the car does comes later after it."""
    number, channel, _, _ = car.signals("command.steer_rad")
    found = {number: channel}
    return [one._replace(stamp=_later(one.stamp, -delay_s)) if _is(one, found) else one for one in frames]


Change = Callable[[list[float], list[float]], list[float]]  # stamps [s], SI values -> SI values


def _changed(fields: tuple[str, ...], change: Callable[[float], Change]) -> Callable[..., list[Frame]]:
    """Fields' values after a change that the effect's value makes."""

    def way(car: Car, frames: list[Frame], value: float) -> list[Frame]:
        for field in fields:
            group, _, name = field.partition(".")
            if name in car.spec.get(group, {}):
                frames = _rewritten(car, frames, field, change(value))
        return frames

    return way


def _rewritten(car: Car, frames: list[Frame], field: str, change: Change) -> list[Frame]:
    number, channel, names, scale = car.signals(field)
    message = car.dbc.get_message_by_frame_id(number)
    places = [i for i, one in enumerate(frames) if _is(one, {number: channel}) and len(one.data) >= message.length]
    raw = [message.decode(frames[i].data, scaling=True, decode_choices=False) for i in places]
    stamps = [float(frames[i].stamp) for i in places]
    together = field == "report.steer_rad" and len(names) > 1
    for group in [names] if together else [[name] for name in names]:
        values = change(stamps, [scale * sum(one[name] for name in group) for one in raw])
        for one, value in zip(raw, values, strict=True):
            one.update(_split(message, group, value / scale))
    frames = list(frames)
    for i, one in zip(places, raw, strict=True):
        frames[i] = frames[i]._replace(data=_with(message, frames[i], one))
    return frames


def _split(message: Any, names: list[str], value: float) -> dict[str, float]:
    """A value over signals of falling coarseness, each within its range."""
    found = {}
    for name in names:
        one = message.get_signal_by_name(name)
        factor, offset = float(one.scale), float(one.offset)
        steps = round((value - offset) / factor)
        if one.is_signed:
            steps = max(-(2 ** (one.length - 1)), min(2 ** (one.length - 1) - 1, steps))
        else:
            steps = max(0, min(2**one.length - 1, steps))
        found[name] = steps * factor + offset
        value -= found[name]
    return found


def _with(message: Any, frame: Frame, values: dict[str, Any]) -> bytes:
    """The frame with these values; bits that no signal covers stay as they were, and so does a sum that fitted."""
    mask = _bits(message, {name: 0 for name in values}, ones=True)
    new = int.from_bytes(message.encode(values, scaling=True, strict=False), "big")
    kept = int.from_bytes(frame.data[: message.length], "big") & ~mask
    data = bytearray((kept | (new & mask)).to_bytes(message.length, "big") + frame.data[message.length :])
    if _maker_sum(frame.can_id, frame.data) == frame.data[-1]:
        data[-1] = _maker_sum(frame.can_id, bytes(data))
    return bytes(data)


def _bits(message: Any, zero: dict[str, int], *, ones: bool) -> int:
    full = {one.name: -1 if one.is_signed else 2**one.length - 1 for one in message.signals} if ones else zero
    return int.from_bytes(message.encode(full, scaling=False, strict=False), "big")


def _maker_sum(can_id: int, data: bytes) -> int:
    """The sum that the RAV4's maker puts into the last byte."""
    return ((can_id >> 8) + (can_id & 0xFF) + len(data) + sum(data[:-1])) & 0xFF


def _factor(value: float) -> Change:
    return lambda _, values: [value * one for one in values]


def _plus(value: float) -> Change:
    return lambda _, values: [value + one for one in values]


def _softened(tau_s: float) -> Change:
    def change(stamps: list[float], values: list[float]) -> list[float]:
        out, y = [], values[0] if values else 0.0
        before = stamps[0] if stamps else 0.0
        for stamp, one in zip(stamps, values, strict=True):
            y += (1.0 - math.exp(-max(stamp - before, 0.0) / tau_s)) * (one - y)
            out.append(y)
            before = stamp
        return out

    return change


_YAW = ("report.yaw_rate_radps",)
_WAYS: dict[str, Callable[[Car, list[Frame], float], list[Frame]]] = {
    "speed_scale": _changed(("report.speed_mps", f"report.{WHEELS}"), _factor),
    "yaw_rate_bias": _changed(_YAW, _plus),
    "yaw_rate_scale": _changed(_YAW, _factor),
    "yaw_rate_filter": _changed(_YAW, _softened),
    "accel_bias": _changed(("report.accel_mps2",), _plus),
    "steer_report_offset": _changed(("report.steer_rad",), _plus),
    "report_latency": _moved("report", 1),
    "ins_latency": _moved("ins", 1),
    "steer_dead_time": _steer_earlier,
}


def names_of(source: str) -> Iterator[str]:
    """Effects to plant in a recording, each as often as it is asked for."""
    effects, each = SOURCES[source]
    for name in effects:
        yield from (name,) * each


def question(run: Run, case: Case) -> tuple[Path, list[str], dict[str, Any]]:
    """(vehicle folder, logs, more for the truth) of rewritten recordings, or of the recordings as they are."""
    folder = run.folder / "recordings" / case.source
    texts = [written(read(path.read_text())) for path in sorted(folder.glob("drive*.log"))]
    if case.effects:
        texts = [planted(text, folder / "vehicle", case.effects) for text in texts]
    return folder / "vehicle", texts, {"oracle": None, "mismatch": None}
