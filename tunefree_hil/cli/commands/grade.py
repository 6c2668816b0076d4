"""Commands that evaluate: grade a log, compare runs, explain a winner. Each imports its job when it is called."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import AsJson, Out, Plain, RunPath, Vehicle, record_from
from tunefree_hil.cli.output import present


class Align(StrEnum):
    """Alignment of the reference path with the coordinates of a log."""

    auto = "auto"
    recorded = "recorded"
    start = "start"


def grade(
    log: Annotated[
        str, typer.Argument(metavar="LOG", help="a CAN log (candump, BLF, ASC, MF4, ROS bag), or a run folder")
    ],
    path: Annotated[
        str | None,
        typer.Option(help="reference: a scenario, or a CSV with x_m, y_m, speed_mps (and t_s); our logs have theirs"),
    ] = None,
    vehicle: Vehicle = None,
    align: Annotated[Align, typer.Option(help="path as recorded, or moved to the pose at the start")] = Align.auto,
    start_s: Annotated[float | None, typer.Option(help="start of the reference, seconds into the log")] = None,
    weights: Annotated[
        str | None, typer.Option(help="weights of the score; default: those of the run, or `default`")
    ] = None,
    out: Out = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Grade any log against a reference path, or a whole run.

    The 42 metrics by aspect, as far as the log has the data; it may be the log of a real car. The drives of a run are
    graded together.
    """
    arguments = locals()

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.grade.grade import GradeOptions
        from tunefree_hil.jobs.grade.run import grade_any as run

        return run(log, record_from(GradeOptions, arguments))

    return present("grade", job, plain=plain, as_json=as_json)


def compare(
    runs: Annotated[
        list[str],
        typer.Argument(metavar="RUN RUN ...", help="run folders; RUN:NAME: a baseline of a tune or verify"),
    ],
    fail_if: Annotated[
        list[str] | None,
        typer.Option(help="METRIC [@SCENARIO] OP VALUE, such as 'lateral_err_peak > +5%'; may be repeated"),
    ] = None,
    weights: Annotated[str | None, typer.Option(help="weights of the score; default: those of the first run")] = None,
    out: Out = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Compare runs, metric by metric.

    The others are compared with the first run. Exit status 1 if a --fail-if condition is true.
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
    """Explain why the winner of a tune wins.

    Score difference by metric and scenario, importance of the parameters, slices through the winner, edges of ranges.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.tune.explain import explain as start

        return start(run, points=points, slices=slices)

    return present("explain", job, plain=plain, as_json=as_json)
