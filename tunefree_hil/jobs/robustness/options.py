"""The options of `robustness`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NamedTuple

from tunefree_hil.config.tuning.car_limit import MOST_CARS
from tunefree_hil.jobs.options.option import Option, RunPath

DEFAULT_ROADS, DEFAULT_CARS = "robust:1000", 49


class RobustnessOptions(NamedTuple):
    """The options of `robustness`.

    Attributes:
        model: Plant of the drives; None for the verify model, without one for the model of the search.
        scheduler: '' for the threads of this machine.
        out: None for a folder in the run.
    """

    run: RunPath
    roads: Annotated[str, Option("set of made roads, such as robust:1000 or families:50")] = DEFAULT_ROADS
    public: Annotated[bool, Option("the 229 public roads too")] = False
    seed: Annotated[
        int, Option("draws roads, noise and cars; no search or verification has these roads", minimum=0)
    ] = 1
    cars: Annotated[
        int,
        Option(
            "number of cars: the nominal one, the corners of the ensemble, drawn ones", minimum=2, maximum=MOST_CARS
        ),
    ] = DEFAULT_CARS
    model: Annotated[str | None, Option("model to drive; default: the verify model of the bench file")] = None
    allowed: Annotated[int, Option("number of roads that the winner may fail", minimum=0)] = 0
    scheduler: Annotated[
        str, Option("scheduler of dask.distributed, tcp://HOST:PORT; default: this machine", metavar="URL")
    ] = ""
    out: Annotated[
        Path | None, Option("folder of the sweep; an unfinished one is resumed; default: in RUN/robustness")
    ] = None
