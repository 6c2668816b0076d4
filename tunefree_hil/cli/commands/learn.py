"""The command that trains a plant: learn."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import AsJson, Plain
from tunefree_hil.cli.output import present


class Kind(StrEnum):
    """What is learned."""

    hybrid = "hybrid"
    lstm = "lstm"
    mlp = "mlp"
    rule_based = "rule_based"
    paper = "paper"


def learn(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="logs of one vehicle, in any format")],
    vehicle: Annotated[str, typer.Option(help="vehicle folder or its name in dbc/")],
    out: Annotated[Path, typer.Option(help="model folder to write; it must not be there yet")],
    kind: Annotated[Kind, typer.Option(help="hybrid: fitted physics with a small LSTM")] = Kind.hybrid,
    seed: Annotated[int, typer.Option(min=0, help="of the net, its batches, and what is held out")] = 1,
    minutes: Annotated[
        float | None, typer.Option(min=0.01, help="about so long on a quiet core; sets the number of steps")
    ] = None,
    physics: Annotated[
        Path | None, typer.Option(help="what calibrate wrote; default: calibrated now, OUT-physics")
    ] = None,
    sample_spacing: Annotated[float, typer.Option(min=0.01, max=0.5, help="s between samples, kind paper")] = 0.01,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Learn a vehicle from logs.

    Whole drives are held out to judge by. Cut off, the same command goes on where it was. Needs torch: pip install
    '.[learn]'; what it writes runs without.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.learn.learn import Asked
        from tunefree_hil.jobs.learn.learn import learn as run

        return run(Asked(logs, vehicle, out, kind.value, seed, minutes, physics, sample_spacing))

    return present("learn", job, plain=plain, as_json=as_json)
