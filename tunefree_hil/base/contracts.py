"""What each parts folder must export (style: the folder is the registry, the file name is the public name)."""

from __future__ import annotations

from enum import Enum
from typing import Any, Literal, NamedTuple

from tunefree_hil.base.kernel import Block


class Tunable(NamedTuple):
    """One number that a tuner may choose. `steps`/`choices` make it discrete."""

    name: str
    unit: str
    low: float
    high: float
    scale: Literal["log", "linear"] = "log"
    step: float | None = None
    choices: tuple[float, ...] | None = None


class Port(Enum):
    """Where an effect sits (interfaces 4). Scalar ports carry one float, BODY a record of the plant's own constants."""

    STEER_A = "steer A"  # inside the actuator: seen between command and output in the report
    STEER_B = "steer B"  # behind the report: seen only in motion
    THROTTLE_A = "throttle A"
    THROTTLE_B = "throttle B"
    BRAKE_A = "brake A"
    BRAKE_B = "brake B"
    BODY = "body"
    REPORT = "report"
    INS = "ins"


class Effect(NamedTuple):
    """An effect of the catalogue: `make(params) -> Block` on its port's value; with `neutral` it is the identity bit for bit.

    BODY effects change constants, not signals: `make` is then a function (BodyChange) -> BodyChange given as Block-free
    callable; see tunefree_hil/plant/body.py.
    """

    port: Port
    neutral: dict[str, float]
    units: dict[str, str]
    make: Any  # (params: dict[str, float]) -> Block, or for BODY (params) -> BodyChange
    symptom: str


__all__ = ["Block", "Effect", "Port", "Tunable"]
