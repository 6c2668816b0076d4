"""The codec's data of a message: its bits, the record fields in it, the signals with a role.

A signal's raw value r, an integer, means r * factor + offset in the DBC's unit; a field is the sum of its signals'
scaled values, times `scale`, plus `offset`, in SI.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from tunefree_hil.bus.dbc.e2e import Protection

EXTENDED_FLAG = 0x8000_0000  # SocketCAN's EFF bit: distinguishes the 29-bit id from the 11-bit id of the same number
TWO_PI = 6.283185307179586
COMMAND, TELEMETRY = "command", "telemetry"
# The by-wire channels that a record field belongs to, by the beginning of "group.name".
BYWIRE_PREFIXES = {
    "command.throttle": ("throttle",),
    "command.brake": ("brake",),
    "command.steer": ("steer",),
    "command.gear": ("gear",),
    "command.accel": ("brake", "throttle"),
    "report.throttle": ("throttle",),
    "report.brake": ("brake",),
    "report.steer": ("steer",),
    "report.gear": ("gear",),
    "report.accel_command": ("brake", "throttle"),
}


class SignalMap(NamedTuple):
    """One signal. `shift` counts from the low end of the payload read as one integer in the signal's byte order."""

    name: str
    shift: int
    bits: int
    big_endian: bool
    signed: bool
    is_float: bool
    factor: float
    offset: float
    raw_low: int  # what encode clips to: the declared range, or the full range of the bits
    raw_high: int
    end_bit: int  # bits of payload that must be there for the signal to be whole

    @property
    def mask(self) -> int:
        return (1 << self.bits) - 1


class Term(NamedTuple):
    """A signal's part in a field: physical value * scale. Coarse terms come first."""

    signal: SignalMap
    scale: float


class Turn(NamedTuple):
    """How a heading is wrapped: into [low_rad, low_rad + 2 pi); a raw value beyond the range moves by `raw_turn`."""

    low_rad: float = 0.0
    raw_turn: float = 0.0  # 0: no heading


class FieldMap(NamedTuple):
    """One record field: records[group][index]."""

    group: str
    name: str
    index: int
    terms: tuple[Term, ...]
    scale: float
    offset: float
    turn: Turn


class StateMap(NamedTuple):
    """One bit or code of a report for a condition of the by-wire system ([state] of vehicle.toml)."""

    condition: str
    signal: str
    active: float
    effect: str
    bywire: str
    cause: str


class ReadStep(NamedTuple):
    """value = ((((payload >> shift) & mask) ^ sign) - sign) * factor + offset."""

    name: str
    shift: int
    mask: int
    sign: int
    factor: float
    offset: float


class WriteStep(NamedTuple):
    """A field of one signal: ((value - offset) / scale / term_scale - signal_offset) / factor, clipped, rounded."""

    index: int
    offset: float
    scale: float
    term_scale: float
    signal_offset: float
    factor: float
    raw_low: float
    raw_high: float
    mask: int
    shift: int
    big: bool


class PlainStep(NamedTuple):
    """A field of one little-endian signal whose scale and offset are its own: value / factor, clipped, rounded."""

    index: int
    factor: float
    raw_low: float
    raw_high: float
    mask: int
    shift: int


class Plan(NamedTuple):
    """A message made ready for encode and decode (bus/dbc/encode_plan.py)."""

    little: int  # constants, as an integer of the little-endian payload
    big: int
    simple: tuple[tuple[str, tuple[PlainStep, ...], tuple[WriteStep, ...]], ...]  # by group
    special: tuple[FieldMap, ...]  # sums and headings
    raws: Mapping[str, tuple[int, int, int, bool]]  # signal -> mask, shift, mask of the other bits, big-endian
    reads_little: tuple[ReadStep, ...]
    reads_big: tuple[ReadStep, ...]
    floats: tuple[SignalMap, ...]
    values: tuple[tuple[str, int, tuple[tuple[str, float], ...], float, float], ...]


@dataclass(frozen=True, eq=False, slots=True)
class MessageMap:
    """One message on one channel. Compared by identity: a codec has each once."""

    name: str
    can_id: int
    extended: bool
    fd: bool
    length: int
    kind: str  # COMMAND or TELEMETRY
    period_ticks: int
    timeout_ticks: int  # 0: none
    fields: tuple[FieldMap, ...]
    enable: str
    clear: str
    ignore: str
    counter: str
    checksum: str
    counter_modulus: int  # 0: no counter
    channel: str
    allow_truncated: bool
    bywire: tuple[str, ...]
    states: tuple[StateMap, ...]
    signals: Mapping[str, SignalMap] = field(repr=False)
    plan: Plan = field(repr=False)
    unproven_frames: int = 0  # first frames of an episode whose values are not used: 1 with end-to-end protection
    e2e: Protection | None = None  # bus/dbc/e2e.py
    e2e_max_delta: int = 1  # the widest step of a protected counter that still passes

    @property
    def key(self) -> int:
        """SocketCAN's can_id: the id, with the EFF bit where it is a 29-bit one."""
        return self.can_id | EXTENDED_FLAG if self.extended else self.can_id

    def fits(self, data: bytes) -> bool:
        """Whether a payload is long enough for Codec.decode."""
        return len(data) >= self.length or self.allow_truncated

    def read_raw(self, signal: str, data: bytes) -> int:
        """The bits of a signal as an unsigned integer; those beyond the end of a short payload are 0."""
        mask, shift, _, big_endian = self.plan.raws[signal]
        whole = data if len(data) == self.length else data[: self.length].ljust(self.length, b"\0")
        return int.from_bytes(whole, "big" if big_endian else "little") >> shift & mask
