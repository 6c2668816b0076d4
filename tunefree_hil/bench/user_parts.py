"""A controller of the user in a bench file: parts in Python, and parameters beyond docs/reference/controller.md."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench.load import Bench
from tunefree_hil.control.build import PartNames, own_values
from tunefree_hil.control.parameters import BY_NAME, middle_of


def own_parameters(bench: Bench) -> dict[str, float]:
    """Parameters of the user's own controller: the bench file's value, else the middle of the search box.

    Of a program, those in the bench file; of parts in Python all, with their own values where the file has none.
    """
    given = {name: value for name, value in bench.spec.controller.parameters.items() if name not in BY_NAME}
    searched = [one for one in bench.spec.tune.parameters if one.name not in BY_NAME and one.name not in given]
    named = given | {one.name: middle_of(one) for one in searched}
    if bench.spec.controller.command:
        return named
    parts = part_values(bench)
    _require_of_parts(bench, list(named), list(parts))
    return parts | named


def part_names(bench: Bench) -> PartNames:
    """The controller parts; a user's file ('mine.py:CONTROLLER') is looked for beside the bench file first."""
    controller = bench.spec.controller
    return PartNames(
        *(_find_file(bench, name) for name in (controller.lateral, controller.longitudinal, controller.inner))
    )


def _find_file(bench: Bench, name: str) -> str:
    path, colon, export = name.rpartition(":")
    for folder in (Path(bench.file).parent, Path()):
        if colon and (folder / path).is_file():
            return f"{(folder / path).resolve()}:{export}"
    return name


def part_values(bench: Bench) -> dict[str, float]:
    """Parameters of the parts beyond docs/reference/controller.md (control/build.py). InputError names file and key."""
    try:
        return own_values(part_names(bench))
    except InputError as error:
        error.file = bench.file
        raise


def _require_of_parts(bench: Bench, named: Sequence[str], own_names: Sequence[str]) -> None:
    """Raise InputError for a parameter that no part has, where there are parts of the user."""
    unknown = [name for name in named if name not in own_names]
    if unknown and any(":" in part for part in part_names(bench)):
        raise InputError(
            f"the controller's parts have no parameter {', '.join(unknown)}",
            code="unknown_parameter",
            file=bench.file,
            key=f"controller.parameters.{unknown[0]}",
            hint=f"their own are {', '.join(own_names) or 'none'}: the `tunables` of a part say them",
        )
