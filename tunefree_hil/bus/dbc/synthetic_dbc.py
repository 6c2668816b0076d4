"""A DBC for data that never was on a bus: a message a record field, marked as invented in every comment.

A signal has SIGNAL_BITS bits and a step of STEP in SI (1e-6 m, m/s, rad ...), signed: half a step of error, and a range
of +-1.4e8, which holds map coordinates too. The four wheels share a CAN FD message, as vehicle.toml wants them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tunefree_hil.base.records import GROUPS, WHEEL_FIELDS

SIGNAL_BITS = 48
STEP = 1e-6
HIGHEST = STEP * (2 ** (SIGNAL_BITS - 1) - 1)
FIRST_IDS = {"command": 0x100, "report": 0x200, "ins": 0x300}
SENDERS = {"command": "CONTROLLER", "report": "CHASSIS", "ins": "INS"}
WHEELS = "wheel_speed_radps"
STATE, ENABLED, STATE_ID = "BYWIRE_STATE", "ENABLED", 0x400  # whether the vehicle obeyed
_UNITS = {
    "mps": "m/s",
    "mps2": "m/s^2",
    "rad": "rad",
    "radps": "rad/s",
    "frac": "1",
    "m": "m",
    "nm": "Nm",
    "gear": "code",
}


def message_name(field: str) -> str:
    """'report.speed_mps' -> 'REPORT_SPEED'; every wheel -> 'REPORT_WHEEL_SPEED'."""
    group, _, name = field.partition(".")
    return f"{group}_{_stem(WHEELS if name in WHEEL_FIELDS else name)}".upper()


def signal_name(field: str) -> str:
    """'report.speed_mps' -> 'SPEED'."""
    return _stem(field.partition(".")[2]).upper()


def _stem(name: str) -> str:
    return name.rpartition("_")[0] or name


def dbc_text(fields: Sequence[str], source: str, units: Mapping[str, str], enabled: str = "") -> str:
    """The DBC for these record fields. units: a comment on each field's column.

    enabled: a comment on the column for STATE, whether the vehicle obeyed; without it there is no such frame.
    """
    messages: dict[str, list[str]] = {}
    for field in fields:
        messages.setdefault(message_name(field), []).append(field)
    head = 'VERSION ""\n\nNS_ :\n\nBS_:\n\n' + f"BU_: {' '.join(SENDERS.values())}\n\n"
    body = "\n".join(_message(name, some) for name, some in messages.items())
    if enabled:
        body += f'\nBO_ {STATE_ID} {STATE}: 1 CHASSIS\n SG_ {ENABLED} : 0|1@1+ (1,0) [0|1] "" Vector__XXX\n'
    notice = "Invented by tunefree-hil log import: these data never were on a CAN bus. No vehicle sends such frames."
    comments = [f'CM_ "{_plain(notice)} Source: {_plain(source)}";']
    comments += [
        f'CM_ SG_ {_id(field)} {signal_name(field)} "Invented for {field}; {_plain(units[field])}";' for field in fields
    ]
    comments += [f'CM_ SG_ {STATE_ID} {ENABLED} "Invented; {_plain(enabled)}";'] if enabled else []
    return head + body + "\n" + "\n".join(comments) + "\n"


def _id(field: str) -> int:
    """From the field's place in its record, so that two imports of one kind have the same ids."""
    group, _, name = field.partition(".")
    place = GROUPS[group]._fields.index(WHEEL_FIELDS[0] if name in WHEEL_FIELDS else name)
    return FIRST_IDS[group] + place


def _message(name: str, fields: Sequence[str]) -> str:
    size = SIGNAL_BITS // 8 * len(fields)
    group = fields[0].partition(".")[0]
    lines = [f"BO_ {_id(fields[0])} {name}: {size} {SENDERS[group]}"]
    for place, field in enumerate(fields):
        unit = _UNITS[field.partition(".")[2].rpartition("_")[2]]
        layout = f"{place * SIGNAL_BITS}|{SIGNAL_BITS}@1- ({STEP:g},0) [0|0]"
        lines.append(f' SG_ {signal_name(field)} : {layout} "{unit}" Vector__XXX')
    return "\n".join(lines) + "\n"


def _plain(text: str) -> str:
    return " ".join(text.replace('"', "'").split())
