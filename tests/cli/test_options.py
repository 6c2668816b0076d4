"""The record of a job's options is built from the arguments of its command."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.cli.options import record_from


class Colour(StrEnum):
    RED = "red"


class Options(NamedTuple):
    path: Path
    colour: str = "blue"
    names: tuple[str, ...] = ()
    session: str = ""


def test_arguments_become_fields_by_their_names() -> None:
    arguments = {"path": Path("a"), "colour": Colour.RED, "names": None, "plain": True}
    options = record_from(Options, arguments)
    assert options == Options(Path("a"), "red") and type(options.colour) is str


def test_changes_replace_arguments_and_fill_other_fields() -> None:
    assert record_from(Options, {"path": Path("a")}, path=Path("b"), session="s") == Options(Path("b"), session="s")
