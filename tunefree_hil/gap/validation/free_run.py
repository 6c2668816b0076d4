"""Free runs over a recording: the whole simulated vehicle of a model folder, driven by the recorded commands alone.

Actuators, effects, chassis and sensors are put together as on the bench (plant/vehicle.py, `assemble`), so that a
bench drives what is verified. Where rows are held, the chassis is set to the measured motion; elsewhere it runs free.
Sensor noise is left out, as it is in the measurement.

A run over some blocks may begin anew before each of them, if the vehicle forgets within WARM_UP_S what it did before.
Dead times and lags do; play and dry friction keep their side, brakes their heat, and a learned cell may keep anything.
So every part is tested: it is driven far to either side, then held at rest, and has to come to the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base import parts
from tunefree_hil.base.contracts import Latency, Port, make_effect
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.records import Command, Disturbance, Ins, Motion, Report
from tunefree_hil.config.schema import EffectSpec, ModelSpec, VehicleSpec
from tunefree_hil.gap.measured.chain import MeasuredDrive, find_commanded_channels
from tunefree_hil.gap.model.graph import CHANNELS, channel_spec_from_model, is_inert_port
from tunefree_hil.gap.model.history import shift_earlier
from tunefree_hil.learn.evaluation.free_run import open_plant
from tunefree_hil.learn.evaluation.motion import actuator_params
from tunefree_hil.plant.actuation.actuators import ActuatorParams, actuator
from tunefree_hil.plant.measurement.sensors import noise_table
from tunefree_hil.plant.types import BodyInput, ChassisParams, Driver
from tunefree_hil.plant.vehicle import Body, assemble, first_output, for_episode

Array = np.ndarray

REPORT_SIGNALS = tuple(f"report.{name}" for name in Report._fields)
INS_SIGNALS = tuple(f"ins.{name}" for name in Ins._fields)
RECORDS = {Port.REPORT: Report, Port.INS: Ins}
SENSOR_PORTS = (Port.REPORT, Port.INS)
STANDSTILL_MPS = 0.05  # measured speed of a standing road car: its wheel sensors rattle, and brakes would act each tick
COURSE_S, MIN_PATH_M = 4.0, 2.0  # window and least length of path from which positions give a course
WARM_UP_S = 3.0  # after that a lag of 0.4 s keeps 5e-4 of what was before; most lags are a few hundredths
DISTURBED_S, DISTURBANCE = 3.0, 0.5  # how long and how far (duty, rad, or 1 of a report) a part is driven before
MAX_REMAINDER = 1e-3  # share of the difference between the two sides that may be left after WARM_UP_S


class FreeRunCar(NamedTuple):
    """The simulated vehicle of a model folder.

    Args:
        body: the assembled vehicle.
        observe: sets the chassis to a measured motion.
        sensor_delay_s: by how much the model's own effects delay reports and INS.
        has_short_memory: nothing in it remembers what it did more than WARM_UP_S ago.
    """

    body: Body
    observe: Any
    rest_pedal_frac: float
    sensor_delay_s: tuple[float, float]
    has_short_memory: bool


def assemble_car(
    model: ModelSpec, vehicle: VehicleSpec, drive: MeasuredDrive, day_effects: Sequence[EffectSpec] = ()
) -> FreeRunCar:
    """The vehicle for one recording.

    A vehicle that is controlled by acceleration is driven by two pedals (gap/model/graph.py), as in the search. Effects
    that a bench would not apply are left out. A channel whose commands acted nowhere in the recording (a person drove)
    has no actuator: the reported output acts. A delay of the INS in the vehicle folder is not part of the vehicle, as
    recordings are corrected for it.

    Args:
        day_effects: effects after the model's own, as a bench file has them.
    """
    rest, plant = vehicle.nominal.rest_pedal_frac, open_plant(model)
    channels = {}
    for name, acts in zip(CHANNELS, find_commanded_channels(drive), strict=True):
        idle = 0.0 if name == "steer" else rest
        if acts:
            channels[name] = actuator_params(channel_spec_from_model(model, name), idle, idle)
        else:
            channels[name] = ActuatorParams(rest=idle, initial=idle)
    made = [_make_effect(spec, rest) for spec in (*model.effects, *day_effects)]
    effects = [(port, effect) for port, effect in made if not is_inert_port(model, port)]
    body = assemble(plant, model.plant.params, channels, effects=effects, rest_frac=(rest, rest), dt_s=drive.dt_s)
    biased = for_episode(body, body.block.params.chassis.start, noise_table({}, model.bias, 0, 0))
    delays = [
        sum(effect.params.delay_s for port, effect in effects if port is sensor and _is_latency(effect))
        for sensor in SENSOR_PORTS
    ]
    all_parts = [*effects, *((None, actuator(channel)) for channel in channels.values())]
    has_short_memory = chassis_forgets(model.plant.kind, biased.block.params.chassis) and all(
        forgets_disturbance(
            part, port, 0.0 if port is not None and port.value.startswith("steer") else rest, drive.dt_s
        )
        for port, part in all_parts
    )
    return FreeRunCar(biased, plant.observe, rest, (delays[0], delays[1]), has_short_memory)


def _is_latency(effect: Any) -> bool:
    return isinstance(effect, Block) and isinstance(effect.params, Latency)


def _make_effect(spec: EffectSpec, rest: float) -> tuple[Port, Any]:
    effect = parts.load("tunefree_hil.effects", spec.name, "EFFECT")
    is_pedal = effect.port.value.startswith(("throttle", "brake"))
    return effect.port, make_effect(effect, spec.params, rest=rest if is_pedal else 0.0, name=spec.name)


def simulate_recording(
    car: FreeRunCar, drive: MeasuredDrive, held: Array, *, skip_forgotten: bool = False
) -> Mapping[str, Array]:
    """Simulate a recording, by its commands.

    Args:
        held: rows (n_rows,), bool, in which the chassis is set to the measured motion.
        skip_forgotten: of a car with a short memory, simulate only the rows that are not held, and the warm-up before
            them.

    Returns:
        (n_rows,) by record field ('report.speed_mps', 'ins.x_m'); NaN where nothing was simulated, and to the end where
        the simulation diverges.
    """
    recorded = _recorded_inputs(car, drive)
    body, dt_s = car.body, drive.dt_s
    start = body.block.params.chassis.start._replace(speed_mps=float(drive.inputs.speed_mps[0]))
    body = for_episode(body, start, body.block.params.sensors.noise)
    state, _ = first_output(body, dt_s)
    step, params, observe = body.block.step, body.block.params, car.observe
    no_driver, road = Driver(car.rest_pedal_frac, car.rest_pedal_frac), Disturbance(0.0, 1.0)
    rows, is_held = np.full((drive.ticks, len(REPORT_SIGNALS) + len(INS_SIGNALS)), np.nan), held.tolist()
    has_gaps = skip_forgotten and car.has_short_memory
    simulated = rows_to_simulate(held, dt_s) if has_gaps else np.ones(drive.ticks, dtype=bool)
    for k in np.flatnonzero(simulated[1:]).tolist():
        k += 1
        if is_held[k - 1]:
            state = state._replace(chassis=observe(state.chassis, recorded.motions[k - 1]))
        command = Command._make((*recorded.commands[k], recorded.gears[k], np.nan, np.nan))
        try:
            state, out = step(params, state, BodyInput(command, no_driver, road), dt_s)
        except (ArithmeticError, ValueError):  # Python raises where compiled code returns NaN
            break
        rows[k] = (*out.measurement.report, *out.measurement.ins)
    rows[0] = rows[min(1, len(rows) - 1)]
    return dict(zip((*REPORT_SIGNALS, *INS_SIGNALS), rows.T, strict=True))


class _RecordedInputs(NamedTuple):
    """What a recording gives to each row of a simulation."""

    commands: list[list[float]]
    motions: list[Motion]
    gears: list[float]


def _recorded_inputs(car: FreeRunCar, drive: MeasuredDrive) -> _RecordedInputs:
    """The inputs of each row; values from delayed reports are moved back to when they were measured."""
    x = drive.inputs
    report_ticks, ins_ticks = (delay_s / x.dt_s for delay_s in car.sensor_delay_s)
    columns = [shift_earlier(x.commands[:, i], report_ticks) if x.is_echoed[i] else x.commands[:, i] for i in range(3)]
    speed = np.where(np.abs(x.speed_mps) < STANDSTILL_MPS * drive.size_scale, 0.0, x.speed_mps)
    motion = np.column_stack([*measured_pose(drive), speed, x.side_speed_mps, x.yaw_rate_radps, x.speed_rate_mps2])
    motion = shift_earlier(motion, ins_ticks if x.uses_ins_speed else report_ticks)
    motions = [Motion._make((*row[:6], 0.0, 0.0, row[6], 0.0, 0.0, 0.0, 0.0)) for row in motion.tolist()]
    return _RecordedInputs(np.stack(columns, axis=1).tolist(), motions, x.gear.tolist())


class MeasuredPose(NamedTuple):
    """Of the rear axle, (n_rows,) each."""

    x_m: Array
    y_m: Array
    heading_rad: Array


def measured_pose(drive: MeasuredDrive) -> MeasuredPose:
    """The measured pose. Without an INS it is the integral of speed and yaw rate, from an origin of its own; where
    positions were measured and no heading, that heading is turned into the direction in which the positions move.
    """
    speed, dt_s = drive.inputs.speed_mps, drive.dt_s
    has_position = drive.has_signals("ins.x_m", "ins.y_m")
    if drive.has_signals("ins.heading_rad"):
        heading = drive.signals["ins.heading_rad"].values
    else:
        heading = np.cumsum(drive.inputs.yaw_rate_radps) * dt_s
        heading = heading + (_heading_offset(drive, heading) if has_position else 0.0)
    if has_position:
        return MeasuredPose(drive.signals["ins.x_m"].values, drive.signals["ins.y_m"].values, heading)
    return MeasuredPose(np.cumsum(speed * np.cos(heading)) * dt_s, np.cumsum(speed * np.sin(heading)) * dt_s, heading)


def _heading_offset(drive: MeasuredDrive, heading: Array) -> Array:
    """Angle from an integrated heading to the course of the measured positions, rad (n_rows,); means over COURSE_S,
    weighted by distance. The positions are the rear axle's, which moves where the vehicle heads but for its slip.
    """
    x_m, y_m = (drive.signals[name].values for name in ("ins.x_m", "ins.y_m"))
    path = (np.gradient(x_m) + 1j * np.gradient(y_m)) * drive.is_moving
    window = max(min(round(COURSE_S / drive.dt_s), drive.ticks), 1)
    mean = np.convolve(path * np.exp(-1j * heading), np.ones(window), "same")
    clear = np.flatnonzero(np.abs(mean) > MIN_PATH_M)
    if not len(clear):
        return np.zeros(drive.ticks)
    return np.interp(np.arange(drive.ticks), clear, np.unwrap(np.angle(mean[clear])))


def forgets_disturbance(part: Any, port: Port | None, rest: float, dt_s: float) -> bool:
    """Whether an effect (as `make_effect` makes it) or a channel (port None) forgets what it did before.

    A change of the body is the chassis's (`chassis_forgets`).
    """
    if not isinstance(part, Block):
        return True
    record = RECORDS.get(port) if port is not None else None
    outputs = []
    for side in (-DISTURBANCE, DISTURBANCE):
        disturbed, resting = (_constant_input(record, value) for value in (rest + side, rest))
        state = part.init(part.params, dt_s)
        output: Any = resting
        for x, ticks in ((disturbed, round(DISTURBED_S / dt_s)), (resting, round(WARM_UP_S / dt_s))):
            for _ in range(ticks):
                state, output = part.step(part.params, state, x, dt_s)
        outputs.append(np.asarray(output, dtype=float))
    return bool(np.abs(outputs[0] - outputs[1]).max() <= MAX_REMAINDER * 2.0 * DISTURBANCE)


def chassis_forgets(kind: str, params: ChassisParams) -> bool:
    """Whether a chassis has no memory beyond its motion: the physics plant, as long as its brakes do not fade."""
    return kind == "physics" and params.constants.brake_loss_per_j == 0.0


def rows_to_simulate(held: Array, dt_s: float) -> Array:
    """Rows (n_rows,), bool, that are free, or at most WARM_UP_S before one that is."""
    reach = round(WARM_UP_S / dt_s)
    ahead = np.concatenate([np.cumsum(~held), np.full(reach + 1, int((~held).sum()))])
    before = np.concatenate([[0], ahead[: len(held)][:-1]])
    return ahead[reach : reach + len(held)] > before


def _constant_input(record: Any, value: float) -> Any:
    return value if record is None else record(*(value,) * len(record._fields))
