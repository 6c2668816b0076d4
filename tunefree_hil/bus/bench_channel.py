"""Messages of the bench channel (docs/reference/bench_channel.md, dbc/bench.dbc): episodes, parameters and ticks.

A message is a NamedTuple; `encode` makes it a frame, `decode` makes a frame a message again, or None for other frames.
TICK and DONE pass in every tick, so `struct` packs the bytes; a test compares them with dbc/bench.dbc as
cantools reads it, so that `cantools monitor` shows the same values.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.records import CanFrame

TICK_ID, DONE_ID, STATUS_ID, EPISODE_ID, PARAM_ID, FAULT_ID, HELLO_ID = range(0x6E0, 0x6E7)
FIRST_OWN_INDEX = 16  # a user's controller numbers its own parameters from here on (docs/reference/controller.md)
LAST_INDEX = 255  # PARAM's index is one byte
HELLO_WORDS = (
    f"HELLO (id 0x{HELLO_ID:X}, role 2) when it starts and whenever the runner does: its name, then a line "
    f"'INDEX NAME' for each parameter of its own, from index {FIRST_OWN_INDEX} on, four bytes a frame "
    "(docs/how-to/own_controller.md)"
)
NOT_SCRIPTED = 255  # Fault.index of a fault that no bench file asked for
CHUNK_BYTES = 4
MAX_PARTS = 4095


class Role(IntEnum):
    """The sender's part in the bench."""

    RUNNER = 0  # conducts episodes
    ECU = 1  # the simulated vehicle; owns time in lockstep
    CONTROLLER = 2  # drives the vehicle
    TUNER = 3  # chooses parameters
    OBSERVER = 4  # only listens


class State(IntEnum):
    """What a role is doing; from the runner STOP and END are requests."""

    IDLE = 0  # waiting for an episode
    LOADING = 1  # loading the episode
    READY = 2  # the episode is loaded
    RUN = 3  # the episode begins, or runs
    FINISHED = 4  # the episode was driven to its end
    FAILED = 5  # the episode ended early; the error code says why
    STOP = 6  # the episode is to end now
    END = 7  # the process is to end


class ErrorCode(IntEnum):
    """Why an episode ended early, with a `sentence` on it. From 1000 on: a controller's own errors."""

    sentence: str

    def __new__(cls, value: int, sentence: str) -> ErrorCode:
        member = int.__new__(cls, value)
        member._value_ = value
        member.sentence = sentence
        return member

    NONE = 0, "no error"
    DIVERGED = 1, "the vehicle diverged: a value is not finite, or the heading error is above its limit"
    LEFT_LANE = 2, "the vehicle left its lane"
    NOT_ENABLED = 3, "the by-wire system did not enable, or left the enabled state"
    INS_MISSING = 4, "INS frames were missing for too long"
    CHASSIS_MISSING = 5, "chassis frames were missing for too long"
    OVERRIDE = 6, "the driver took over"
    BYWIRE_FAULT = 7, "a by-wire channel reported a fault"
    UNKNOWN_SCENARIO = 8, "no scenario file has the announced content hash"
    MISSING_COMMAND = 9, "the vehicle missed command frames of the controller"
    CONTROL_ERROR = 10, "the controller could not be built, or computed no command"
    STOPPED = 11, "the episode was stopped by request"
    FOREIGN_COMMAND = 12, "another node sends the vehicle's command ids"
    INTERNAL = 13, "a process failed; what it printed says why"
    NO_SOLUTION = 14, "the controller's optimiser found no plan for too long"
    CONTROLLER_OWN = 1000, "the controller's own error; what it printed says which"

    @classmethod
    def _missing_(cls, value: object) -> ErrorCode:
        """A controller's own numbers are all CONTROLLER_OWN. Raises BenchError for one that means nothing."""
        if isinstance(value, int) and value > cls.CONTROLLER_OWN:
            return cls.CONTROLLER_OWN
        raise BenchError(
            f"a STATUS says ERROR {value}, which has no meaning",
            code="unknown_error",
            hint=f"a controller's own errors start at {int(cls.CONTROLLER_OWN)} (docs/how-to/own_controller.md)",
        )


def error_text(number: int) -> str:
    """The name of an error, and its number where that is a controller's own."""
    error = ErrorCode(number)
    return error.name.lower() + (f" {number}" if number != error else "")


class Tick(NamedTuple):
    """The ECU opens tick k (lockstep)."""

    k: int


class Done(NamedTuple):
    """A phase (0 ECU, 1 controller) of tick k is complete; n_tx vehicle frames were sent, with this 16-bit digest."""

    k: int
    phase: int
    n_tx: int
    digest: int


class Status(NamedTuple):
    """role: Role, state: State, error_code: ErrorCode. RUN from the runner carries the lead in ms as `tick`."""

    role: int
    state: int
    error_code: int
    tick: int


class Episode(NamedTuple):
    """Load this: the first 6 bytes of the scenario's content hash, and the seed of the noise."""

    scenario: bytes
    seed: int


class Param(NamedTuple):
    """Parameter `index` of a set of `count`; the value is rounded to binary32 by encode."""

    index: int
    count: int
    value: float


class Fault(NamedTuple):
    """A fault began at `tick`. index: its number in the bench file's list, NOT_SCRIPTED for a fault outside it."""

    role: int
    index: int
    code: int
    tick: int


class Hello(NamedTuple):
    """Chunk `part` of `parts` of a role's announcement; see hello_messages."""

    role: int
    part: int
    parts: int
    text: bytes


_HELLO = struct.Struct("<BHB4s")

_BY_TYPE: dict[type, tuple[int, struct.Struct]] = {
    Tick: (TICK_ID, struct.Struct("<I")),
    Done: (DONE_ID, struct.Struct("<IBBH")),
    Status: (STATUS_ID, struct.Struct("<BBHI")),
    Episode: (EPISODE_ID, struct.Struct("<6sH")),
    Param: (PARAM_ID, struct.Struct("<BBf")),
    Fault: (FAULT_ID, struct.Struct("<BBHI")),
}
_BY_ID: dict[int, tuple[type, struct.Struct]] = {can_id: (kind, form) for kind, (can_id, form) in _BY_TYPE.items()}


def encode(message: Any, stamp_s: float = 0.0) -> CanFrame:
    """The frame of a bench message, stamped. Raises InputError when a value does not fit its place."""
    try:
        if isinstance(message, Hello):
            return CanFrame(HELLO_ID, _pack_hello(message), time_s=stamp_s)
        can_id, form = _BY_TYPE[type(message)]
        return CanFrame(can_id, form.pack(*message), False, False, stamp_s)
    except (struct.error, OverflowError) as error:
        raise InputError(
            f"{message!r} does not fit its frame: {error}",
            code="bench_value",
            hint="seeds are 0..65535, ticks 0..2^32 - 1, parameter values within binary32 (dbc/bench.dbc)",
        ) from error


def decode(frame: CanFrame) -> Any:
    """The message of a frame, or None when the frame is none of the bench channel's."""
    if frame.extended or frame.fd:
        return None
    if frame.id == HELLO_ID and len(frame.data) == _HELLO.size:
        return _unpack_hello(frame.data)
    entry = _BY_ID.get(frame.id)
    if entry is None or len(frame.data) != entry[1].size:
        return None
    kind, form = entry
    return kind(*form.unpack(frame.data))


def _pack_hello(hello: Hello) -> bytes:
    if not 0 <= hello.part < hello.parts <= MAX_PARTS:
        raise struct.error(f"part {hello.part} of {hello.parts}")
    places = hello.part | hello.parts << 12
    return _HELLO.pack(hello.role, places & 0xFFFF, places >> 16, hello.text)


def _unpack_hello(data: bytes) -> Hello | None:
    """None for a chunk that no text has."""
    role, low, high, text = _HELLO.unpack(data)
    places = low | high << 16
    part, parts = places & 0xFFF, places >> 12
    return Hello(role, part, parts, text) if part < parts else None


def hello_messages(role: int, name: str, parameters: Sequence[str] | Mapping[int, str] = ()) -> list[Hello]:
    """A node's announcement: its name, and its parameters beside the list of docs/reference/controller.md.

    parameters: names, numbered from FIRST_OWN_INDEX on, or {index: name}. Raises InputError when the text is too long.
    """
    numbered = parameters if isinstance(parameters, Mapping) else dict(enumerate(parameters, FIRST_OWN_INDEX))
    text = "\n".join([name, *(f"{index} {parameter}" for index, parameter in numbered.items())]).encode()
    parts = max(1, -(-len(text) // CHUNK_BYTES))
    if parts > MAX_PARTS:
        raise InputError(
            f"{name} announces {len(text)} bytes of names; HELLO carries {MAX_PARTS * CHUNK_BYTES}",
            code="hello_too_long",
            hint="give the parameters shorter names",
        )
    chunks = [text[i * CHUNK_BYTES : (i + 1) * CHUNK_BYTES] for i in range(parts)]
    return [Hello(int(role), i, parts, chunk.ljust(CHUNK_BYTES, b"\0")) for i, chunk in enumerate(chunks)]


def hello_frames(role: int, name: str, parameters: Sequence[str] | Mapping[int, str] = ()) -> list[CanFrame]:
    """`hello_messages` as frames."""
    return [encode(message) for message in hello_messages(role, name, parameters)]


class HelloCollector:
    """Puts the chunks of HELLO together, role by role. A new part 0 begins a role's text anew."""

    def __init__(self) -> None:
        self._chunks: dict[int, dict[int, bytes]] = {}
        self._parts: dict[int, int] = {}

    def add(self, hello: Hello) -> None:
        """Take in one chunk. A bus keeps the order of one sender, so part 0 comes first."""
        if hello.part == 0 or self._parts.get(hello.role) != hello.parts:
            self._chunks[hello.role] = {}
        self._parts[hello.role] = hello.parts
        self._chunks[hello.role][hello.part] = hello.text

    def complete(self, role: int) -> bool:
        """Whether a role's text has arrived completely."""
        return role in self._parts and len(self._chunks[role]) == self._parts[role]

    def name(self, role: int) -> str:
        """The name that a role announced; '' until its text is complete."""
        return self._lines(role)[0] if self.complete(role) else ""

    def parameters(self, role: int) -> dict[int, str]:
        """{index: name} of the parameters a role announced; empty until its text is complete.

        Raises InputError for a line that is not 'INDEX NAME' with an index in the range, or that is repeated.
        """
        announced: dict[int, str] = {}
        lines = self._lines(role)[1:] if self.complete(role) else []
        for line in filter(None, lines):  # a text may end with a line feed
            index, _, name = line.partition(" ")
            number = int(index) if index.isascii() and index.isdigit() else -1
            if not (FIRST_OWN_INDEX <= number <= LAST_INDEX and name.strip()):
                raise _bad_hello(role, line, f"is not 'INDEX NAME', index {FIRST_OWN_INDEX} to {LAST_INDEX}")
            if number in announced or name in announced.values():
                raise _bad_hello(role, line, "repeats an index or a name")
            announced[number] = name
        return announced

    def arrived(self, role: int) -> tuple[int, int]:
        """(chunks received, chunks in all) of a role's text; (0, 0) before the first."""
        return len(self._chunks.get(role, ())), self._parts.get(role, 0)

    def _lines(self, role: int) -> list[str]:
        chunks = self._chunks[role]
        text = b"".join(chunks[i] for i in sorted(chunks)).rstrip(b"\0")
        return text.decode(errors="backslashreplace").split("\n")


def _bad_hello(role: int, line: str, problem: str) -> InputError:
    name = Role(role).name.lower()
    return InputError(
        f"the {name}'s line {line!r} {problem}", code="bad_hello", key="HELLO", hint=f"it has to send {HELLO_WORDS}"
    )
