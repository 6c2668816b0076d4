"""Builds the controller Block from a complete parameter vector and the controller parts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from tunefree_hil.base import parts
from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block
from tunefree_hil.control import cascade, limits
from tunefree_hil.control.calibration_map import CalibrationMap
from tunefree_hil.control.contract import (
    RISE_PER_TAU,
    LoopDelays,
    Settings,
    Setup,
    VehicleConstants,
    bind,
    with_loop_lag,
)
from tunefree_hil.control.filters import butterworth_delay_s
from tunefree_hil.control.follower import PREVIEW_S, PreviewTimes, ReplanRules, make_follower
from tunefree_hil.control.parameters import BY_NAME, check_complete, middle_of
from tunefree_hil.control.steering_map import SteeringMap, data_sheet_map

STEER_PREVIEW, PEDAL_PREVIEW = "steer.preview", "speed.preview_s"


class PartNames(NamedTuple):
    """The part of each folder; 'path/to/file.py:CONTROLLER' for a part of the user."""

    lateral: str = "lqr"
    longitudinal: str = "pid"
    inner: str = "mrac"


class Identified(NamedTuple):
    """What is known of a vehicle beyond its data sheet: steady steering, and times from command to answer."""

    steering: SteeringMap
    delays: LoopDelays


def identified_of_data_sheet(vehicle: VehicleConstants) -> Identified:
    """The data sheet's axles, dead time and rise time; of the pedals and the bus nothing is known."""
    delays = LoopDelays(vehicle.steer_dead_time_s, vehicle.steer_rise_time_s / RISE_PER_TAU)
    return Identified(data_sheet_map(vehicle), delays)


def preview_times(values: Mapping[str, float], delays: LoopDelays, cutoff_hz: float) -> PreviewTimes:
    """Preview of the parts that ask for one by a parameter: steering in shares of its dead time + lag, pedals in s."""
    steer_s = delays.steer_dead_time_s + delays.steer_lag_s + delays.bus_s + butterworth_delay_s(cutoff_hz)
    return PreviewTimes(values.get(STEER_PREVIEW, 0.0) * steer_s, values.get(PEDAL_PREVIEW, PREVIEW_S))


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

    The value for a plain Block is that of its params, for a Recipe its default, else the middle of the box.
    """
    values: dict[str, float] = {}
    for part in load_parts(names):
        params, defaults = getattr(part, "params", None), getattr(part, "defaults", {})
        for tunable in part.tunables:
            if tunable.name not in BY_NAME:
                field = tunable.name.rpartition(".")[2]
                without_params = defaults.get(tunable.name, middle_of(tunable))
                values.setdefault(tunable.name, float(getattr(params, field, without_params)))
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
    identified: Identified | None = None,
    is_realtime: bool = False,
) -> Block:
    """The controller for one drive: x = cascade.ControllerInput -> cascade.Decision.

    `parameters` must have all names of docs/reference/controller.md and of the user, else InputError. `absent`: record
    fields that the vehicle does not have, as 'report.speed_mps'. `identified`: None takes the data sheet's.
    `is_realtime`: see Setup.
    """
    names = names or PartNames()
    settings = settings or Settings()
    values = check_complete(parameters, tuple(own_values(names)))
    identified = identified or identified_of_data_sheet(vehicle)
    lateral_part, longitudinal_part, inner_part = load_parts(names)
    by_map = getattr(lateral_part, "knows_steering", False)
    setup = Setup(values, vehicle, calibration, settings, dt_s, frozenset(absent), *identified, by_map, is_realtime)
    inner = bind(inner_part, setup)
    setup = with_loop_lag(setup, inner_part)
    preview = preview_times(values, setup.delays, settings.cutoff_hz)
    follower = make_follower(course, vehicle.rear_axle_m, values["look_ahead_m"], rules, preview)
    setup = replace(setup, path=follower.params.path)
    controller = cascade.assemble(
        follower,
        bind(lateral_part, setup),
        bind(longitudinal_part, setup),
        inner,
        limits.make(setup),
        cascade.make_guard(vehicle, settings, setup.absent),
    )
    return _with_failure_stop(controller, (lateral_part, longitudinal_part))


def _with_failure_stop(controller: Block, outer_parts: tuple[Any, Any]) -> Block:
    """The controller with a stop where an outer part can fail, else itself."""
    lateral, longitudinal = (getattr(part, "has_failed", None) for part in outer_parts)
    if lateral is None and longitudinal is None:
        return controller

    def has_failed(params: cascade.CascadeParams, state: cascade.CascadeState) -> bool:
        return bool(
            (lateral is not None and lateral(params.lateral, state.lateral))
            or (longitudinal is not None and longitudinal(params.longitudinal, state.longitudinal))
        )

    return cascade.with_failure_stop(controller, has_failed)
