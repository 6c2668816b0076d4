"""Commands that judge: grade a log, compare runs, explain a winner. Each imports its job when it is called."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import AsJson, Out, Plain, RunPath, Vehicle
from tunefree_hil.cli.output import present


class Align(StrEnum):
    """How a path and a log's coordinates are brought together."""

    auto = "auto"
    recorded = "recorded"
    start = "start"


def grade(
    log: Annotated[
        str, typer.Argument(metavar="LOG", help="a CAN log (candump, BLF, ASC, MF4, ROS bag), or a run folder")
    ],
    path: Annotated[
        str | None,
        typer.Option(help="reference: a scenario, or a CSV with x_m, y_m, speed_mps (and t_s); our logs know theirs"),
    ] = None,
    vehicle: Vehicle = None,
    align: Annotated[Align, typer.Option(help="path as recorded, or laid on the pose at the start")] = Align.auto,
    start_s: Annotated[float | None, typer.Option(help="where the reference begins, seconds into the log")] = None,
    weights: Annotated[
        str | None, typer.Option(help="weights of the score; default: a run's own, or `default`")
    ] = None,
    out: Out = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Grade any log against a reference path, or a whole run.

    The 42 metrics by aspect; what cannot be had is said. Works on the log of a real car. A run's drives are taken
    together.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.grade.run import grade_any as run

        return run(log, vehicle=vehicle, path=path, align=align.value, start_s=start_s, weights=weights, out=out)

    return present("grade", job, plain=plain, as_json=as_json)


def compare(
    runs: Annotated[
        list[str],
        typer.Argument(metavar="RUN RUN ...", help="run folders; RUN:NAME: a baseline of a tune or verify"),
    ],
    fail_if: Annotated[
        list[str] | None,
        typer.Option(help="METRIC [@SCENARIO] OP VALUE, such as 'lateral_err_peak > +5%', again for more"),
    ] = None,
    weights: Annotated[str | None, typer.Option(help="weights to judge by; default: the first run's")] = None,
    out: Out = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Show runs side by side, metric by metric.

    The first run is what the others are held against. Exit status 1 when a --fail-if holds.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.grade.compare import compare as run

        return run(runs, fail_if=fail_if or [], weights=weights, out=out)

    return present("compare", job, plain=plain, as_json=as_json)


def explain(
    run: RunPath,
    points: Annotated[int, typer.Option(min=3, max=101, help="points of each slice through the winner")] = 9,
    slices: Annotated[bool, typer.Option("--slices/--no-slices", help="drive slices through the winner")] = True,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Say why the winner of a tune wins.

    Score difference by metric and scenario, importance of the parameters, slices through the winner, box edges.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.tune.explain import explain as start

        return start(run, points=points, slices=slices)

    return present("explain", job, plain=plain, as_json=as_json)
