"""`commission`: the whole chain, unattended."""

from __future__ import annotations

from collections.abc import Iterable

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command
from tunefree_hil.jobs.options.records import CommissionOptions


@command("commission")
def commission(options: CommissionOptions) -> Iterable[Event]:
    """From an unknown vehicle to verified gains, unattended.

    The stages collect, calibrate, learn, map, tune, verify, and a report. The same command resumes an unfinished one.
    """
    yield Event("note", f"commission {options.vehicle}")
    from tunefree_hil.jobs.commission.commission import commission as start

    yield from start(options)
