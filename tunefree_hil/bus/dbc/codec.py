"""DBC + vehicle.toml -> frames from records, records from frames (docs/reference/files.md).

cantools reads the layout once; every tick runs flat steps compiled from it (bus/dbc/encode_plan.py). They agree with
cantools bit for bit (tests/bus/dbc/test_codec.py) and cost a few microseconds a message.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GROUPS, NAN, CanFrame, Command, Ins, Report
from tunefree_hil.bus.dbc.build_map import build_messages
from tunefree_hil.bus.dbc.check_vehicle import check_vehicle, one_error
from tunefree_hil.bus.dbc.encode_plan import read_float
from tunefree_hil.bus.dbc.message_map import COMMAND, EXTENDED_FLAG, TELEMETRY, FieldMap, MessageMap, Plan
from tunefree_hil.bus.dbc.network import read_network
from tunefree_hil.bus.dbc.quantise import to_raw, wrap_turn

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

__all__ = ["Codec", "MessageMap", "Snapshot"]


class FieldValue(NamedTuple):
    """SI value of a record field. index: the field's place in its record."""

    group: str
    index: int
    value: float


class Codec:
    """The messages of a vehicle. `commands` and `telemetry` in id order; `by_id` by SocketCAN id (EFF bit included).

    Raises one InputError that lists everything wrong with the folder.
    """

    def __init__(self, spec: VehicleSpec) -> None:
        network = read_network(spec)
        problems = check_vehicle(spec, network)
        if problems:
            raise one_error(problems)
        messages = build_messages(spec, network)
        self.name: str = spec.name
        self.tick_ms: int = spec.tick_ms
        self.commands = tuple(m for m in messages if m.kind == COMMAND)
        self.telemetry = tuple(m for m in messages if m.kind == TELEMETRY)
        self.by_id: dict[int, MessageMap] = {}
        for message in messages:
            self.by_id.setdefault(message.key, message)
        self.by_name: dict[str, MessageMap] = {message.name: message for message in reversed(messages)}
        self._by_channel = {(message.key, message.channel): message for message in messages}

    def find(self, frame: CanFrame, channel: str = "") -> MessageMap | None:
        """The message of a frame received on `channel` ('': any), or None where the folder has no such frame."""
        key = frame.id | EXTENDED_FLAG if frame.extended else frame.id
        if not channel:
            return self.by_id.get(key)
        return self._by_channel.get((key, channel)) or self._by_channel.get((key, ""))

    def has_channels(self, channels: Iterable[str]) -> bool:
        """Whether a log's channel names are those of vehicle.toml, and so distinguish equal ids.

        channels: one a frame, or one a name; read only until all are found, not at all where the folder names none. The
        bench's logs have one channel whatever the folder names: they do not match.
        """
        missing = {message.channel for message in (*self.commands, *self.telemetry)} - {""}
        return bool(missing) and any(not (missing.discard(channel) or missing) for channel in channels)

    def encode(
        self,
        message: MessageMap,
        records: Mapping[str, Any],
        signals: Mapping[str, float],
        length: int | None = None,
    ) -> bytes:
        """The payload of a message.

        records: {"report": Report(...), ...}; a group that is not there leaves its fields raw 0. A value is clipped to
        its signal's range and rounded half to even; NaN and infinities are sent as raw 0; a heading is wrapped.
        signals: raw values by signal name (enable, counter, states ...); they win over fields and constants.
        length: bytes to keep of the payload (a clear frame), None: all.
        """
        payload = self.encode_bits(message, records, raw_bits(message, signals))
        return payload if length is None else payload[:length]

    def encode_bits(self, message: MessageMap, records: Mapping[str, Any], raw: RawBits) -> bytes:
        """As `encode`, with the raw values made ready by `raw_bits`."""
        plan = message.plan
        little, big = plan.little, plan.big
        for group, steps, scaled in plan.simple:
            record = records.get(group)
            if record is None:
                continue
            for index, factor, low, high, mask, shift in steps:
                value = record[index]
                if value - value == 0.0:  # NaN, infinite: raw 0
                    value /= factor
                    little |= (round(low if value < low else high if value > high else value) & mask) << shift
            for index, offset, scale, term_scale, signal_offset, factor, low, high, mask, shift, is_big in scaled:
                value = record[index]
                if value - value != 0.0:
                    continue
                value = ((value - offset) / scale / term_scale - signal_offset) / factor
                whole = round(low if value < low else high if value > high else value)
                if is_big:
                    big |= (whole & mask) << shift
                else:
                    little |= (whole & mask) << shift
        for field in plan.special:
            if field.group in records:
                more_little, more_big = _special_bits(field, records[field.group][field.index])
                little, big = little | more_little, big | more_big
        size = message.length
        payload = (little & raw.keep_little | raw.little).to_bytes(size, "little")
        big = big & raw.keep_big | raw.big
        if big:
            payload = (int.from_bytes(payload, "big") | big).to_bytes(size, "big")
        return payload

    def decode(self, message: MessageMap, data: bytes) -> dict[str, float]:
        """Physical values by signal name; raw values of signals with a role or a state. Excess bytes are ignored.

        A short payload gives the signals that are whole in it where `allow_truncated`, else raises InputError.
        """
        if len(data) < message.length:
            return self._decode_short(message, data)
        return _read(message.plan, data[: message.length])

    def _decode_short(self, message: MessageMap, data: bytes) -> dict[str, float]:
        if not message.allow_truncated:
            raise InputError(
                f"a frame of {message.name} has {len(data)} bytes, the DBC says {message.length}",
                code="short_frame",
                key=message.name,
                hint="allow_truncated = true in vehicle.toml decodes such frames as far as they go",
            )
        decoded = _read(message.plan, data.ljust(message.length, b"\xff"))
        bits_present = 8 * len(data)
        return {name: value for name, value in decoded.items() if message.signals[name].end_bit <= bits_present}

    def values(self, message: MessageMap, decoded: Mapping[str, float]) -> list[FieldValue]:
        """The record fields of a decoded message; fields with a missing signal are left out."""
        values = []
        for group, index, terms, scale, offset in message.plan.values:
            total = 0.0
            for name, term_scale in terms:
                if name not in decoded:
                    break
                total += decoded[name] * term_scale
            else:
                values.append(FieldValue(group, index, total * scale + offset))
        return values


class RawBits(NamedTuple):
    """Raw values as bits to put into the payload's two integers, and the bits of those that stay."""

    keep_little: int
    little: int
    keep_big: int
    big: int


def raw_bits(message: MessageMap, signals: Mapping[str, float]) -> RawBits:
    """Raw values by signal name, made ready; of two on the same bits the later one counts."""
    raws = message.plan.raws
    keep_little = keep_big = -1
    little = big = 0
    for name, value in signals.items():
        mask, shift, others, is_big = raws[name]
        if is_big:
            keep_big, big = keep_big & others, big & others | (int(value) & mask) << shift
        else:
            keep_little, little = keep_little & others, little & others | (int(value) & mask) << shift
    return RawBits(keep_little, little, keep_big, big)


def _special_bits(field: FieldMap, value: float) -> tuple[int, int]:
    """A heading, or a sum (each term takes what the coarser ones left over): integers to put in, little and big."""
    bits = [0, 0]
    if value - value != 0.0:
        return 0, 0
    turn = field.turn.raw_turn
    if turn > 0.0:
        value = wrap_turn(value, field.turn.low_rad)
    rest = (value - field.offset) / field.scale
    for signal, scale in field.terms:
        steps = (rest / scale - float(signal.offset)) / float(signal.factor)
        whole = int(to_raw(steps, float(signal.raw_low), float(signal.raw_high), turn))
        bits[signal.big_endian] |= (whole & signal.mask) << signal.shift
        rest = rest - (whole * signal.factor + signal.offset) * scale
        turn = 0.0
    return bits[0], bits[1]


def _read(plan: Plan, data: bytes) -> dict[str, float]:
    """Every signal of a payload of full length."""
    little = int.from_bytes(data, "little")
    big = int.from_bytes(data, "big")
    decoded: dict[str, float] = {}
    for payload, steps in ((little, plan.reads_little), (big, plan.reads_big)):
        for name, shift, mask, sign, factor, offset in steps:
            decoded[name] = (((payload >> shift & mask) ^ sign) - sign) * factor + offset
    for signal in plan.floats:
        decoded[signal.name] = read_float(signal, little, big)
    return decoded


class Snapshot:
    """The latest values received of a vehicle; NaN before the first."""

    def __init__(self, codec: Codec) -> None:
        self.codec = codec
        self._groups = {group: [NAN] * len(record._fields) for group, record in GROUPS.items()}
        self._direct = {m: steps for m in (*codec.commands, *codec.telemetry) if (steps := self._steps(m)) is not None}

    def receive(self, message: MessageMap, data: bytes) -> dict[str, float]:
        """Take in a payload; its signals as in `Codec.decode`."""
        decoded = self.codec.decode(message, data)
        for group, index, value in self.codec.values(message, decoded):
            self._groups[group][index] = value
        return decoded

    def take(self, message: MessageMap, data: bytes) -> None:
        """Take in a payload; `receive` without the signals, bit for bit the same values and a third of the time."""
        steps = self._direct.get(message)
        if steps is None or len(data) < message.length:
            self.receive(message, data)
            return
        little = int.from_bytes(data if len(data) == message.length else data[: message.length], "little")
        for values, index, shift, mask, sign, factor, offset, term_scale, scale, field_offset in steps:
            physical = (((little >> shift & mask) ^ sign) - sign) * factor + offset
            values[index] = (0.0 + physical * term_scale) * scale + field_offset

    def _steps(self, message: MessageMap) -> tuple[tuple[Any, ...], ...] | None:
        """One flat step a field where each is one little-endian integer signal, else None."""
        reads = {read.name: read for read in message.plan.reads_little}
        steps = []
        for field in message.fields:
            signal, term_scale = field.terms[0]
            if len(field.terms) > 1 or signal.name not in reads:
                return None
            _, *read = reads[signal.name]
            steps.append((self._groups[field.group], field.index, *read, term_scale, field.scale, field.offset))
        return tuple(steps)

    def report(self) -> Report:
        """The latest chassis report."""
        return Report._make(self._groups["report"])

    def ins(self) -> Ins:
        """The latest INS record."""
        return Ins._make(self._groups["ins"])

    def command(self) -> Command:
        """The latest commands."""
        return Command._make(self._groups["command"])
