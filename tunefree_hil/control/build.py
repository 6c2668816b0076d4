"""From a complete parameter vector to the controller Block. The one place that knows which part comes after which."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from tunefree_hil.base import parts
from tunefree_hil.base.course import Course
from tunefree_hil.base.kernel import Block
from tunefree_hil.control import cascade, limits
from tunefree_hil.control.calibration_map import CalibrationMap
from tunefree_hil.control.contract import Settings, Setup, VehicleConstants, bind
from tunefree_hil.control.follower import Rules, make_follower
from tunefree_hil.control.parameters import BY_NAME, check_complete


class PartNames(NamedTuple):
    """Which part of each folder; 'path/to/file.py:CONTROLLER' for one's own."""

    lateral: str = "lqr"
    longitudinal: str = "pid"
    inner: str = "mrac"


def load_parts(names: PartNames) -> tuple[Any, Any, Any]:
    """The CONTROLLER of each folder: lateral, longitudinal, inner."""
    package = "tunefree_hil.control"
    return (
        parts.load(f"{package}.lateral", names.lateral, "CONTROLLER"),
        parts.load(f"{package}.longitudinal", names.longitudinal, "CONTROLLER"),
        parts.load(f"{package}.inner", names.inner, "CONTROLLER"),
    )


def own_names(names: PartNames) -> tuple[str, ...]:
    """Names of the tunables that the parts bring beyond interfaces 7, in order: PARAM indices from 16 on."""
    announced = [tunable.name for part in load_parts(names) for tunable in part.tunables]
    return tuple(dict.fromkeys(name for name in announced if name not in BY_NAME))


def build(
    parameters: Mapping[str, float],
    vehicle: VehicleConstants,
    calibration: CalibrationMap,
    course: Course,
    *,
    dt_s: float = 0.01,
    settings: Settings | None = None,
    names: PartNames | None = None,
    rules: Rules | None = None,
    absent: Iterable[str] = (),
) -> Block:
    """The controller for one drive: x = cascade.Sight -> cascade.Decision.

    `parameters` must name all of interfaces 7 and the user's own, else InputError. `absent`: record fields that the
    vehicle does not have, as 'report.speed_mps'.
    """
    names = names or PartNames()
    settings = settings or Settings()
    values = check_complete(parameters, own_names(names))
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
