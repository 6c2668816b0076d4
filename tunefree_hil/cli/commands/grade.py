"""Commands that evaluate: grade a log, compare runs, explain a winner. Each imports its job when it is called."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command
from tunefree_hil.jobs.options.option import Argument
from tunefree_hil.jobs.options.records import CompareOptions, ExplainOptions, GradeOptions


@command("grade")
def grade(
    log: Annotated[str, Argument("a CAN log (candump, BLF, ASC, MF4, ROS bag), or a run folder", metavar="LOG")],
    options: GradeOptions,
) -> Iterable[Event]:
    """Grade any log against a reference path, or a whole run.

    The 42 metrics by aspect, as far as the log has the data; it may be the log of a real car. The drives of a run are
    graded together.
    """
    from tunefree_hil.jobs.grade.run import grade_any as start

    return start(log, options)


@command("compare")
def compare(options: CompareOptions) -> Iterable[Event]:
    """Compare runs, metric by metric.

    The others are compared with the first run. Exit status 1 if a --fail-if condition is true.
    """
    from tunefree_hil.jobs.grade.compare import compare as start

    return start(options)


@command("explain")
def explain(options: ExplainOptions) -> Iterable[Event]:
    """Explain why the winner of a tune wins.

    Score difference by metric and scenario, importance of the parameters, slices through the winner, edges of ranges.
    """
    from tunefree_hil.jobs.tune.explain import explain as start

    return start(options)
