"""Commands of guided collection: collect, and the process of its planner, collector."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command, record_from
from tunefree_hil.jobs.options.nodes import NodeLink
from tunefree_hil.jobs.options.option import DEFAULT_SESSION, BenchFile, Option
from tunefree_hil.jobs.options.records import CollectOptions


@command("collect")
def collect(
    options: CollectOptions,
    watch: Annotated[bool, Option("only listen while a person drives, and show what is missing")] = False,
    seconds: Annotated[float | None, Option("with --watch: how long")] = None,
    from_logs: Annotated[Sequence[Path], Option("only count this log; may be repeated", "--from", "LOG")] = (),
) -> Iterable[Event]:
    """Drive to collect the logs for learning a model.

    Cell by cell of gear, steering, speed and pedals, with steps and waves, within the limits of the vehicle and a
    bounded area. The same command resumes an unfinished collection. The logs are in logs/ of the run folder.
    """
    yield Event("note", f"collect {'watch' if watch else options.bench or options.vehicle or ''}".strip())
    if watch or from_logs:
        yield from _count_foreign_drives(options, seconds, from_logs)
        return
    from tunefree_hil.jobs.collect.collect import collect as start

    yield from start(options)


def _count_foreign_drives(options: CollectOptions, seconds: float | None, logs: Sequence[Path]) -> Iterable[Event]:
    """Count drives that another program or a person makes."""
    from tunefree_hil.jobs.collect.live_coverage import WatchOptions, count_logs, watch

    vehicle = options.vehicle
    if vehicle is None and options.bench is not None:
        from tunefree_hil.config.load import load_bench

        vehicle = load_bench(options.bench).vehicle
    if vehicle is None:
        raise InputError("the vehicle is not given", code="usage", key="--vehicle", hint="--vehicle DIR")
    changes = {"vehicle": vehicle, "session": options.session or DEFAULT_SESSION, "seconds": seconds}
    watched = record_from(WatchOptions, options._asdict(), **changes)
    return count_logs(logs, watched) if logs else watch(watched)


@command("collector")
def collector(bench: BenchFile, link: NodeLink) -> Iterable[Event]:
    """Run the planner of a collection on the bus.

    Started by collect.
    """
    yield Event("note", f"collector of {bench}")
    from tunefree_hil.jobs.collector import collector as start

    yield from start(bench, link)
