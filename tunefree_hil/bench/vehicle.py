"""The simulated vehicle of a bench: plant, actuators, effects, by-wire unit, noise."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tunefree_hil.base import parts
from tunefree_hil.base.contracts import Effect, Port, make_effect
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import kept
from tunefree_hil.bench.faults import ECU, driver_script, faults_of
from tunefree_hil.bench.load import Bench, model_of, scenario_of_hash
from tunefree_hil.bus.dbc.wire_block import phases
from tunefree_hil.config.schema import ActuatorSpec, EffectSpec, ModelSpec, value_of
from tunefree_hil.episode.scenario import start_of
from tunefree_hil.nodes.ecu import Vehicle
from tunefree_hil.plant.actuation.actuators import ActuatorParams
from tunefree_hil.plant.actuation.bywire import ByWireParams, ChannelRules, bywire
from tunefree_hil.plant.constants import require_constants
from tunefree_hil.plant.ecu import make_unit
from tunefree_hil.plant.measurement.sensors import noise_table
from tunefree_hil.plant.types import Plant
from tunefree_hil.plant.vehicle import assemble, for_episode

PLANTS = {  # [plant] kind -> file in plant/
    "physics": "single_track",
    "reference": "reference",
    "hybrid": "hybrid",
    "lstm": "lstm",
    "mlp": "mlp",
    "rule_based": "rule_based",
    "paper": "paper",
}
TIMEOUT_S = 0.1  # of a channel without one in vehicle.toml (docs/reference/by_wire.md)
STEER_DRIVER_S = 0.02  # steering torque must last this long; vehicle.toml has the times of the pedals
HEAVY = ("reference", "paper")  # kinds whose node runs compiled


class VehicleFor:
    """(scenario, seed) -> Vehicle: the simulated vehicle at a scenario's start. Its step is made once.

    model: the name of a model folder, or its content. ahead: the ECU may step before the commands of the same tick
    arrive, where the bench delays them by at least a tick; the result is the same.
    """

    def __init__(self, bench: Bench, model: str | ModelSpec, *, realtime: bool = False, ahead: bool = False) -> None:
        self.bench = bench
        self.model = model_of(bench, model) if isinstance(model, str) else model
        self.model_name = model if isinstance(model, str) else model.folder
        self.body = _body_of(bench, self.model)
        timing = self.model.timing
        bus_ticks = 1 if realtime else 0  # real time: the bus itself is one tick each way
        if min(timing.command_ticks, timing.report_ticks) < bus_ticks:
            raise InputError(
                "in real time a frame needs one tick each way",
                file=f"{self.model.folder}/model.toml",
                key="timing",
                hint="report_ticks and command_ticks of at least 1",
            )
        block = bywire(bywire_params(bench))
        self.driver = driver_script(bench.spec.faults, bench.vehicle.nominal.rest_pedal_frac)
        self.faults = faults_of(bench, ECU)
        self.ahead = ahead and not realtime and timing.command_ticks > 0
        waits = bus_ticks or int(self.ahead)  # ticks that a command waits outside the unit
        unit = make_unit(self.body, block, timing.command_ticks - waits, timing.report_ticks - bus_ticks)
        self.unit = unit._replace(step=kept(unit.step))
        for part in (self.body.sensors, self.body.measurement_effects):  # tick 0 calls them alone
            kept(part.step)
        self.phases = phases(bench.codec, timing.phase_seed)

    def __call__(self, scenario: bytes, seed: int) -> Vehicle:
        spec = scenario_of_hash(self.bench, scenario)
        course = self.bench.course(spec)
        noise = noise_table(self.model.noise, self.model.bias, course.ticks + 1, seed)
        body = for_episode(self.body, start_of(spec, course), noise)
        return Vehicle(self.unit, body, course, self.bench.dt_s, self.phases, self.driver, self.faults, self.ahead)


def is_heavy(bench: Bench, model: str) -> bool:
    """Whether the model's node should run compiled."""
    return model_of(bench, model).plant.kind in HEAVY


def _body_of(bench: Bench, model: ModelSpec) -> Any:
    vehicle, file = bench.vehicle, f"{model.folder}/model.toml"
    if vehicle.ins_frame.point != "rear_axle":
        raise InputError(
            f"the INS point {vehicle.ins_frame.point!r} cannot be simulated; only 'rear_axle' can",
            file=f"{vehicle.folder}/vehicle.toml",
            key="ins_frame.point",
        )
    rest = vehicle.nominal.rest_pedal_frac
    channels = {
        name: actuator_params(spec, rest if name in ("throttle", "brake") else 0.0)
        for name, spec in model.actuators.items()
    }
    ins_accel = vehicle.ins.get("accel_mps2")
    try:
        plant = plant_of(model)
        require_constants(model.plant.kind, plant.defaults, model.plant.params)
        return assemble(
            plant,
            model.plant.params,
            channels,
            effects=effects_of(model.effects, rest, file) + effects_of(bench.spec.effects, rest, bench.file),
            rest_frac=(rest, rest),
            ins_latency_s=vehicle.ins_frame.latency_s,
            ins_specific_force=bool(ins_accel and ins_accel.specific_force),
            dt_s=bench.dt_s,
        )
    except InputError as error:
        error.file = error.file or file
        raise


def load_plant(kind: str) -> Plant:
    """PLANT of a kind, or of the user's own 'path/to/file.py:EXPORT'."""
    if ":" in kind:
        return parts.load("tunefree_hil.plant", kind, "PLANT")
    if kind not in PLANTS:
        raise InputError(
            f"no plant kind {kind!r}; there are {', '.join(PLANTS)}, or 'path/to/file.py:EXPORT'",
            code="unknown_plant",
            key="plant.kind",
            hint="name one of these",
        )
    return parts.load("tunefree_hil.plant", PLANTS[kind], "PLANT")


def plant_of(model: ModelSpec) -> Plant:
    """The plant of a model folder: its kind, with the content of its file if it has one.

    Raises InputError for a file that does not fit the kind, and for a kind without a file.
    """
    plant = load_plant(model.plant.kind)
    if plant.open is not None:
        return plant.open(Path(model.folder) / (model.plant.file or plant.file))
    if model.plant.file:
        raise InputError(
            f"a plant of kind {model.plant.kind!r} has no file",
            code="no_plant_file",
            file=f"{model.folder}/model.toml",
            key="plant.file",
            hint="leave it out, or name the kind that the file is of",
        )
    return plant


def actuator_params(spec: ActuatorSpec, rest: float) -> ActuatorParams:
    """A channel of [actuators], at rest before tick 0."""
    return ActuatorParams(
        dead_time_s=value_of(spec.dead_time_s),
        order=float(spec.order),
        lag_s=value_of(spec.lag_s),
        natural_hz=value_of(spec.natural_hz),
        damping=value_of(spec.damping),
        rate_limit=value_of(spec.rate_limit),
        dead_band=value_of(spec.dead_band),
        gain=value_of(spec.gain),
        offset=value_of(spec.offset),
        rest=rest,
        initial=rest,
    )


def effects_of(specs: Sequence[EffectSpec], rest: float, file: str = "") -> list[tuple[Port, Any]]:
    """The effects of a model or a bench file (`file`, for mistakes), ready for `assemble`."""
    made = []
    for i, spec in enumerate(specs):
        try:
            effect = parts.load("tunefree_hil.effects", spec.name, "EFFECT", Effect)
            pedal = effect.port.value.split()[0] in ("throttle", "brake")
            made.append((effect.port, make_effect(effect, spec.params, rest=rest if pedal else 0.0, name=spec.name)))
        except InputError as error:
            error.file, error.key = file, f"effects[{i}]" + (f".params.{error.key}" if error.key else "")
            raise
    return made


def bywire_params(bench: Bench) -> ByWireParams:
    """Rules of the by-wire unit from the vehicle folder; the rest are the unit's defaults."""
    vehicle = bench.vehicle
    limits, rest, rules, tick_s = (
        vehicle.limits,
        vehicle.nominal.rest_pedal_frac,
        vehicle.override,
        vehicle.tick_ms * 1e-3,
    )
    default = ByWireParams()

    def ticks(time_s: float) -> int:
        return max(1, round(time_s / tick_s))

    def timeout(name: str) -> float:
        spec = vehicle.command.get(name)
        return spec.timeout_ms / vehicle.tick_ms if spec and spec.timeout_ms else float(ticks(TIMEOUT_S))

    def pedal(name: str, level: float, hold_s: float, high: float) -> ChannelRules:
        return ChannelRules(
            timeout_ticks=timeout(f"{name}_frac"),
            driver_level=rules.driver_frac,
            driver_ticks=ticks(rules.driver_s),
            override_level=level,
            override_ticks=ticks(hold_s),
            low=rest,
            high=high,
        )

    return default._replace(
        throttle=pedal("throttle", rules.throttle_frac, rules.throttle_s, limits.throttle_frac),
        brake=pedal("brake", rules.brake_frac, rules.brake_s, limits.brake_frac),
        steer=default.steer._replace(
            timeout_ticks=timeout("steer_rad"),
            driver_ticks=float(ticks(STEER_DRIVER_S)),
            override_level=rules.steer_nm,
            override_ticks=ticks(rules.steer_s),
            low=-limits.steer_rad,
            high=limits.steer_rad,
        ),
        brake_ramp_per_tick=limits.brake_rate_per_s * tick_s,
        watchdog_brake_frac=limits.watchdog_brake_frac,
        check_counter=1.0 if any(message.counter for message in bench.codec.commands) else 0.0,  # E2E or plain
    )
