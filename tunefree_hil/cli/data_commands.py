"""Commands that look: scenarios, doctor, log check, log show."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import AsJson, Bus, Plain, Vehicle
from tunefree_hil.cli.output import present

log = typer.Typer(rich_markup_mode=None, add_completion=False)

LogPath = Annotated[Path, typer.Argument(metavar="LOG", help="candump text, such as vehicle.log of an episode")]


def scenarios(
    name: Annotated[str | None, typer.Argument(help="show this one in full")] = None,
    vehicle: Vehicle = None,
    export: Annotated[Path | None, typer.Option(help="write each reference drive as CSV into this folder")] = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """List the manoeuvres.

    With a vehicle also whether it can drive them. With --export, what a controller of your own needs to follow them.
    """

    def job() -> Iterable[Event]:
        if export is not None:
            from tunefree_hil.jobs.scenarios import export as write

            return write(vehicle=vehicle, name=name, folder=export)
        from tunefree_hil.jobs.scenarios import scenarios as run

        return run(vehicle=vehicle, name=name)

    return present("scenarios", job, plain=plain, as_json=as_json)


def doctor(
    vehicle: Annotated[Path | None, typer.Option(help="check a vehicle folder: all that is wrong, at once")] = None,
    schema: Annotated[str | None, typer.Option(help="print the JSON Schema of a file: vehicle, bench, ...")] = None,
    bus: Bus = "auto",
    bench: Annotated[Path | None, typer.Option(help="check a bench file and all it names")] = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Say what is wrong here and how to mend it.

    The machine, and with an option a vehicle folder or a bench file. Exit status 1 when a fault was found.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.doctor import doctor as run

        return run(vehicle=vehicle, schema=schema, bus=bus, bench=bench)

    return present("doctor", job, plain=plain, as_json=as_json)


@log.command("check")
def log_check(path: LogPath, vehicle: Vehicle = None, plain: Plain = False, as_json: AsJson = False) -> int:
    """Count and judge the frames of a log.

    Known, foreign, late, missing, broken. Exit status 1 when the log does not hold.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.log import check

        return check(path, vehicle)

    return present("log check", job, plain=plain, as_json=as_json)


@log.command("show")
def log_show(
    path: LogPath,
    vehicle: Vehicle = None,
    signal: Annotated[list[str] | None, typer.Option(help="only this signal or record field, again for more")] = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Print a log decoded, one line a frame."""

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.log import show

        return show(path, vehicle, signal or [])

    return present("log show", job, plain=plain, as_json=as_json)
