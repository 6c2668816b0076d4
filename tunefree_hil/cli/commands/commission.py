"""`commission`: the whole chain, unattended."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import AsJson, BenchBus, Bus, Plain, record_from
from tunefree_hil.cli.output import present


def commission(
    vehicle: Annotated[str, typer.Argument(help="vehicle folder or its name in dbc/")],
    bench: Annotated[
        Path | None, typer.Option(help="bench file with the scenarios; its verify model is the vehicle")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="folder of this commission; an unfinished one is resumed")] = None,
    set_name: Annotated[str | None, typer.Option("--set", help="mrac, lateral or complete")] = None,
    trials: Annotated[int | None, typer.Option(min=1, help="number of trials of the search")] = None,
    kind: Annotated[str, typer.Option(help="kind of the learned plant")] = "hybrid",
    quota_s: Annotated[float, typer.Option(help="seconds wanted in each cell of the collection")] = 10.0,
    area_m: Annotated[float, typer.Option(help="side of the square area of the collection")] = 400.0,
    minutes: Annotated[float | None, typer.Option(help="minutes of training")] = None,
    seed: Annotated[int, typer.Option(min=0, help="seed of noise, split and nets")] = 1,
    bus: Bus = "auto",
    bench_bus: BenchBus = "",
    backend: Annotated[str, typer.Option(help="what drives the trials: batch or bus")] = "batch",
    top_mps: Annotated[float | None, typer.Option(help="top speed of the collection")] = None,
    only: Annotated[
        str, typer.Option(help="restart this stage alone: collect, calibrate, learn, map, tune or verify")
    ] = "",
    start_at: Annotated[
        str, typer.Option("--from", metavar="STAGE", help="restart this stage and all that follow")
    ] = "",
    least_covered: Annotated[float, typer.Option(help="stop below this share of full cells")] = 0.8,
    most_error_m: Annotated[float, typer.Option(help="stop above this error after 10 s of free run")] = 15.0,
    most_outside: Annotated[float, typer.Option(help="stop above this share outside the valid region")] = 0.25,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """From an unknown vehicle to verified gains, unattended.

    The stages collect, calibrate, learn, map, tune, verify, and a report. The same command resumes an unfinished one.
    """
    arguments = locals()

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.commission.commission import commission as run
        from tunefree_hil.jobs.commission.plan import CommissionOptions

        return run(record_from(CommissionOptions, arguments))

    return present("commission", job, plain=plain, as_json=as_json, first=f"commission {vehicle}")
