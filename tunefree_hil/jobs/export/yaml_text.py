"""Parameters of ROS 2 nodes as YAML text."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from typing import Any

from tunefree_hil.jobs.export.number_text import format_number

HEAD = "/**:\n  ros__parameters:\n"


def render_parameters(parameters: Mapping[str, Any], comments: tuple[str, ...] = ()) -> str:
    """The parameter file of a node: numbers, flags, texts and nested mappings of them."""
    return "".join(f"# {line}\n" for line in comments) + HEAD + _render(parameters, 4)


def _render(parameters: Mapping[str, Any], indent: int) -> str:
    lines = []
    for name, value in parameters.items():
        if isinstance(value, Mapping):
            lines.append(f"{' ' * indent}{name}:\n{_render(value, indent + 2)}")
        else:
            lines.append(f"{' ' * indent}{name}: {format_scalar(value)}\n")
    return "".join(lines)


def format_scalar(value: float | bool | str) -> str:
    """A value as YAML text. A number has a point and no exponent: ROS 2 takes 1 for an integer and refuses it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    text = f"{Decimal(format_number(value)):f}"
    return text if "." in text else f"{text}.0"
