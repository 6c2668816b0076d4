"""The one bus that every car of the exam has: messages, signals, the DBC and what vehicle.toml says of them.

All cars share it, so that nothing but numbers tells one from another.
"""

from __future__ import annotations

import math
from typing import NamedTuple

DEG = math.pi / 180.0


class Signal(NamedTuple):
    """start, bits: Intel byte order. row: of a drive's reports ('r'), commands ('c'), or a constant ('='), else ''."""

    name: str
    start: int
    bits: int
    signed: bool
    factor: float
    unit: str
    source: str
    row: float
    to_si: float = 1.0  # SI value = physical value * to_si
    field: str = ""  # of vehicle.toml


class Message(NamedTuple):
    """One message; offset_ms: how long after the tick it goes out."""

    can_id: int
    name: str
    period_ms: int
    offset_ms: float
    sender: str
    signals: tuple[Signal, ...]


PEDAL, ANGLE = 5e-5, 0.05
COUNT = Signal("COUNT", 56, 8, False, 1.0, "", "n", 0)
EN = Signal("EN", 48, 1, False, 1.0, "", "=", 1)
ENABLED = Signal("ENABLED", 48, 1, False, 1.0, "", "=", 1)
IN_GEAR = 4  # forward


def _duty(name: str, start: int, source: str, row: int, field: str) -> Signal:
    return Signal(name, start, 16, False, PEDAL, "", source, row, 1.0, field)


def _angle(name: str, start: int, source: str, row: int, field: str) -> Signal:
    return Signal(name, start, 16, True, ANGLE, "deg", source, row, DEG, field)


def _wide(name: str, start: int, factor: float, unit: str, row: int, field: str, to_si: float = 1.0) -> Signal:
    return Signal(name, start, 16, True, factor, unit, "r", row, to_si, field)


WHEELS = ("FRONT_LEFT", "FRONT_RIGHT", "REAR_LEFT", "REAR_RIGHT")
MESSAGES: tuple[Message, ...] = (
    Message(0x210, "THROTTLE_STATE", 20, 0.20, "UNIT", (
        _duty("ECHO", 0, "p", 0, "report.throttle_command_frac"), _duty("OUT", 16, "p", 1, "report.throttle_frac"),
        ENABLED)),
    Message(0x211, "BRAKE_STATE", 20, 0.33, "UNIT", (
        _duty("ECHO", 0, "p", 2, "report.brake_command_frac"), _duty("OUT", 16, "p", 3, "report.brake_frac"), ENABLED)),
    Message(0x212, "STEER_STATE", 10, 0.46, "UNIT", (
        _angle("ECHO", 0, "r", 4, "report.steer_command_rad"), _angle("ANGLE", 16, "r", 5, "report.steer_rad"),
        Signal("SPEED", 32, 16, False, 0.01, "km/h", "r", 6, 1 / 3.6, "report.speed_mps"), ENABLED)),
    Message(0x213, "WHEELS", 10, 0.59, "UNIT", tuple(
        _wide(name, 16 * i, 0.01, "rad/s", 7 + i, "report.wheel_speed_radps") for i, name in enumerate(WHEELS))),
    Message(0x214, "INERTIA", 10, 0.72, "UNIT", (
        _wide("LONG", 0, 0.005, "m/s^2", 11, "report.accel_mps2"),
        _wide("LAT", 16, 0.005, "m/s^2", 12, "report.lateral_accel_mps2"),
        _wide("YAW", 32, 0.0002, "rad/s", 13, "report.yaw_rate_radps"))),
    Message(0x215, "GEAR_STATE", 100, 0.85, "UNIT", (
        Signal("STATE", 0, 3, False, 1.0, "", "=", IN_GEAR, 1.0, "report.gear"),)),
    Message(0x310, "INS_PLACE", 10, 0.98, "INS", (
        Signal("EAST", 0, 32, True, 0.001, "m", "r", 14, 1.0, "ins.x_m"),
        Signal("NORTH", 32, 32, True, 0.001, "m", "r", 15, 1.0, "ins.y_m"))),
    Message(0x311, "INS_MOTION", 10, 1.11, "INS", (
        _wide("HEADING", 0, 0.01, "deg", 16, "ins.heading_rad", DEG),
        _wide("SPEED", 16, 0.005, "m/s", 17, "ins.speed_mps"),
        _wide("ACCEL", 32, 0.005, "m/s^2", 18, "ins.accel_mps2"),
        _wide("YAW_RATE", 48, 0.01, "deg/s", 19, "ins.yaw_rate_radps", DEG))),
    Message(0x110, "THROTTLE_DEMAND", 10, 1.50, "HOST", (_duty("DUTY", 0, "d", 0, "command.throttle_frac"), EN, COUNT)),
    Message(0x111, "BRAKE_DEMAND", 10, 1.63, "HOST", (_duty("DUTY", 0, "d", 1, "command.brake_frac"), EN, COUNT)),
    Message(0x112, "STEER_DEMAND", 10, 1.76, "HOST", (_angle("ANGLE", 0, "c", 2, "command.steer_rad"), EN, COUNT)),
    Message(0x113, "GEAR_DEMAND", 100, 1.89, "HOST", (
        Signal("GEAR", 0, 3, False, 1.0, "", "=", IN_GEAR, 1.0, "command.gear"),)),
)  # fmt: skip
ABSENT = ("report.throttle_input_frac", "report.brake_input_frac")


def dbc() -> str:
    """The DBC's text: names, layout and periods, no comments."""
    lines = ['VERSION ""', "", "NS_ :", "", "BS_:", "", "BU_: HOST UNIT INS", ""]
    for message in MESSAGES:
        lines.append(f"BO_ {message.can_id} {message.name}: 8 {message.sender}")
        to = "UNIT" if message.sender == "HOST" else "HOST"
        for one in message.signals:
            low, high = bounds(one)
            sign = "-" if one.signed else "+"
            span = f"[{low:.10g}|{high:.10g}]"
            lines.append(
                f' SG_ {one.name} : {one.start}|{one.bits}@1{sign} ({one.factor:.10g},0) {span} "{one.unit}" {to}'
            )
        lines.append("")
    lines += ['BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;', 'BA_DEF_DEF_ "GenMsgCycleTime" 0;']
    lines += [f'BA_ "GenMsgCycleTime" BO_ {message.can_id} {message.period_ms};' for message in MESSAGES]
    return "\n".join(lines) + "\n"


def bounds(one: Signal) -> tuple[float, float]:
    """The least and the greatest physical value that fit."""
    if one.signed:
        return -(2 ** (one.bits - 1)) * one.factor, (2 ** (one.bits - 1) - 1) * one.factor
    return 0.0, (2**one.bits - 1) * one.factor


def fields() -> dict[str, tuple[Message, list[Signal]]]:
    """Field of vehicle.toml -> its message and signals."""
    found: dict[str, tuple[Message, list[Signal]]] = {}
    for message in MESSAGES:
        for one in message.signals:
            if one.field:
                found.setdefault(one.field, (message, []))[1].append(one)
    return found
