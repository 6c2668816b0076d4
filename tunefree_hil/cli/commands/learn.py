"""The command that trains a plant: learn."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import AsJson, Plain, record_from
from tunefree_hil.cli.output import present


class PlantKind(StrEnum):
    """Kind of the plant."""

    hybrid = "hybrid"
    lstm = "lstm"
    mlp = "mlp"
    rule_based = "rule_based"
    paper = "paper"


def learn(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="logs of one vehicle, in any format")],
    vehicle: Annotated[str, typer.Option(help="vehicle folder or its name in dbc/")],
    out: Annotated[Path, typer.Option(help="model folder to write; it must not be there yet")],
    kind: Annotated[PlantKind, typer.Option(help="hybrid: fitted physics with a small LSTM")] = PlantKind.hybrid,
    seed: Annotated[int, typer.Option(min=0, help="of the net, its batches, and the held-out parts")] = 1,
    minutes: Annotated[
        float | None, typer.Option(min=0.01, help="approximate training time on a free core; sets the number of steps")
    ] = None,
    physics: Annotated[
        Path | None, typer.Option(help="model folder of calibrate; default: calibrate now, into OUT-physics")
    ] = None,
    sample_spacing_s: Annotated[
        float, typer.Option("--sample-spacing", min=0.01, max=0.5, help="s between samples, kind paper")
    ] = 0.01,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Learn a vehicle from logs.

    Whole drives are held out for the evaluation. Run the same command again to continue after an interruption. Needs
    torch: pip install '.[learn]'; the model that it writes runs without.
    """
    arguments = locals()

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.learn.learn import learn as run
        from tunefree_hil.jobs.learn.options import LearnOptions

        return run(record_from(LearnOptions, arguments))

    return present("learn", job, plain=plain, as_json=as_json)
