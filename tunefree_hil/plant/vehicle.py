"""A whole simulated vehicle: actuators, chassis, sensors and effects.

`assemble(...)` gives a Block BodyInput -> BodyOutput. Order of a tick: command, effects A, actuators, effects on
their outputs, effects B, chassis, sensors; the measurement belongs to the state after the tick. `first_output` is tick
0, before any step. Start and noise are params, so one compiled body is enough for every episode (`for_episode`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import BodyChange, Port
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block, kernel
from tunefree_hil.base.records import GEAR_DRIVE, NAN, Actuation, Command, Disturbance
from tunefree_hil.plant.actuation.acceleration_interface import actuators_by_accel
from tunefree_hil.plant.actuation.actuators import ActuatorParams, actuators
from tunefree_hil.plant.measurement.report_latency import report_latency
from tunefree_hil.plant.measurement.sensors import SensorInput, SensorParams, noise_table, rolled_in, sensors
from tunefree_hil.plant.ports import Effects, channels_of, make_measurement_effects, upto_report
from tunefree_hil.plant.types import BodyInput, BodyOutput, ChassisInput, Driver, Plant, rolling_motion


class BodyParams(NamedTuple):
    """Params of the assembled Block, part by part. chassis.start and sensors.noise belong to the episode."""

    front: Any  # effects A and actuators
    behind: Any  # effects B
    chassis: Any
    sensors: SensorParams
    ends: Any  # effects on Report and Ins
    late_s: float  # delay of the report frames by all effects


class BodyState(NamedTuple):
    """State of the assembled Block, part by part."""

    front: Any
    behind: Any
    chassis: Any
    sensors: Any
    ends: Any


class BodySteps(NamedTuple):
    """Steps of the parts of a vehicle: Command -> Actuation, Actuation -> Actuation, ChassisInput -> Motion,
    SensorInput -> Measurement, Measurement -> Measurement.
    """

    front: Any
    behind: Any
    chassis: Any
    sensors: Any
    ends: Any


class Body(NamedTuple):
    """An assembled vehicle: the Block, and the parts that tick 0 needs."""

    block: Block
    rest: Command
    sensors: Block
    measurement_effects: Block
    late: bool = False  # whether an effect delays the report frames


def assemble(
    plant: Plant,
    params: Mapping[str, float],
    channels: Mapping[str, ActuatorParams] | None = None,
    *,
    effects: Effects = (),
    rest_frac: tuple[float, float] = (0.15, 0.15),
    ins_latency_s: float = 0.0,
    ins_specific_force: bool = False,
    dt_s: float = 0.01,
) -> Body:
    """The vehicle of a model folder.

    plant: PLANT of `plant/single_track.py`, `plant/reference.py` or the user's own; params: [plant.params]; channels:
    'throttle', 'brake', 'steer' of [actuators], or 'accel', 'steer' of a car with an acceleration command (a
    'steer_torque' is ignored); not used by a plant with its own. effects: (port, result of `contracts.make_effect`);
    on the same port each one gets the output of the one before. rest_frac: throttle and brake duty at rest. The INS is
    at the rear axle. Raises InputError for parameters or ports that do
    not fit.
    """
    change = BodyChange()
    for _, made in effects:
        if not isinstance(made, Block):
            change = made(change)
    effects = [(port, made) for port, made in effects if isinstance(made, Block)]
    chassis = plant.make(params, change)
    if plant.actuators is not None:
        actuators_block = plant.actuators(params)
    else:
        actuators_block = _own_actuators(channels or {}, rest_frac[0])
    front = upto_report(effects, actuators_block)
    behind = channels_of(effects, (Port.THROTTLE_B, Port.BRAKE_B, Port.STEER_B), Actuation)
    measurement_effects = make_measurement_effects(effects)
    ins_ticks = round(ins_latency_s / dt_s)
    quiet = SensorParams(noise_table({}, {}, 0, 0), ins_specific_force=1.0 if ins_specific_force else 0.0)
    sensor_block = sensors(quiet, ins_ticks)
    late, late_s = report_latency(effects)
    block = _body(front, behind, chassis, sensor_block, measurement_effects, plant.substeps, ins_ticks, late_s)
    accel_mps2 = 0.0 if plant.actuators is None and "accel" in (channels or {}) else NAN
    rest = Command(rest_frac[0], rest_frac[1], 0.0, GEAR_DRIVE, accel_mps2, NAN)
    return Body(block, rest, sensor_block, measurement_effects, late)


def for_episode(body: Body, start: Start, noise: Any = None) -> Body:
    """The same vehicle at another start and with this episode's `sensors.noise_table` (None: none)."""
    params = body.block.params
    rows = noise_table({}, {}, 0, 0) if noise is None else noise
    new = params._replace(chassis=params.chassis._replace(start=start), sensors=params.sensors._replace(noise=rows))
    return body._replace(block=body.block._replace(params=new))


def first_output(body: Body, dt_s: float, driver: Driver | None = None) -> tuple[Any, BodyOutput]:
    """(state, output) of tick 0: rolling straight at the start, actuators at rest; no step has been made.

    driver: None is both pedals at the vehicle's own rest.
    """
    driver = driver or Driver(body.rest.throttle_frac, body.rest.brake_frac)
    block = body.block
    state = block.init(block.params, dt_s)
    params = block.params
    motion = rolling_motion(params.chassis.start, params.chassis.constants.wheel_radius_m)
    actuation = Actuation(body.rest.throttle_frac, body.rest.brake_frac, 0.0, body.rest.gear)
    x = SensorInput(motion, actuation, body.rest, driver)
    sensor_state, measurement = body.sensors.step(params.sensors, state.sensors, x, dt_s)
    ends, measurement = body.measurement_effects.step(params.ends, state.ends, measurement, dt_s)
    return state._replace(sensors=sensor_state, ends=ends), BodyOutput(actuation, motion, measurement)


def steady_accel(
    plant: Plant,
    params: Mapping[str, float],
    speed_mps: float,
    throttle_frac: float,
    brake_frac: float,
    *,
    settle_s: float = 0.0,
    dt_s: float = 0.01,
) -> float:
    """Rate of speed on a level, straight road with these pedal *outputs* held for `settle_s` and one more step.

    The point (speed, command -> acceleration) of an open-loop map; actuators are left out. A chassis with its
    own lags needs settle_s > 0 (its speed then differs slightly from speed_mps), `physics` does not.
    """
    block = plant.make(params, BodyChange())
    chassis = block.params._replace(start=Start(speed_mps=speed_mps))
    state = block.init(chassis, dt_s)
    x = ChassisInput(Actuation(throttle_frac, brake_frac, 0.0, GEAR_DRIVE), Disturbance())
    for _ in range(round(settle_s / dt_s)):
        state, _ = block.step(chassis, state, x, dt_s)
    return float(block.step(chassis, state, x, dt_s)[1].speed_rate_mps2)


def _own_actuators(channels: Mapping[str, ActuatorParams], rest_frac: float) -> Block:
    """[actuators] as a Block Command -> Actuation."""
    given = {name: one for name, one in channels.items() if name != "steer_torque"}
    if set(given) == {"accel", "steer"}:
        return actuators_by_accel(given["accel"], given["steer"], rest_frac)
    if set(given) != {"throttle", "brake", "steer"}:
        raise InputError(
            f"the actuators are {', '.join(sorted(channels)) or 'none'}",
            code="bad_actuators",
            key="actuators",
            hint="a plant without actuators of its own needs throttle, brake and steer, or accel and steer",
        )
    return actuators(**given)


def _body(
    front: Block,
    behind: Block,
    chassis: Block,
    sensor_block: Block,
    measurement_effects: Block,
    substeps: int,
    ins_ticks: int,
    late_s: float,
) -> Block:
    """The parts as one Block."""

    def init(params: BodyParams, dt_s: float) -> BodyState:
        small_s = dt_s / substeps
        first = rolling_motion(params.chassis.start, params.chassis.constants.wheel_radius_m)
        return BodyState(
            front.init(params.front, small_s),
            behind.init(params.behind, small_s),
            chassis.init(params.chassis, small_s),
            rolled_in(params.sensors, first, ins_ticks, dt_s),
            measurement_effects.init(params.ends, dt_s),
        )

    steps = BodySteps(front.step, behind.step, chassis.step, sensor_block.step, measurement_effects.step)
    params = BodyParams(
        front.params, behind.params, chassis.params, sensor_block.params, measurement_effects.params, late_s
    )
    return Block(init, make_tick(steps, substeps), params)


def make_tick(steps: BodySteps, substeps: int = 1) -> Any:
    """One tick of a vehicle as a kernel (BodyParams, BodyState, BodyInput, dt_s) -> (BodyState, BodyOutput).

    The only place with the order of its parts. front, behind and chassis are stepped `substeps` times a tick, the
    rest once.
    """
    front_step, behind_step, chassis_step, sensor_step, measurement_step = steps

    @kernel
    def step(params: BodyParams, state: BodyState, x: BodyInput, dt_s: float) -> tuple[BodyState, BodyOutput]:
        small_s = dt_s / substeps  # not 0: whole number of steps a tick, at least 1
        front_state, out = front_step(params.front, state.front, x.command, small_s)
        behind_state, applied = behind_step(params.behind, state.behind, out, small_s)
        chassis_state, motion = chassis_step(params.chassis, state.chassis, ChassisInput(applied, x.road), small_s)
        for _ in range(1, substeps):
            front_state, out = front_step(params.front, front_state, x.command, small_s)
            behind_state, applied = behind_step(params.behind, behind_state, out, small_s)
            chassis_state, motion = chassis_step(params.chassis, chassis_state, ChassisInput(applied, x.road), small_s)
        sensor_input = SensorInput(motion, out, x.command, x.driver)
        sensor_state, measurement = sensor_step(params.sensors, state.sensors, sensor_input, dt_s)
        effects_state, measured = measurement_step(params.ends, state.ends, measurement, dt_s)
        new = BodyState(front_state, behind_state, chassis_state, sensor_state, effects_state)
        return new, BodyOutput(out, motion, measured)

    return step
