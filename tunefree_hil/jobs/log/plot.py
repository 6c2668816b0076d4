"""Plot signals of a log over time."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.episode.candump import LogFrame
from tunefree_hil.jobs.log.files import codec_for_log, describe_cut, has_vehicle_channels, open_log
from tunefree_hil.jobs.log.options import LogPlotOptions
from tunefree_hil.jobs.log.show import field_names, find_message, full_names, known_names, require_known_signal

if TYPE_CHECKING:
    from tunefree_hil.bus.dbc.codec import Codec

GAP_PERIODS, GAP_S = 3.0, 0.05  # a line is interrupted at a gap of three periods, at least 50 ms
# suffix of a record field's name -> unit
UNITS = {
    "_mps": "m/s",
    "_mps2": "m/s²",
    "_radps": "rad/s",
    "_rad": "rad",
    "_frac": "duty (0 to 1)",
    "_m": "m",
    "_nm": "Nm",
}


def plot(options: LogPlotOptions) -> Iterator[Event]:
    """Write a PNG (default: beside the log) of record fields ('report.speed_mps') or signals ('MESSAGE.SIGNAL')."""
    from tunefree_hil.figures.signals import Series, draw_signals
    from tunefree_hil.figures.style import save

    path = options.path
    codec, where = codec_for_log(path, options.vehicle)
    wanted = [chosen for name in options.signals for chosen in resolve_signals(name, codec)]
    if not wanted:
        raise InputError("no signal is named", code="no_signal", key="SIGNALS", hint="for example report.speed_mps")
    log = open_log(path)
    if log.cut_line:
        yield Event("warning", describe_cut(log))
    units = dbc_units(where)
    collected = collect_series(log.frames(), codec, wanted, has_vehicle_channels(log.frames(), codec))
    series = [
        Series(name, signal_unit(name, units), *collected[name], _gap_s(name, codec)) for name in dict.fromkeys(wanted)
    ]
    silent = [row.name for row in series if not row.time_s.size]
    for name in silent:
        yield Event("warning", f"{name} does not occur in this log")
    if len(silent) == len(series):
        raise InputError("none of the signals occurs in this log", code="never_heard", file=str(path), key="SIGNALS")
    target = save(draw_signals(f"{path.name}: {codec.name}", series), options.out or path.with_suffix(".png"))
    data = {"figure": str(target), "values": {one.name: int(one.values.size) for one in series}, "vehicle": where}
    yield Event("result", "", {**data, "sentence": f"{len(series) - len(silent)} signals drawn in {target}"})


def resolve_signals(name: str, codec: Codec) -> list[str]:
    """Full names (GROUP.FIELD or MESSAGE.SIGNAL) for a name. Raises InputError with the nearest known name."""
    require_known_signal(name, known_names(codec), codec.name)
    full = {known for message in codec.by_name.values() for known in full_names(message)}
    return sorted(known for known in full if name in (known, known.partition(".")[2]))


def collect_series(
    frames: Iterable[LogFrame], codec: Codec, wanted: Sequence[str], by_channel: bool = False
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Time stamps in s and values by full name: SI for record fields, the DBC's unit for signals.

    by_channel: the log has the vehicle's channel names (files.has_vehicle_channels).
    """
    rows = {name: (array("d"), array("d")) for name in wanted}
    fields = {message.name: field_names(message) for message in codec.by_name.values()}
    bearing = {message.name for message in codec.by_name.values() if full_names(message) & rows.keys()}
    for frame in frames:
        message = find_message(frame, codec, by_channel)
        if message is None or message.name not in bearing or not message.fits(frame.data):
            continue
        decoded = codec.decode(message, frame.data)
        values = {f"{message.name}.{name}": value for name, value in decoded.items()}
        names = fields[message.name]
        values |= {names[group, index]: value for group, index, value in codec.values(message, decoded)}
        for name in rows.keys() & values.keys():
            rows[name][0].append(frame.time_s)
            rows[name][1].append(values[name])
    return {name: (np.array(times), np.array(values)) for name, (times, values) in rows.items()}


def signal_unit(name: str, units: Mapping[str, str]) -> str:
    """Unit of a signal (from the DBC) or of a record field (from its name)."""
    if name in units:
        return units[name]
    ends = sorted((end for end in UNITS if name.endswith(end)), key=len)
    return UNITS[ends[-1]] if ends else ""


def dbc_units(folder: str) -> dict[str, str]:
    """MESSAGE.SIGNAL -> unit, from the DBC."""
    from tunefree_hil.bus.dbc.network import read_network
    from tunefree_hil.config.load import load_vehicle

    network: dict[str, Any] = read_network(load_vehicle(folder))
    return {f"{name}.{one.name}": one.unit or "" for name, message in network.items() for one in message.signals}


def _gap_s(name: str, codec: Codec) -> float:
    """Gap at which the line of a signal is interrupted."""
    messages = codec.by_name.values()
    source = next(one for one in messages if name.startswith(f"{one.name}.") or name in field_names(one).values())
    return max(GAP_S, GAP_PERIODS * source.period_ticks * codec.tick_ms / 1000.0)
