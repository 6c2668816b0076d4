"""Commands of guided collection: collect, and the process of its planner, collector."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import (
    DEFAULT_SESSION,
    AsJson,
    Bench,
    BenchBus,
    Bus,
    Model,
    Plain,
    Realtime,
    Session,
    Vehicle,
    record_from,
)
from tunefree_hil.cli.output import present


def collect(
    bench: Annotated[Path | None, typer.Argument(help="bench file; its verify model is driven")] = None,
    vehicle: Vehicle = None,
    model: Model = None,
    bus: Bus = "auto",
    bench_bus: BenchBus = "",
    session: Session = "",
    out: Annotated[Path | None, typer.Option(help="folder of this collection; an unfinished one is resumed")] = None,
    quota_s: Annotated[float, typer.Option(help="seconds wanted in each cell")] = 10.0,
    area_m: Annotated[float, typer.Option(help="side of the square area around the start")] = 400.0,
    top_mps: Annotated[float | None, typer.Option(help="top speed; faster cells are left out")] = None,
    drive_s: Annotated[float, typer.Option(help="time after which a drive (a log) stops")] = 110.0,
    seed: Annotated[int, typer.Option(min=0, help="seed of the simulated sensor noise")] = 1,
    realtime: Realtime = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="only listen while a person drives, and show what is missing")
    ] = False,
    seconds: Annotated[float | None, typer.Option(help="with --watch: how long")] = None,
    from_logs: Annotated[
        list[Path] | None, typer.Option("--from", metavar="LOG", help="only count this log; may be repeated")
    ] = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Drive to collect the logs for learning a model.

    Cell by cell of gear, steering, speed and pedals, with steps and waves, within the limits of the vehicle and a
    bounded area. The same command resumes an unfinished collection. The logs are in logs/ of the run folder.
    """
    arguments = locals()

    def job() -> Iterable[Event]:
        if watch or from_logs:
            return _count_foreign_drives(arguments)
        from tunefree_hil.jobs.collect.collect import collect as run
        from tunefree_hil.jobs.collect.plan import CollectOptions

        return run(record_from(CollectOptions, arguments))

    words = "watch" if watch else str(bench or vehicle or "")
    return present("collect", job, plain=plain, as_json=as_json, first=f"collect {words}".strip())


def _count_foreign_drives(arguments: Mapping[str, Any]) -> Iterable[Event]:
    """Count drives that another program or a person makes."""
    from tunefree_hil.jobs.collect.live_coverage import WatchOptions, count_logs, watch

    vehicle, bench, logs = arguments["vehicle"], arguments["bench"], arguments["from_logs"]
    if vehicle is None and bench is not None:
        from tunefree_hil.config.load import load_bench

        vehicle = load_bench(bench).vehicle
    if vehicle is None:
        raise InputError("the vehicle is not given", code="usage", key="--vehicle", hint="--vehicle DIR")
    session = arguments["session"] or DEFAULT_SESSION
    options = record_from(WatchOptions, arguments, vehicle=vehicle, session=session)
    return count_logs(logs, options) if logs else watch(options)


def collector(
    bench: Bench,
    bus: Bus = "auto",
    bench_bus: BenchBus = "",
    session: Session = DEFAULT_SESSION,
    realtime: Realtime = False,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Run the planner of a collection on the bus.

    Started by collect.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.collector import collector as run

        return run(bench, bus=bus, bench_bus=bench_bus, session=session, realtime=realtime)

    return present("collector", job, plain=plain, as_json=as_json, first=f"collector of {bench}")
