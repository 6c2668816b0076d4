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
    only: Annotated[str, typer.Option(help="this stage again: collect, calibrate, learn, map, tune or verify")] = "",
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """From an unknown vehicle to verified gains, unattended.

    collect, calibrate, learn, map, tune, verify, and a report. Cut off, the same command goes on.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.base.errors import InputError
        from tunefree_hil.jobs.commission import NAMES
        from tunefree_hil.jobs.commission import commission as run
        from tunefree_hil.jobs.commission_plan import Asked

        for key, value, known in (("--only", only, ("", *NAMES)), ("--backend", backend, ("batch", "bus"))):
            if value not in known:
                hint = ", ".join(one for one in known if one)
                raise InputError(f"no {value!r}", code="usage", key=key, hint=hint)
        return run(
            Asked(vehicle, bench, out, set_name, trials, kind, quota_s, area_m, minutes, seed, bus, bench_bus, backend,
                  only)
        )  # fmt: skip

    return present("commission", job, plain=plain, as_json=as_json, first=f"commission {vehicle}")
