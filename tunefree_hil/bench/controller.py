"""The controller of a bench: constants, parameters, map, and the Block for one drive."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.open_loop_map import MAP_FILE
from tunefree_hil.bench.faults import CONTROLLER, faults_of
from tunefree_hil.bench.identified import identified_of
from tunefree_hil.bench.load import Bench, model_of, scenario_of_hash
from tunefree_hil.bench.user_parts import own_parameters, part_names, part_values
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.config.schema import ScenarioSpec, VehicleSpec
from tunefree_hil.control import calibration_map
from tunefree_hil.control.build import build
from tunefree_hil.control.contract import Settings, VehicleConstants
from tunefree_hil.control.follower import make_follower
from tunefree_hil.control.parameters import (
    BY_NAME,
    LARGEST32,
    RICCATI_CODES,
    BoxChoice,
    by_index,
    check_complete,
    indices_of,
    round32,
    study_values,
    tunable_in_box,
)
from tunefree_hil.nodes.controller import Assignment
from tunefree_hil.nodes.measurement_decoder import CHASSIS, INS

MAX_CACHED = 32  # gain tables, and path tables


def constants_of(vehicle: VehicleSpec) -> VehicleConstants:
    """The vehicle's constants for the controller. Raises InputError that names a missing data-sheet value."""
    nominal, limits = vehicle.nominal, vehicle.limits
    names = ("mass_kg", "wheelbase_m", "front_axle_m", "yaw_inertia_kgm2", "steer_ratio",
             "front_stiffness_n_per_rad", "rear_stiffness_n_per_rad")  # fmt: skip
    missing = [name for name in names if getattr(nominal, name) is None]
    if missing:
        raise InputError(
            "the controller needs this data-sheet value",
            code="missing_nominal",
            file=f"{vehicle.folder}/vehicle.toml",
            key=f"nominal.{missing[0]}",
            hint="add it; `calibrate` will refine it later",
        )
    latency = vehicle.latency.get("steer")
    return VehicleConstants(
        **{name: getattr(nominal, name) for name in names},
        rest_pedal_frac=nominal.rest_pedal_frac,
        steer_limit_rad=limits.steer_rad,
        steer_rate_radps=limits.steer_rate_radps,
        throttle_limit_frac=limits.throttle_frac,
        brake_limit_frac=limits.brake_frac,
        accel_low_mps2=limits.accel_mps2[0],
        accel_high_mps2=limits.accel_mps2[1],
        lateral_accel_mps2=limits.lateral_accel_mps2,
        steer_dead_time_s=latency.dead_time_s if latency else 0.0,
        steer_rise_time_s=latency.rise_time_s if latency else 0.0,
    )


def require_in_box(name: str, value: float, *, file: str = "", key: str = "") -> None:
    """Raise InputError for a user's value outside its widest box; the shipped manual values are allowed.

    Compared as binary32, as the controller gets it. Names that are not in docs/reference/controller.md have no box;
    their values must only be sendable.
    """
    row, sendable = BY_NAME.get(name), math.isfinite(value) and abs(value) < LARGEST32
    if row is None:
        if sendable:
            return
        raise InputError(
            f"{name} = {value:g} cannot be sent to the controller",
            code="outside_box",
            file=file,
            key=key,
            hint=f"parameters are binary32: give a number between -{LARGEST32:.2g} and {LARGEST32:.2g}",
        )
    either, choices = tunable_in_box(name, BoxChoice.DEFAULT), row.tunable.choices
    low, high = min(either.low, row.tunable.low), max(either.high, row.tunable.high)
    if sendable:
        sent = round32(value)
        inside = sent in choices if choices else round32(low) <= sent <= round32(high)
        if inside or sent in (round32(row.manual), round32(row.manual if row.fixed is None else row.fixed)):
            return
    box = " or ".join(f"{one:g}" for one in choices) if choices else f"{low:g} to {high:g}"
    manual = "" if choices or low <= row.manual <= high else f", or {row.manual:g} as shipped"
    unit = f" {row.tunable.unit}" if row.tunable.unit != "1" else ""
    raise InputError(
        f"{name} = {value:g} is outside its box",
        code="outside_box",
        file=file,
        key=key,
        hint=f"give {box}{unit}{manual}",
    )


def parameters_of(bench: Bench, chosen: Mapping[str, float] | None = None) -> dict[str, float]:
    """A complete vector (binary32): a study's fixed values, the bench file's, then `chosen`.

    Raises InputError where the bench file gives a value outside its box; the caller checks `chosen`.
    """
    controller = bench.spec.controller
    require_in_box("look_ahead_m", controller.look_ahead_m, file=bench.file, key="controller.look_ahead_m")
    for name, value in controller.parameters.items():
        require_in_box(name, value, file=bench.file, key=f"controller.parameters.{name}")
    values = study_values()
    values |= {"riccati": RICCATI_CODES[controller.riccati], "look_ahead_m": controller.look_ahead_m}
    own_names = own_parameters(bench)
    for name in (name for name in own_names if name not in controller.parameters):
        require_in_box(name, own_names[name], file=bench.file, key="tune.parameters")
    values |= own_names | controller.parameters
    values |= dict(chosen or {})
    return {name: round32(value) for name, value in check_complete(values, tuple(own_names)).items()}


def settings_of(bench: Bench) -> Settings:
    """The settings that are neither tuned nor constants of the vehicle."""
    return Settings(
        lane_half_width_m=bench.weights.lane_half_width_m,
        divergence_heading_rad=bench.weights.divergence_heading_rad,
        mrac_form=bench.spec.controller.mrac_form,
        mrac_order=bench.spec.controller.mrac_order,
        mrac_dead_zone=bench.spec.controller.mrac_dead_zone,
    )


def calibration_path(bench: Bench) -> Path:
    """File of the open-loop map: the bench file's own, else that of its model."""
    file = bench.spec.controller.calibration
    if file:
        beside = Path(bench.file).parent / file
        return beside if beside.is_file() else Path(file)
    return Path(model_of(bench, bench.spec.model).folder) / MAP_FILE


def calibration_of(bench: Bench) -> Any:
    """The open-loop map."""
    return calibration_map.load(calibration_path(bench))


def follower_of(bench: Bench, scenario: ScenarioSpec, values: Mapping[str, float]) -> Block:
    """The reference follower as the controller runs it."""
    return make_follower(bench.course(scenario), constants_of(bench.vehicle).rear_axle_m, values["look_ahead_m"])


class ControllerFor:
    """(scenario, parameters by index) -> Assignment. Gain tables of the last parameters and path tables are kept.

    own: parameters of the parts beyond docs/reference/controller.md, announced in this order.
    is_realtime: for drives at the pace of wall time.
    """

    def __init__(self, bench: Bench, *, is_realtime: bool = False) -> None:
        self.bench = bench
        self.is_realtime = is_realtime
        self.constants = constants_of(bench.vehicle)
        self.calibration = calibration_of(bench)
        self.settings = settings_of(bench)
        self.identified = identified_of(bench, self.constants)
        self.faults = faults_of(bench, CONTROLLER)
        self.parts = part_names(bench)
        self.own = part_values(bench)
        self._built: dict[tuple[float, ...], Block] = {}
        self._followers: dict[str, Block] = {}

    def indexed(self, values: Mapping[str, float]) -> dict[int, float]:
        """A complete vector by PARAM index, for `__call__`, without names that are not the controller's."""
        complete = self.own | dict(values)
        return {index: complete[name] for name, index in indices_of(tuple(self.own)).items()}

    def __call__(self, scenario: bytes, parameters: Mapping[int, float]) -> Assignment:
        spec = scenario_of_hash(self.bench, scenario)
        values = by_index(parameters, tuple(self.own))
        course = self.bench.course(spec)
        key = tuple(values.values())
        if key not in self._built:
            _make_room(self._built)
            self._built[key] = self._build(values, course)
        block = self._built[key]
        if spec.hash not in self._followers:
            _make_room(self._followers)
            self._followers[spec.hash] = follower_of(self.bench, spec, values)
        built = block.params.follower
        follower = self._followers[spec.hash].params._replace(
            look_ahead_m=built.look_ahead_m,
            steer_preview_s=built.steer_preview_s,
            pedal_preview_s=built.pedal_preview_s,
        )
        params = block.params._replace(follower=follower)
        if hasattr(params.lateral, "path"):
            params = params._replace(lateral=params.lateral._replace(path=follower.path))
        return Assignment(block._replace(params=params), course.ticks, self.bench.dt_s, self.faults)

    def _build(self, values: dict[str, float], course: Course) -> Block:
        try:
            return build(
                values,
                self.constants,
                self.calibration,
                course,
                dt_s=self.bench.dt_s,
                settings=self.settings,
                names=self.parts,
                absent=self.bench.vehicle.absent,
                identified=self.identified,
                is_realtime=self.is_realtime,
            )
        except InputError as error:
            error.file = error.file or self.bench.file
            raise


def _make_room(cache: dict[Any, Any]) -> None:
    """Drop the oldest entry above the limit."""
    if len(cache) >= MAX_CACHED:
        del cache[next(iter(cache))]


def needed_messages(codec: Codec) -> dict[str, list[str]]:
    """Messages without which the controller stops commanding, by group."""
    needed: dict[str, list[str]] = {INS: [], CHASSIS: []}
    for message in codec.telemetry:
        names = {(one.group, one.name) for one in message.fields}
        if any(group == "ins" for group, _ in names):
            needed[INS].append(message.name)
        elif names & {("report", "speed_mps"), ("report", "steer_rad")}:
            needed[CHASSIS].append(message.name)
    return needed
