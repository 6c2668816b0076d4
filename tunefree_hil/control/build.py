"""Builds the controller Block from a complete parameter vector and the controller parts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from tunefree_hil.base import parts
from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block
from tunefree_hil.control import cascade, limits
from tunefree_hil.control.calibration_map import CalibrationMap
from tunefree_hil.control.contract import Settings, Setup, VehicleConstants, bind
from tunefree_hil.control.follower import ReplanRules, make_follower
from tunefree_hil.control.parameters import BY_NAME, check_complete, middle_of


class PartNames(NamedTuple):
    """The part of each folder; 'path/to/file.py:CONTROLLER' for a part of the user."""

    lateral: str = "lqr"
    longitudinal: str = "pid"
    inner: str = "mrac"


def load_parts(names: PartNames) -> list[Any]:
    """The CONTROLLER of each folder: lateral, longitudinal, inner. InputError has the key of a missing one."""
    loaded = []
    for folder, name in names._asdict().items():
        try:
            loaded.append(parts.load(f"tunefree_hil.control.{folder}", name, "CONTROLLER"))
        except InputError as error:
            error.key = f"controller.{folder}"
            raise
    return loaded


def own_values(names: PartNames) -> dict[str, float]:
    """The tunables of the parts beyond docs/reference/controller.md, in order (PARAM indices from 16 on):
    name -> value.

    The value for a plain Block is that of its params, for a Recipe the middle of the box.
    """
    values: dict[str, float] = {}
    for part in load_parts(names):
        params = getattr(part, "params", None)
        for tunable in part.tunables:
            if tunable.name not in BY_NAME:
                field = tunable.name.rpartition(".")[2]
                values.setdefault(tunable.name, float(getattr(params, field, middle_of(tunable))))
    return values


def build(
    parameters: Mapping[str, float],
    vehicle: VehicleConstants,
    calibration: CalibrationMap,
    course: Course,
    *,
    dt_s: float = 0.01,
    settings: Settings | None = None,
    names: PartNames | None = None,
    rules: ReplanRules | None = None,
    absent: Iterable[str] = (),
) -> Block:
    """The controller for one drive: x = cascade.ControllerInput -> cascade.Decision.

    `parameters` must have all names of docs/reference/controller.md and of the user, else InputError. `absent`: record
    fields that the vehicle does not have, as 'report.speed_mps'.
    """
    names = names or PartNames()
    settings = settings or Settings()
    values = check_complete(parameters, tuple(own_values(names)))
    setup = Setup(values, vehicle, calibration, settings, dt_s, frozenset(absent))
    lateral, longitudinal, inner = (bind(part, setup) for part in load_parts(names))
    return cascade.assemble(
        make_follower(course, vehicle.rear_axle_m, values["look_ahead_m"], rules),
        lateral,
        longitudinal,
        inner,
        limits.make(setup),
        cascade.make_guard(vehicle, settings, setup.absent),
    )
