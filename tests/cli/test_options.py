"""A command has the options of the records and parameters of its function, and fills them."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import pytest
import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command, record_from
from tunefree_hil.jobs.options.option import Argument, Option


class PaintOptions(NamedTuple):
    path: Annotated[Path, Argument("what is painted")]
    colour: Annotated[str, Option("a colour", "--paint", choices=("red", "blue"))] = "blue"
    layers: Annotated[int | None, Option("how many", minimum=1, maximum=9, last=True)] = None
    names: Annotated[Sequence[str], Option("may be repeated", metavar="NAME")] = ()
    is_wet: Annotated[bool, Option("leave it wet")] = False
    can_dry: Annotated[bool | None, Option("let it dry")] = None


class Started(NamedTuple):
    options: PaintOptions
    places: Sequence[Path]
    speed_mps: float | None


started: list[Started] = []


@command("house paint")
def house_paint(
    options: PaintOptions,
    places: Annotated[Sequence[Path], Option("own option", "--at", "PLACE")] = (),
    speed_mps: Annotated[float | None, Option("another", minimum=0.5)] = None,
) -> Iterable[Event]:
    """Paint a house."""
    started.append(Started(options, places, speed_mps))
    yield Event("result", "", {"sentence": "painted"})


def run(words: str) -> Any:
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command()(house_paint)
    started.clear()
    return app(args=words.split(), standalone_mode=False)


def help_lines() -> list[str]:
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        run("--help")
    return [" ".join(line.split()) for line in out.getvalue().splitlines()]


def test_an_option_that_is_not_given_keeps_its_default() -> None:
    assert run("x --plain") == 0
    assert started == [Started(PaintOptions(Path("x")), (), None)]


def test_fields_and_own_parameters_are_filled() -> None:
    words = "x --paint red --layers 3 --names a --names b --is-wet --no-can-dry --at p --at q --speed-mps 2 --plain"
    assert run(words) == 0
    options = PaintOptions(Path("x"), "red", 3, ["a", "b"], True, False)
    assert started == [Started(options, [Path("p"), Path("q")], 2.0)]


@pytest.mark.parametrize(
    "words",
    ["", "x --paint green", "x --layers 0", "x --layers 10", "x --speed-mps 0.4", "x --no-is-wet", "x --colour red"],
)
def test_what_the_metadata_excludes_is_a_usage_mistake(words: str) -> None:
    with pytest.raises(typer.TyperException):
        run(words)
    assert not started


def test_help_has_texts_choices_limits_and_defaults() -> None:
    lines = help_lines()
    for line in (
        "Paint a house.",
        "path <path> what is painted [required]",
        "--paint <red|blue> a colour [default: blue]",
        "--layers <int range> how many [1<=x<=9]",
        "--names NAME may be repeated",
        "--is-wet leave it wet",
        "--can-dry / --no-can-dry let it dry",
        "--at PLACE own option",
        "--plain one line an event",
        "--json one JSON object on stdout, last",
    ):
        assert line in lines


def test_help_lists_fields_and_parameters_in_order_and_a_last_field_after_them() -> None:
    names = [line.split()[0] for line in help_lines() if line.startswith("--")]
    order = ["--paint", "--names", "--is-wet", "--can-dry", "--at", "--speed-mps", "--layers"]
    assert names == [*order, "--plain", "--json", "--help"]


def test_changes_replace_arguments_and_fill_other_fields() -> None:
    options = record_from(PaintOptions, {"path": Path("a"), "names": None, "plain": True}, path=Path("b"), layers=2)
    assert options == PaintOptions(Path("b"), layers=2)
