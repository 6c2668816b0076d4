"""What the command line shows of an option: metadata of a field, which cli/options.py turns into a parameter.

Plain data, so that `--help` imports no job. The definitions below are shared by several commands.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NamedTuple


class Option(NamedTuple):
    """An option.

    Attributes:
        help: One line.
        name: Where it is not `--` and the name of the field, such as `--set`.
        metavar: Placeholder of the value; None for the name of its type.
        minimum: Smallest number allowed.
        maximum: Largest number allowed.
        choices: The texts allowed; empty for any.
        last: Whether `--help` lists it after the options of the other records.
    """

    help: str
    name: str = ""
    metavar: str | None = None
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    last: bool = False


class Argument(NamedTuple):
    """A positional argument; it may be left out where its field has a default. metavar: None for the field's name."""

    help: str
    metavar: str | None = None


DEFAULT_SESSION = "default"  # of hub, ecu and controller

BENCH = Argument("bench file, such as bench_configs/mkz_steer.toml")
LOGS = Argument("logs of one vehicle, in any format", metavar="LOG...")
VEHICLE = Option("vehicle folder or its name in dbc/")
NEW_MODEL = Option("model folder to write; it must not be there yet")

BenchFile = Annotated[Path, BENCH]
RunPath = Annotated[Path, Argument("folder of a run, such as runs/20260101-120000-mkz_steer", metavar="RUN")]
Bus = Annotated[str, Option("auto, tfhub, tfhub:ADDRESS, socketcan:vcan0 or virtual")]
BenchBus = Annotated[str, Option("another virtual link for the bench channel: socketcan:vcan1")]
Controller = Annotated[str, Option("start this program instead of the built-in controller", metavar="CMD")]
Join = Annotated[bool, Option("use a hub and nodes that run already (other terminals)")]
Model = Annotated[str | None, Option("model; default: as in the bench file")]
Out = Annotated[Path | None, Option("where run folders go; default: runs")]
Realtime = Annotated[bool, Option("in real time (100 Hz) instead of lockstep")]
Seed = Annotated[int | None, Option("seed; default: as in the file", minimum=0)]
Session = Annotated[str, Option("name of the bench, where several run on one machine")]
Vehicle = Annotated[str | None, VEHICLE]
