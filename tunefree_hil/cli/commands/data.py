"""Commands that inspect, and those for logs: scenarios, doctor, log check, show, plot, convert, import."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import AsJson, Bus, Plain, Vehicle
from tunefree_hil.cli.output import present

log = typer.Typer(rich_markup_mode=None, add_completion=False)

LogPath = Annotated[Path, typer.Argument(metavar="LOG", help="a log: candump, blf, asc, csv, mf4, ROS bag")]


def scenarios(
    name: Annotated[str | None, typer.Argument(help="show this scenario in full")] = None,
    vehicle: Vehicle = None,
    export: Annotated[Path | None, typer.Option(help="write each reference trajectory as CSV into this folder")] = None,
    roads: Annotated[str | None, typer.Option(help="make a set of roads instead: families:20, public229, ...")] = None,
    seed: Annotated[int, typer.Option(min=0, help="with --roads: draws the roads")] = 1,
    out: Annotated[Path | None, typer.Option(help="with --roads: write them and a figure into this folder")] = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """List the manoeuvres.

    With a vehicle also whether it can drive them. With --export the reference trajectories for another controller.
    With --roads the roads that a bench file's `roads` makes for the vehicle.
    """

    def job() -> Iterable[Event]:
        if roads is not None:
            from tunefree_hil.jobs.scenarios import make_roads

            return make_roads(vehicle=vehicle, roads=roads, seed=seed, folder=out)
        if export is not None:
            from tunefree_hil.jobs.scenarios import export_scenarios as write

            return write(vehicle=vehicle, name=name, folder=export)
        from tunefree_hil.jobs.scenarios import scenarios as run

        return run(vehicle=vehicle, name=name)

    return present("scenarios", job, plain=plain, as_json=as_json)


def doctor(
    vehicle: Annotated[Path | None, typer.Option(help="check a vehicle folder; lists all errors")] = None,
    schema: Annotated[str | None, typer.Option(help="print the JSON Schema of a file: vehicle, bench, ...")] = None,
    bus: Bus = "auto",
    bench: Annotated[Path | None, typer.Option(help="check a bench file and all files that it names")] = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Check the installation and say how to fix it.

    With an option also a vehicle folder or a bench file. Exit status 1 if an error was found.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.doctor import doctor as run

        return run(vehicle=vehicle, schema=schema, bus=bus, bench=bench)

    return present("doctor", job, plain=plain, as_json=as_json)


@log.command("check")
def log_check(path: LogPath, vehicle: Vehicle = None, plain: Plain = False, as_json: AsJson = False) -> int:
    """Count and check the frames of a log.

    Rates, gaps, counters, CRCs, frames that do not decode or are foreign. Exit status 1 if the log fails.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.log.check import check

        return check(path, vehicle)

    return present("log check", job, plain=plain, as_json=as_json)


@log.command("show")
def log_show(
    path: LogPath,
    vehicle: Vehicle = None,
    signal: Annotated[list[str] | None, typer.Option(help="only this signal or record field; may be repeated")] = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Print a decoded log, one line a frame."""

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.log.show import show

        return show(path, vehicle, signal or [])

    return present("log show", job, plain=plain, as_json=as_json)


@log.command("plot")
def log_plot(
    path: LogPath,
    signals: Annotated[list[str], typer.Argument(metavar="SIGNALS...", help="report.speed_mps, MESSAGE.SIGNAL ...")],
    vehicle: Vehicle = None,
    out: Annotated[Path | None, typer.Option(help="PNG to write; default: the log's name with .png")] = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Plot signals of a log over time, one panel for each unit."""

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.log.plot import plot

        return plot(path, vehicle, signals, out)

    return present("log plot", job, plain=plain, as_json=as_json)


@log.command("convert")
def log_convert(
    path: LogPath,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="ends in .log .blf .asc .csv .mf4 .bag or .ros2")],
    channel: Annotated[list[str] | None, typer.Option(help="only this channel; may be repeated")] = None,
    to: Annotated[str, typer.Option("--format", help="candump, blf, asc, csv, mf4, ros1 or ros2")] = "",
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Write a log in another format.

    Counts what the format cannot store, and reads the result back to check it.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.log.convert import convert

        return convert(path, out, channels=channel or [], to=to)

    return present("log convert", job, plain=plain, as_json=as_json)


@log.command("import")
def log_import(
    path: Annotated[Path, typer.Argument(metavar="CSV", help="a test drive: a header line, one row a sample")],
    mapping: Annotated[Path, typer.Option("--map", help="mapping file: column -> record field, unit, clock")],
    out: Annotated[Path, typer.Option(help="folder to write: drive.log and the vehicle folder to read it with")],
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Import a CSV of a test drive.

    Writes a candump log with a DBC made for it. Refuses unsorted times and inconsistent units.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.log.csv_import import import_csv

        return import_csv(path, mapping, out)

    return present("log import", job, plain=plain, as_json=as_json)
