"""Draws signals of a log over time."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.episode.candump import LogFrame
from tunefree_hil.jobs.log.files import by_channel, codec_for, cut_warning, open_log
from tunefree_hil.jobs.log.show import known_names, message_of, refuse_unknown

if TYPE_CHECKING:
    from tunefree_hil.bus.dbc.codec import Codec, MessageMap

GAP_PERIODS, GAP_S = 3.0, 0.05  # a silence is drawn as one from three periods on, but not below 50 ms
# The end of a record field's name -> the unit that is shown.
UNITS = {
    "_mps": "m/s",
    "_mps2": "m/s²",
    "_radps": "rad/s",
    "_rad": "rad",
    "_frac": "duty (0 to 1)",
    "_m": "m",
    "_nm": "Nm",
}


def plot(path: Path, vehicle: str | None, signals: Sequence[str], out: Path | None) -> Iterator[Event]:
    """Write a PNG (default: beside the log) of record fields ('report.speed_mps') or signals ('MESSAGE.SIGNAL')."""
    from tunefree_hil.figures.signals import Series, write_signals

    codec, where = codec_for(path, vehicle)
    wanted = [chosen for name in signals for chosen in choose(name, codec)]
    if not wanted:
        raise InputError("no signal is named", code="no_signal", key="SIGNALS", hint="for example report.speed_mps")
    log = open_log(path)
    if log.cut:
        yield Event("warning", cut_warning(log))
    units = dbc_units(where)
    found = series_of(log.frames(), codec, wanted, by_channel(log.frames(), codec))
    series = [Series(name, unit_of(name, units), *found[name], _gap_s(name, codec)) for name in dict.fromkeys(wanted)]
    silent = [one.name for one in series if not one.time_s.size]
    for name in silent:
        yield Event("warning", f"{name} was never heard in this log")
    if len(silent) == len(series):
        raise InputError("not one of the signals is in this log", code="never_heard", file=str(path), key="SIGNALS")
    target = write_signals(out or path.with_suffix(".png"), f"{path.name}: {codec.name}", series)
    data = {"figure": str(target), "values": {one.name: int(one.values.size) for one in series}, "vehicle": where}
    yield Event("result", "", {**data, "sentence": f"{len(series) - len(silent)} signals drawn in {target}"})


def choose(name: str, codec: Codec) -> list[str]:
    """The full names that `name` means: GROUP.FIELD or MESSAGE.SIGNAL. InputError with the nearest name there is."""
    refuse_unknown(name, known_names(codec), codec.name)
    messages = list(codec.by_name.values())
    full = [f"{field.group}.{field.name}" for message in messages for field in message.fields]
    full += [f"{message.name}.{signal}" for message in messages for signal in message.signals]
    return sorted({one for one in full if one == name or one.partition(".")[2] == name})


def series_of(
    frames: Iterable[LogFrame], codec: Codec, wanted: Sequence[str], apart: bool = False
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Full name -> (stamps in s, values: SI for record fields, the DBC's unit for signals), in the log's order.

    apart: the log's channels are the vehicle's (log_files.by_channel).
    """
    rows = {name: (array("d"), array("d")) for name in wanted}
    fields = {message.name: _values_of(message) for message in codec.by_name.values()}
    bearing = {message.name for message in codec.by_name.values() if _names_of(message) & rows.keys()}
    for frame in frames:
        message = message_of(frame, codec, apart)
        if message is None or message.name not in bearing or not codec.fits(message, frame.data):
            continue
        decoded = codec.decode(message, frame.data)
        values = {f"{message.name}.{name}": value for name, value in decoded.items()}
        names = fields[message.name]
        values |= {names[group, index]: value for group, index, value in codec.values(message, decoded)}
        for name in rows.keys() & values.keys():
            rows[name][0].append(frame.time_s)
            rows[name][1].append(values[name])
    return {name: (np.array(times), np.array(values)) for name, (times, values) in rows.items()}


def _names_of(message: MessageMap) -> set[str]:
    return {f"{message.name}.{name}" for name in message.signals} | set(_values_of(message).values())


def _values_of(message: MessageMap) -> dict[tuple[str, int], str]:
    return {(field.group, field.index): f"{field.group}.{field.name}" for field in message.fields}


def unit_of(name: str, units: Mapping[str, str]) -> str:
    """The unit in words: of a signal the DBC's, of a record field what its name says."""
    if name in units:
        return units[name]
    ends = sorted((end for end in UNITS if name.endswith(end)), key=len)
    return UNITS[ends[-1]] if ends else ""


def dbc_units(folder: str) -> dict[str, str]:
    """MESSAGE.SIGNAL -> unit, as the DBC has it."""
    from tunefree_hil.bus.dbc.network import read_network
    from tunefree_hil.config.load import load_vehicle

    network: dict[str, Any] = read_network(load_vehicle(folder))
    return {f"{name}.{one.name}": one.unit or "" for name, message in network.items() for one in message.signals}


def _gap_s(name: str, codec: Codec) -> float:
    """The silence from which the line of a signal is broken."""
    mine = next(
        message
        for message in codec.by_name.values()
        if name.startswith(f"{message.name}.") or name in _values_of(message).values()
    )
    return max(GAP_S, GAP_PERIODS * mine.period_ticks * codec.tick_ms / 1000.0)
