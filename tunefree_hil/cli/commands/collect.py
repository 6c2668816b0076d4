"""Commands of guided collection: collect, and the process of its planner, collector."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

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
)
from tunefree_hil.cli.output import present


def collect(
    bench: Annotated[Path | None, typer.Argument(help="bench file: its verify model is what is driven")] = None,
    vehicle: Vehicle = None,
    model: Model = None,
    bus: Bus = "auto",
    bench_bus: BenchBus = "",
    session: Session = "",
    out: Annotated[Path | None, typer.Option(help="folder of this collection; one that was cut off goes on")] = None,
    quota_s: Annotated[float, typer.Option(help="seconds wanted in each cell")] = 10.0,
    area_m: Annotated[float, typer.Option(help="side of the square that it stays in, about where it starts")] = 400.0,
    top_mps: Annotated[float | None, typer.Option(help="no faster than this; cells beyond are left out")] = None,
    drive_s: Annotated[float, typer.Option(help="a drive (a log) begins to stop after so long")] = 110.0,
    seed: Annotated[int, typer.Option(min=0, help="of the simulated sensors' noise")] = 1,
    realtime: Realtime = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="only listen while a person drives, and say what is missing")
    ] = False,
    seconds: Annotated[float | None, typer.Option(help="with --watch: for so long")] = None,
    from_logs: Annotated[
        list[Path] | None, typer.Option("--from", metavar="LOG", help="count this log, again for more; drive nothing")
    ] = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Drive what a model has to be learned from.

    Cell by cell of gear, steering, speed and pedals, inside the vehicle's limits and a bounded area, with steps and
    waves. Cut off, the same command goes on. The logs lie in the run folder's logs/.
    """

    def job() -> Iterable[Event]:
        if watch or from_logs:
            return _by_others(bench, vehicle, bus, session, quota_s, top_mps, seconds, out, from_logs)
        from tunefree_hil.jobs.collect.collect import collect as run
        from tunefree_hil.jobs.collect.plan import Asked

        wished = (bench, vehicle, model, bus, bench_bus, session, realtime, out, quota_s, area_m, top_mps, seed)
        return run(Asked(*wished, drive_s))

    words = "watch" if watch else str(bench or vehicle or "")
    return present("collect", job, plain=plain, as_json=as_json, first=f"collect {words}".strip())


def _by_others(
    bench: Path | None,
    vehicle: str | None,
    bus: str,
    session: str,
    quota_s: float,
    top_mps: float | None,
    seconds: float | None,
    out: Path | None,
    logs: list[Path] | None,
) -> Iterable[Event]:
    """Count what somebody else drives."""
    from tunefree_hil.jobs.collect.live_coverage import Wish, from_logs, watch

    if vehicle is None and bench is not None:
        from tunefree_hil.config.load import load_bench

        vehicle = load_bench(bench).vehicle
    if vehicle is None:
        raise InputError("whose frames are these?", code="usage", key="--vehicle", hint="--vehicle DIR")
    wish = Wish(vehicle, bus, session or DEFAULT_SESSION, quota_s, top_mps, seconds, out)
    return from_logs(logs, wish) if logs else watch(wish)


def collector(
    bench: Bench,
    bus: Bus = "auto",
    bench_bus: BenchBus = "",
    session: Session = DEFAULT_SESSION,
    realtime: Realtime = False,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Be the planner of a collection on the bus.

    Started by collect, whose drives it drives.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.collector import collector as run

        return run(bench, bus=bus, bench_bus=bench_bus, session=session, realtime=realtime)

    return present("collector", job, plain=plain, as_json=as_json, first=f"collector of {bench}")
