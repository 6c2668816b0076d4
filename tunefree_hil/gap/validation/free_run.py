"""The whole car of a model folder, run over a recording: recorded commands in, on its own wherever it is not told.

Actuators, effects, chassis, sensors are the bench's own (plant/vehicle.py `assemble`), so that what is proved is what a
bench drives. In rows that are held the chassis is told the measured motion; in the others it runs free, without being
put right. Noise is left out: it is the measurement's.

Whether a car forgets within WARM_S what it did before, so that a drive may be begun anew so long before a block.

Free runs over blocks that choose (gap/validation/update_selection.py) drive no more of a recording than they must. What is behind a dead time
or a lag is forgotten after a few of them; play and dry friction keep where they last came from, brakes their heat, a
learned cell what it likes. Nothing is taken on trust: every part is driven far to one side and far to the other, then
held at rest, and must say the same.
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
from tunefree_hil.gap.measured.chain import Opened, commanded
from tunefree_hil.gap.model.graph import CHANNELS, channel_spec, is_unheard
from tunefree_hil.gap.model.history import ahead
from tunefree_hil.learn.evaluation.free_run import plant_of
from tunefree_hil.learn.evaluation.motion import actuator_params
from tunefree_hil.plant.actuation.actuators import ActuatorParams, actuator
from tunefree_hil.plant.measurement.sensors import noise_table
from tunefree_hil.plant.types import BodyInput, ChassisParams, Driver
from tunefree_hil.plant.vehicle import Body, assemble, first_output, for_episode

Array = np.ndarray

REPORTED = tuple(f"report.{name}" for name in Report._fields)
PLACED = tuple(f"ins.{name}" for name in Ins._fields)
STILL_MPS = 0.05  # of a measured speed, of a road car: less is a wheel that rattles, and brakes would stop it each tick
COURSE_S, LEAST_WAY_M = 4.0, 2.0  # places tell a course over such a time, once they are so far apart


class Car(NamedTuple):
    """A model folder's car. late_s: by which its own effects make reports and INS late, (reports, INS). forgets:
    whether nothing of it remembers longer than a few seconds what it did (gap/validation/free_run.py).
    """

    body: Body
    observe: Any
    rest: float
    late_s: tuple[float, float]
    forgets: bool


def car_of(model: ModelSpec, vehicle: VehicleSpec, opened: Opened, more: Sequence[EffectSpec] = ()) -> Car:
    """The car for a recording; `more`: effects behind the model's own, as a bench file has them.

    A car that is asked for an acceleration is driven by two pedals (gap/model/graph.py), as it is searched; what a bench
    would not hear is left out. A channel whose commands acted nowhere in a recording (a person drove) has no actuator:
    the reported output is what acts. An INS that is late by the vehicle's folder is no part of the car: recordings are
    put right by that (gap/measured/chain.py).
    """
    rest, plant = vehicle.nominal.rest_pedal_frac, plant_of(model)
    channels = {}
    for name, acts in zip(CHANNELS, commanded(opened), strict=True):
        idle = 0.0 if name == "steer" else rest
        channels[name] = (
            actuator_params(channel_spec(model, name), idle, idle) if acts else ActuatorParams(rest=idle, initial=idle)
        )
    made = [_made(spec, rest) for spec in (*model.effects, *more)]
    effects = [(port, one) for port, one in made if not is_unheard(model, port)]
    body = assemble(plant, model.plant.params, channels, effects=effects, rest_frac=(rest, rest), dt_s=opened.dt_s)
    biased = for_episode(body, body.block.params.chassis.start, noise_table({}, model.bias, 0, 0))
    late = [sum(made.params.delay_s for port, made in effects if port is where and _is_late(made)) for where in _ENDS]
    parts_of_it = [*effects, *((None, actuator(one)) for one in channels.values())]
    forgets = chassis_forgets(model.plant.kind, biased.block.params.chassis) and all(
        is_forgotten(one, port, 0.0 if port is not None and port.value.startswith("steer") else rest, opened.dt_s)
        for port, one in parts_of_it
    )
    return Car(biased, plant.observe, rest, (late[0], late[1]), forgets)


_ENDS = (Port.REPORT, Port.INS)


def _is_late(made: Any) -> bool:
    return isinstance(made, Block) and isinstance(made.params, Latency)


def _made(spec: EffectSpec, rest: float) -> tuple[Port, Any]:
    effect = parts.load("tunefree_hil.effects", spec.name, "EFFECT")
    pedal = effect.port.value.startswith(("throttle", "brake"))
    return effect.port, make_effect(effect, spec.params, rest=rest if pedal else 0.0, name=spec.name)


def run_over(car: Car, opened: Opened, held: Array, *, brief: bool = False) -> Mapping[str, Array]:
    """What the car says in every row of a recording, by record field ('report.speed_mps', 'ins.x_m'), [n] each.

    held: bool [n], rows at which the chassis is told what was measured. What a run says that comes to no number is NaN,
    to the end. brief: of a car that forgets, no more is driven than rows that are not held and what warms it up before
    them; NaN elsewhere.
    """
    told, motions, gears = _told(car, opened)
    body, dt_s = car.body, opened.dt_s
    start = body.block.params.chassis.start._replace(speed_mps=float(opened.inputs.speed_mps[0]))
    body = for_episode(body, start, body.block.params.sensors.noise)
    state, _ = first_output(body, dt_s)
    step, params, observe = body.block.step, body.block.params, car.observe
    nobody, road = Driver(car.rest, car.rest), Disturbance(0.0, 1.0)
    rows, seen = np.full((opened.ticks, len(REPORTED) + len(PLACED)), np.nan), held.tolist()
    driven = needed(held, dt_s) if brief and car.forgets else np.ones(opened.ticks, dtype=bool)
    for k in np.flatnonzero(driven[1:]).tolist():
        k += 1
        if seen[k - 1]:
            state = state._replace(chassis=observe(state.chassis, motions[k - 1]))
        command = Command._make((*told[k], gears[k], np.nan, np.nan))
        try:
            state, out = step(params, state, BodyInput(command, nobody, road), dt_s)
        except (ArithmeticError, ValueError):  # Python's mathematics refuse what a compiled car says no number to
            break
        rows[k] = (*out.measurement.report, *out.measurement.ins)
    rows[0] = rows[min(1, len(rows) - 1)]
    return dict(zip((*REPORTED, *PLACED), rows.T, strict=True))


def _told(car: Car, opened: Opened) -> tuple[list[list[float]], list[Motion], list[float]]:
    """(commands, measured motions, gears) of the rows; what a late report says of the past is put back there."""
    x = opened.inputs
    by_report, by_ins = (late / x.dt_s for late in car.late_s)
    columns = [ahead(x.commands[:, i], by_report) if x.echoed[i] else x.commands[:, i] for i in range(3)]
    speed = np.where(np.abs(x.speed_mps) < STILL_MPS * opened.pace, 0.0, x.speed_mps)
    motion = np.column_stack([*pose_of(opened), speed, x.side_speed_mps, x.yaw_rate_radps, x.rate_mps2])
    motion = ahead(motion, by_ins if x.by_ins else by_report)
    motions = [Motion._make((*row[:6], 0.0, 0.0, row[6], 0.0, 0.0, 0.0, 0.0)) for row in motion.tolist()]
    return np.stack(columns, axis=1).tolist(), motions, x.gear.tolist()


def pose_of(opened: Opened) -> tuple[Array, Array, Array]:
    """(x, y, heading) of the rear axle as measured. Without an INS that says them they are summed up from speed and yaw
    rate, about an origin of their own; where places were measured and no heading, it is the way that the places go.
    """
    speed, dt_s = opened.inputs.speed_mps, opened.dt_s
    placed = opened.has("ins.x_m", "ins.y_m")
    if opened.has("ins.heading_rad"):
        heading = opened.signals["ins.heading_rad"].values
    else:
        heading = np.cumsum(opened.inputs.yaw_rate_radps) * dt_s
        heading = heading + (_turned(opened, heading) if placed else 0.0)
    if placed:
        return opened.signals["ins.x_m"].values, opened.signals["ins.y_m"].values, heading
    return np.cumsum(speed * np.cos(heading)) * dt_s, np.cumsum(speed * np.sin(heading)) * dt_s, heading


def _turned(opened: Opened, heading: Array) -> Array:
    """By how much a summed-up heading is turned against the way that the measured places go, rad [n]; means over
    COURSE_S, weighted by distance. The rear axle, whose places they are, goes where the car heads but for its slip.
    """
    x_m, y_m = (opened.signals[name].values for name in ("ins.x_m", "ins.y_m"))
    way = (np.gradient(x_m) + 1j * np.gradient(y_m)) * opened.moving
    window = max(min(round(COURSE_S / opened.dt_s), opened.ticks), 1)
    mean = np.convolve(way * np.exp(-1j * heading), np.ones(window), "same")
    clear = np.flatnonzero(np.abs(mean) > LEAST_WAY_M)
    if not len(clear):
        return np.zeros(opened.ticks)
    return np.interp(np.arange(opened.ticks), clear, np.unwrap(np.angle(mean[clear])))


WARM_S = 3.0  # a lag of 0.4 s has 5e-4 left of where it was then; most are a few hundredths
AWAY_S, AWAY = 3.0, 0.5  # how long and how far (duty, rad; 1 of what is reported) it is driven before
SAME = 1e-3  # of the difference before: what is left of it after WARM_S
FRAMES = {Port.REPORT: Report, Port.INS: Ins}


def is_forgotten(made: Any, port: Port | None, rest: float, dt_s: float) -> bool:
    """Whether an effect (what make_effect gave) or a channel (port None) forgets. Body changes are the chassis's."""
    if not isinstance(made, Block):
        return True
    record = FRAMES.get(port) if port is not None else None
    said = []
    for side in (-AWAY, AWAY):
        away, still = (_value(record, one) for one in (rest + side, rest))
        state = made.init(made.params, dt_s)
        out: Any = still
        for x, ticks in ((away, round(AWAY_S / dt_s)), (still, round(WARM_S / dt_s))):
            for _ in range(ticks):
                state, out = made.step(made.params, state, x, dt_s)
        said.append(np.asarray(out, dtype=float))
    return bool(np.abs(said[0] - said[1]).max() <= SAME * 2.0 * AWAY)


def chassis_forgets(kind: str, params: ChassisParams) -> bool:
    """Whether a chassis that is told its motion has no other past: the physics, as long as its brakes do not fade."""
    return kind == "physics" and params.constants.brake_loss_per_j == 0.0


def needed(held: np.ndarray, dt_s: float) -> np.ndarray:
    """Rows of a drive [n] that are free, or no more than WARM_S before one that is."""
    reach = round(WARM_S / dt_s)
    ahead = np.concatenate([np.cumsum(~held), np.full(reach + 1, int((~held).sum()))])
    before = np.concatenate([[0], ahead[: len(held)][:-1]])
    return ahead[reach : reach + len(held)] > before


def _value(record: Any, value: float) -> Any:
    return value if record is None else record(*(value,) * len(record._fields))
