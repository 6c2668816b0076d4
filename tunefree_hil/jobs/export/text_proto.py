"""Protocol-buffer messages as text: fields in order, one a line, messages in braces."""

from __future__ import annotations

from collections.abc import Sequence

from tunefree_hil.jobs.export.number_text import format_number


class Message:
    """Fields in order; a repeated field stands once for each of its values."""

    def __init__(self, **fields: float | int | bool | Message | Sequence[float] | Sequence[Message]) -> None:
        self.fields: list[tuple[str, float | int | bool | Message]] = []
        for name, value in fields.items():
            if isinstance(value, Sequence):
                self.fields += [(name, one) for one in value]
            else:
                self.fields.append((name, value))


def render(message: Message, indent: int = 0) -> str:
    """The text of a message."""
    lines = []
    for name, value in message.fields:
        margin = " " * indent
        if isinstance(value, Message):
            lines.append(f"{margin}{name} {{\n{render(value, indent + 2)}{margin}}}\n")
        else:
            lines.append(f"{margin}{name}: {format_scalar(value)}\n")
    return "".join(lines)


def format_scalar(value: float | int | bool) -> str:
    """A number or a flag as text."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return str(value) if isinstance(value, int) else format_number(value)
