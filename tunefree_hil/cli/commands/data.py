"""Commands that inspect, and those for logs: scenarios, doctor, log check, show, plot, convert, import."""

from __future__ import annotations

from collections.abc import Iterable

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command
from tunefree_hil.jobs.log.options import (
    LogCheckOptions,
    LogConvertOptions,
    LogImportOptions,
    LogPlotOptions,
    LogShowOptions,
)
from tunefree_hil.jobs.options.records import DoctorOptions, ScenariosOptions

log = typer.Typer(rich_markup_mode=None, add_completion=False)


@command("scenarios")
def scenarios(options: ScenariosOptions) -> Iterable[Event]:
    """List the manoeuvres.

    With a vehicle also whether it can drive them. With --export the reference trajectories for another controller.
    With --roads the roads that a bench file's `roads` makes for the vehicle.
    """
    from tunefree_hil.jobs.scenarios import scenarios as start

    return start(options)


@command("doctor")
def doctor(options: DoctorOptions) -> Iterable[Event]:
    """Check the installation and say how to fix it.

    With an option also a vehicle folder or a bench file. Exit status 1 if an error was found.
    """
    from tunefree_hil.jobs.doctor import doctor as start

    return start(options)


@log.command("check")
@command("log check")
def log_check(options: LogCheckOptions) -> Iterable[Event]:
    """Count and check the frames of a log.

    Rates, gaps, counters, CRCs, frames that do not decode or are foreign. Exit status 1 if the log fails.
    """
    from tunefree_hil.jobs.log.check import check

    return check(options)


@log.command("show")
@command("log show")
def log_show(options: LogShowOptions) -> Iterable[Event]:
    """Print a decoded log, one line a frame."""
    from tunefree_hil.jobs.log.show import show

    return show(options)


@log.command("plot")
@command("log plot")
def log_plot(options: LogPlotOptions) -> Iterable[Event]:
    """Plot signals of a log over time, one panel for each unit."""
    from tunefree_hil.jobs.log.plot import plot

    return plot(options)


@log.command("convert")
@command("log convert")
def log_convert(options: LogConvertOptions) -> Iterable[Event]:
    """Write a log in another format.

    Counts what the format cannot store, and reads the result back to check it.
    """
    from tunefree_hil.jobs.log.convert import convert

    return convert(options)


@log.command("import")
@command("log import")
def log_import(options: LogImportOptions) -> Iterable[Event]:
    """Import a CSV of a test drive.

    Writes a candump log with a DBC made for it. Refuses unsorted times and inconsistent units.
    """
    from tunefree_hil.jobs.log.csv_import import import_csv

    return import_csv(options)
