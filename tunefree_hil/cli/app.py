"""The commands of `tunefree-hil`. Their jobs are imported when they run, so that help is there at once."""

from __future__ import annotations

from typing import Annotated

import typer

from tunefree_hil import __version__
from tunefree_hil.cli import (
    bench_commands,
    calibrate_commands,
    collect_commands,
    commission_commands,
    data_commands,
    gap_commands,
    grade_commands,
    learn_commands,
    map_commands,
    run_commands,
)
from tunefree_hil.cli.overview import overview

app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)


@app.callback(invoke_without_command=True, help="A bench that tunes the controllers of a by-wire vehicle over CAN.")
def start(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="print the version", is_eager=True)] = False,
) -> None:
    """Without a command: the four jobs."""
    if version:
        print(f"tunefree-hil {__version__}")
        raise typer.Exit(0)
    if context.invoked_subcommand is None:
        print(overview())


for _command in (run_commands.drive, run_commands.tune, run_commands.verify, run_commands.replay):
    app.command()(_command)
for _command in (grade_commands.grade, grade_commands.compare, grade_commands.explain):
    app.command()(_command)
app.command()(collect_commands.collect)
app.command()(calibrate_commands.calibrate)
app.command()(learn_commands.learn)
app.command("map")(map_commands.map_logs)
app.command()(commission_commands.commission)
app.command()(gap_commands.gap)
for _command in (bench_commands.hub, bench_commands.ecu, bench_commands.controller, collect_commands.collector):
    app.command()(_command)
for _command in (data_commands.scenarios, data_commands.doctor):
    app.command()(_command)
app.add_typer(data_commands.log, name="log", help="Logs of CAN frames: check, show, plot, convert, import.")
