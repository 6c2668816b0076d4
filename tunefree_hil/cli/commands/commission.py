"""`commission`: the whole chain, unattended."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import AsJson, BenchBus, Bus, Plain
from tunefree_hil.cli.output import present


def commission(
    vehicle: Annotated[str, typer.Argument(help="vehicle folder or its name in dbc/")],
    bench: Annotated[
        Path | None, typer.Option(help="bench file with the roads; its verify model is the vehicle")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="folder of this commission; one that was cut off goes on")] = None,
    set_name: Annotated[str | None, typer.Option("--set", help="mrac, lateral or complete")] = None,
    trials: Annotated[int | None, typer.Option(min=1, help="of the search")] = None,
    kind: Annotated[str, typer.Option(help="of the learned plant")] = "hybrid",
    quota_s: Annotated[float, typer.Option(help="seconds wanted in each cell of the collection")] = 10.0,
    area_m: Annotated[float, typer.Option(help="side of the square that the collection stays in")] = 400.0,
    minutes: Annotated[float | None, typer.Option(help="of training")] = None,
    seed: Annotated[int, typer.Option(min=0, help="of noise, split, nets")] = 1,
    bus: Bus = "auto",
    bench_bus: BenchBus = "",
    backend: Annotated[str, typer.Option(help="of the search: batch or bus")] = "batch",
    top_mps: Annotated[float | None, typer.Option(help="the collection drives no faster than this")] = None,
    only: Annotated[
        str, typer.Option(help="this stage again, alone: collect, calibrate, learn, map, tune or verify")
    ] = "",
    start_at: Annotated[str, typer.Option("--from", metavar="STAGE", help="this stage again and all that follow")] = "",
    least_covered: Annotated[float, typer.Option(help="stops below this share of full cells")] = 0.8,
    most_error_m: Annotated[float, typer.Option(help="stops above this error after 10 s of free run")] = 15.0,
    most_outside: Annotated[float, typer.Option(help="stops above this share outside the valid region")] = 0.25,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """From an unknown vehicle to verified gains, unattended.

    collect, calibrate, learn, map, tune, verify, and a report. Cut off, the same command goes on.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.commission.commission import commission as run
        from tunefree_hil.jobs.commission.plan import Asked

        return run(
            Asked(vehicle, bench, out, set_name, trials, kind, quota_s, area_m, minutes, seed, bus, bench_bus, backend,
                  top_mps, only, start_at, least_covered, most_error_m, most_outside)
        )  # fmt: skip

    return present("commission", job, plain=plain, as_json=as_json, first=f"commission {vehicle}")
