"""Commands that inspect, and those for logs: scenarios, doctor, log check, show, plot, convert, import."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command
from tunefree_hil.jobs.options.option import Argument, Bus, Option, Vehicle

log = typer.Typer(rich_markup_mode=None, add_completion=False)

LogPath = Annotated[Path, Argument("a log: candump, blf, asc, csv, mf4, ROS bag", metavar="LOG")]


@command("scenarios")
def scenarios(
    name: Annotated[str | None, Argument("show this scenario in full")] = None,
    vehicle: Vehicle = None,
    export: Annotated[Path | None, Option("write each reference trajectory as CSV into this folder")] = None,
    roads: Annotated[str | None, Option("make a set of roads instead: families:20, public229, ...")] = None,
    seed: Annotated[int, Option("with --roads: draws the roads", minimum=0)] = 1,
    out: Annotated[Path | None, Option("with --roads: write them and a figure into this folder")] = None,
) -> Iterable[Event]:
    """List the manoeuvres.

    With a vehicle also whether it can drive them. With --export the reference trajectories for another controller.
    With --roads the roads that a bench file's `roads` makes for the vehicle.
    """
    from tunefree_hil.jobs.scenarios import export_scenarios, make_roads
    from tunefree_hil.jobs.scenarios import scenarios as start

    if roads is not None:
        return make_roads(vehicle=vehicle, roads=roads, seed=seed, folder=out)
    if export is not None:
        return export_scenarios(vehicle=vehicle, name=name, folder=export)
    return start(vehicle=vehicle, name=name)


@command("doctor")
def doctor(
    vehicle: Annotated[Path | None, Option("check a vehicle folder; lists all errors")] = None,
    schema: Annotated[str | None, Option("print the JSON Schema of a file: vehicle, bench, ...")] = None,
    bus: Bus = "auto",
    bench: Annotated[Path | None, Option("check a bench file and all files that it names")] = None,
) -> Iterable[Event]:
    """Check the installation and say how to fix it.

    With an option also a vehicle folder or a bench file. Exit status 1 if an error was found.
    """
    arguments = locals()
    from tunefree_hil.jobs.doctor import doctor as start

    return start(**arguments)


@log.command("check")
@command("log check")
def log_check(path: LogPath, vehicle: Vehicle = None) -> Iterable[Event]:
    """Count and check the frames of a log.

    Rates, gaps, counters, CRCs, frames that do not decode or are foreign. Exit status 1 if the log fails.
    """
    arguments = locals()
    from tunefree_hil.jobs.log.check import check

    return check(**arguments)


@log.command("show")
@command("log show")
def log_show(
    path: LogPath,
    vehicle: Vehicle = None,
    signals: Annotated[Sequence[str], Option("only this signal or record field; may be repeated", "--signal")] = (),
) -> Iterable[Event]:
    """Print a decoded log, one line a frame."""
    arguments = locals()
    from tunefree_hil.jobs.log.show import show

    return show(**arguments)


@log.command("plot")
@command("log plot")
def log_plot(
    path: LogPath,
    signals: Annotated[Sequence[str], Argument("report.speed_mps, MESSAGE.SIGNAL ...", metavar="SIGNALS...")],
    vehicle: Vehicle = None,
    out: Annotated[Path | None, Option("PNG to write; default: the log's name with .png")] = None,
) -> Iterable[Event]:
    """Plot signals of a log over time, one panel for each unit."""
    arguments = locals()
    from tunefree_hil.jobs.log.plot import plot

    return plot(**arguments)


@log.command("convert")
@command("log convert")
def log_convert(
    source: LogPath,
    target: Annotated[Path, Argument("ends in .log .blf .asc .csv .mf4 .bag or .ros2", metavar="OUT")],
    channels: Annotated[Sequence[str], Option("only this channel; may be repeated", "--channel")] = (),
    to: Annotated[str, Option("candump, blf, asc, csv, mf4, ros1 or ros2", "--format")] = "",
) -> Iterable[Event]:
    """Write a log in another format.

    Counts what the format cannot store, and reads the result back to check it.
    """
    arguments = locals()
    from tunefree_hil.jobs.log.convert import convert

    return convert(**arguments)


@log.command("import")
@command("log import")
def log_import(
    path: Annotated[Path, Argument("a test drive: a header line, one row a sample", metavar="CSV")],
    mapping: Annotated[Path, Option("mapping file: column -> record field, unit, clock", "--map")],
    out: Annotated[Path, Option("folder to write: drive.log and the vehicle folder to read it with")],
) -> Iterable[Event]:
    """Import a CSV of a test drive.

    Writes a candump log with a DBC made for it. Refuses unsorted times and inconsistent units.
    """
    arguments = locals()
    from tunefree_hil.jobs.log.csv_import import import_csv

    return import_csv(**arguments)
