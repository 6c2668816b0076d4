"""The command `robustness`: the winner of a tune on a thousand fresh roads."""

from __future__ import annotations

from collections.abc import Iterable

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command
from tunefree_hil.jobs.robustness.options import RobustnessOptions


@command("robustness")
def robustness(options: RobustnessOptions) -> Iterable[Event]:
    """Drive the winner of a tune on many fresh roads.

    The manual sets drive the same roads, in the same cars. The result says how often each loses stability or misses a
    requirement, by family of roads and with intervals, and draws the worst drives. Exit status 1 if the winner fails on
    more roads than --allowed. Run the same command again to continue after an interruption. With --scheduler the
    workers of a dask cluster drive (pip install '.[cluster]').
    """
    yield Event("note", f"robustness {options.run}")
    from tunefree_hil.jobs.robustness.sweep import sweep_roads

    yield from sweep_roads(options)
