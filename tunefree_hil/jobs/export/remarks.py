"""What an export could not carry over, and how the target will differ: records first, the page made of them last."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from typing import Any, NamedTuple

from tunefree_hil.jobs.export.number_text import format_number


class RemarkKind(Enum):
    """The sections of not_exported.md, with their headings."""

    DIFFERS = "The target will behave differently"
    NOT_EXPORTED = "Without a counterpart"
    ASSUMED = "Not from the bench: values that the files need"


class Remark(NamedTuple):
    """subject: a parameter, a constant, or a part of the controller."""

    kind: RemarkKind
    subject: str
    text: str


class ExportFile(NamedTuple):
    """A file of the export; name: its path inside the folder."""

    name: str
    text: str


class PartExport(NamedTuple):
    """The content of one file for a part of the controller, the parameters that stand in it, and remarks.

    content: a text proto message (None: no file) or a mapping of keys ({}: no file).
    """

    content: Any
    names: tuple[str, ...]
    remarks: list[Remark]


class Export(NamedTuple):
    """Files and remarks of one target. exported: parameters that stand in a file."""

    files: list[ExportFile]
    remarks: list[Remark]
    exported: frozenset[str]


def remark_on_rest(values: Mapping[str, float], exported: Iterable[str], remarks: Iterable[Remark]) -> list[Remark]:
    """A remark for every parameter that is in no file and in no remark yet."""
    known = {*exported, *(remark.subject for remark in remarks)}
    return [
        Remark(
            RemarkKind.NOT_EXPORTED,
            name,
            f"{format_number(value)}; the target has no such parameter, or its part is off",
        )
        for name, value in values.items()
        if name not in known
    ]


def page(title: str, lines: Sequence[str], remarks: Sequence[Remark]) -> str:
    """not_exported.md."""
    text = [f"# {title}", "", *lines]
    for kind in RemarkKind:
        rows = [remark for remark in remarks if remark.kind is kind]
        if rows:
            text += ["", f"## {kind.value}", "", *(f"- **{row.subject}**: {row.text}" for row in rows)]
    return "\n".join(text) + "\n"
