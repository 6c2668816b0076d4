"""The options of `weights`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NamedTuple

from tunefree_hil.jobs.options.option import Argument, Option

DEFAULT_ROADS = 15
DEFAULT_SETS = 12


class WeightsOptions(NamedTuple):
    """Options of `weights`. At least one of pairs and bench.

    Attributes:
        pairs: File of pairs, '' for none.
        bench: Bench whose vehicle the driver model and sets of gains drive; None for none.
        model: Model that stands for the vehicle; None for the bench's verify model.
        margin: eps of eq. 10; None for that of the criteria.
    """

    out: Annotated[Path, Option("weights file to write, such as weights/my.toml; drives are kept beside it")]
    pairs: Annotated[Path | None, Argument("file of pairs of human and generated drives", metavar="PAIRS")] = None
    bench: Annotated[Path | None, Option("drive pairs: a driver model and sets of gains on this bench's vehicle")] = (
        None
    )
    model: Annotated[str | None, Option("with --bench: model that is driven; default: its verify model")] = None
    roads: Annotated[int, Option("with --bench: number of made roads", minimum=1)] = DEFAULT_ROADS
    sets: Annotated[int, Option("with --bench: random sets of gains, beside the manual ones", minimum=0)] = DEFAULT_SETS
    seed: Annotated[int, Option("of roads, random sets and folds", minimum=0)] = 1
    base: Annotated[str, Option("weights to start from: metrics, rules and the sum of the weights")] = "default"
    margin: Annotated[
        float | None, Option("by how much the human's score should be lower; default: 0.05", minimum=0.0)
    ] = None
    force: Annotated[bool, Option("write the file although the pairs do not determine weights")] = False
