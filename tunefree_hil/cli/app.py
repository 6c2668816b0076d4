"""The commands of `tunefree-hil`. Their jobs are imported when they run, so that --help is fast."""

from __future__ import annotations

from typing import Annotated

import typer

from tunefree_hil import __version__
from tunefree_hil.cli.commands import (
    bench,
    calibrate,
    collect,
    commission,
    data,
    export,
    gap,
    grade,
    learn,
    map,
    robustness,
    run,
    weights,
)
from tunefree_hil.cli.overview import overview

app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)


@app.callback(invoke_without_command=True, help="A bench that tunes the controllers of a by-wire vehicle over CAN.")
def start(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="print the version", is_eager=True)] = False,
) -> None:
    """Without a command: an overview."""
    if version:
        print(f"tunefree-hil {__version__}")
        raise typer.Exit(0)
    if context.invoked_subcommand is None:
        print(overview())


for _command in (run.drive, run.tune, run.verify, run.replay):
    app.command()(_command)
for _command in (grade.grade, grade.compare, grade.explain):
    app.command()(_command)
app.command()(robustness.robustness)
app.command()(collect.collect)
app.command()(calibrate.calibrate)
app.command()(learn.learn)
app.command("map")(map.map_logs)
app.command()(commission.commission)
app.command()(gap.gap)
app.command()(export.export)
app.command()(weights.weights)
for _command in (bench.hub, bench.ecu, bench.controller, collect.collector):
    app.command()(_command)
for _command in (data.scenarios, data.doctor):
    app.command()(_command)
app.add_typer(data.log, name="log", help="Logs of CAN frames: check, show, plot, convert, import.")
