"""One compiled car with every effect of the catalogue in it, each neutral until its parameters say otherwise.

    commands -> effects A -> actuators, effects on their outputs -+-> reported outputs
                                                                  |
    measured outputs (or those) -> effects B -> chassis -> sensors -> effects on reports and INS -> what is compared

The chassis takes the *measured* outputs where there are any, so that a link is judged without the links before it. In a
row that is pinned it is told the measured speed, so that what it says is the rate of speed and the sideways motion that
follow from there; in a row that is not it runs free. Effects are Blocks in series at their ports, body changes are
constants of the plant: which of them are on is data, and nothing is compiled for a candidate.

[actuators] of the three channels of a graph, also of a car that has two: one that is asked for an acceleration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base import parts
from tunefree_hil.base.contracts import BodyChange, Effect, Latency, Port, make_effect
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block
from tunefree_hil.config.schema import ActuatorSpec, ModelSpec, VehicleSpec, value_of
from tunefree_hil.effects import catalogue
from tunefree_hil.gap.model.effect_chain import (
    PORTS_A,
    PORTS_B,
    PORTS_OUT,
    SCALAR_PORTS,
    Said,
    chain_of,
    said_of,
    three_of,
    undone,
)
from tunefree_hil.gap.model.history import Recent, ahead
from tunefree_hil.gap.model.kernels import INS_COLUMNS, SAID, TAKEN, WIDE, Bodies, Heads, make_heads, make_ride
from tunefree_hil.learn.evaluation.free_run import plant_of
from tunefree_hil.learn.evaluation.motion import actuator_params
from tunefree_hil.plant.actuation.acceleration_interface import FULL_MPS2
from tunefree_hil.plant.actuation.actuators import ActuatorParams, init_actuator
from tunefree_hil.plant.constants import LEAST

Array = np.ndarray
# 'steer_lag.tau_s'; 'plant.drive_force_n' (log of a factor); 'actuator.steer.lag_s' (the same); 'clock.steer_s', by
# which the car feels an output later than its report says, 'clock.ins_s', by which the INS is later than it says;
# 'linkage.bend', which is extra to the plant's linkage_bend
Values = Mapping[str, float]

LINKAGE, BEND = "linkage.bend", "linkage_bend"
CHANNELS = ("throttle", "brake", "steer")


class Inputs(NamedTuple):
    """A drive as the graph takes it, a row a tick: commands and measured outputs [n, 3] (throttle, brake, steer), gear,
    speed, yaw rate, side speed and rate of speed [n]; pinned [n]: where the chassis is told these four.

    measured: which channels' outputs the chassis takes as they were reported. echoed: whether the commands were read
    off the reports' own frames. by_ins: whether the speed is the INS's.
    """

    commands: Array
    outputs: Array
    gear: Array
    speed_mps: Array
    yaw_rate_radps: Array
    side_speed_mps: Array
    rate_mps2: Array
    pinned: Array
    measured: tuple[bool, bool, bool]
    echoed: tuple[bool, bool, bool]
    by_ins: bool
    dt_s: float


effects = cache(catalogue)  # read once a process; who looks an effect up by name need not keep it


class Graph:
    """The car of a model folder with the catalogue in it.

    can: the effects that its plant can have; cannot: the others, with the reason. The model's own [[effects]] are in
    series before those of the catalogue, so that a value is extra to the model (interfaces 4). Raises InputError for a
    plant that cannot be told a measured motion.
    """

    def __init__(self, model: ModelSpec, vehicle: VehicleSpec, dt_s: float) -> None:
        self.model, self.vehicle, self.dt_s = model, vehicle, dt_s
        self.plant = plant_of(model)
        self.rest = vehicle.nominal.rest_pedal_frac
        self.ratio = {**self.plant.defaults, **model.plant.params}["steer_ratio"]
        self._cached: dict[Any, Any] = {}
        self.can, self.cannot = self._able()
        own = heard(model)
        self._own = {name: self._made(effect, params) for name, (effect, params) in own.items()}
        ports = {name: effect.port for name, (effect, _) in own.items()} | {n: e.port for n, e in self.can.items()}
        self._neutral = self._own | {name: self._made(effect, {}) for name, effect in self.can.items()}
        blocks = {name: made for name, made in self._neutral.items() if isinstance(made, Block)}
        self._chains = {
            port: chain_of([name for name in blocks if ports[name] is port], blocks)
            for port in (*SCALAR_PORTS, Port.REPORT, Port.INS)
        }
        chassis = self.plant.make(model.plant.params, BodyChange())
        step = {port: self._chains[port].block.step for port in (*SCALAR_PORTS, Port.REPORT, Port.INS)}
        self._heads = make_heads([step[port] for port in (*PORTS_A, *PORTS_OUT, Port.REPORT)])
        self._ride = make_ride(
            [step[port] for port in (*PORTS_B, Port.REPORT, Port.INS)], chassis.step, self.plant.observe
        )
        self._shifts = {name for name in self._chains[Port.REPORT].names if self._is_shift(name)}
        self._own_said = [self._said(self._own[name]) for name in self._chains[Port.REPORT].names if name in self._own]
        self._recent: dict[str, Recent] = {"heads": Recent(), "ride": Recent()}

    def _able(self) -> tuple[dict[str, Effect], dict[str, str]]:
        """Which effects this plant can have: those that change a body are tried on it."""
        can, cannot = {}, {}
        for name, effect in effects().items():
            if is_unheard(self.model, effect.port):
                cannot[name] = UNHEARD
                continue
            try:
                made = self._made(effect, {key: _tried(effect, key) for key in effect.neutral})
                if not isinstance(made, Block):
                    self.plant.make(self.model.plant.params, made(BodyChange()))
                elif effect.port is Port.REPORT:
                    self._said(self._typical(effect))
                can[name] = effect
            except InputError as error:
                cannot[name] = error.message
        return can, cannot

    def _made(self, effect: Effect, params: Mapping[str, float]) -> Any:
        rest = self.rest if effect.port.value.startswith(("throttle", "brake")) else 0.0
        return make_effect(effect, params, rest=rest)

    def run(self, x: Inputs, values: Values) -> Array:
        """What the car shows, [n, SHOWN]. Row 0 is not simulated. Raises InputError for values that make no effect.

        Where outputs were measured, what is before them and what is behind them do not feel each other: the half whose
        values are those of a run just before is not simulated again.
        """
        blocks, change = self._blocks(values)
        ahead_of = {key: value for key, value in values.items() if self._is_head(key)}
        said = self._recent["heads"].found(x, ahead_of)
        if said is None:
            said = self._recent["heads"].keep(x, ahead_of, self._run_heads(x, blocks, values))
        behind = (
            values if not all(x.measured) else {k: v for k, v in values.items() if not self._is_head(k, alone=True)}
        )
        shown = self._recent["ride"].found(x, behind)
        if shown is None:
            shown = self._recent["ride"].keep(x, behind, self._run_ride(x, blocks, change, values, said))
        shown = shown.copy()
        shown[:, :3] = said[:, :3]
        return shown

    def _is_head(self, key: str, *, alone: bool = False) -> bool:
        """Whether a value is felt by reported outputs; alone: and by nothing behind them."""
        name = key.partition(".")[0]
        if name == "actuator":
            return True
        port = self.can[name].port if name in self.can else None
        return port in (*PORTS_A, *PORTS_OUT) or (not alone and port is Port.REPORT and name in self._shifts)

    def _is_shift(self, name: str) -> bool:
        """Whether an effect on the report touches the outputs in it, by delay or by amount."""
        block = self._neutral[name]
        if isinstance(block.params, Latency):
            return True
        said = self._said(self._typical(self.can[name]) if name in self.can else block)
        return bool(said.shift.any() or (said.gain != 1.0).any())

    def _said(self, block: Block) -> Said:
        return said_of(block, self.dt_s)

    def _typical(self, effect: Effect) -> Block:
        """An effect as large as its priors call usual."""
        return self._made(effect, {key: prior.typical for key, prior in effect.priors.items()})

    def _run_heads(self, x: Inputs, blocks: dict[str, Block], values: Values) -> Array:
        commands = self._commands(x, blocks)
        taken = np.zeros((len(commands), TAKEN))
        taken[:, :3], taken[:, 6] = commands, x.gear
        own = tuple(self._actuator(i, float(commands[0, i]), values) for i in range(3))
        before, ends = (three_of(self._chains, ports, blocks, self.dt_s) for ports in (PORTS_A, PORTS_OUT))
        report = self._chains[Port.REPORT]
        params = Heads(before[0], own, ends[0], report.params(blocks))  # pyright: ignore[reportArgumentType]
        begin = tuple(init_actuator(one, self.dt_s) for one in own)
        state = Heads(before[1], begin, ends[1], report.state(blocks, self.dt_s))  # pyright: ignore[reportArgumentType]
        said = np.zeros(len(taken) * SAID)
        self._heads(params, state, taken.ravel(), said, x.dt_s)
        found = said.reshape(-1, SAID)
        found[0] = found[min(1, len(found) - 1)]
        return found

    def _run_ride(self, x: Inputs, blocks: dict[str, Block], change: BodyChange, values: Values, said: Array) -> Array:
        taken = self._taken(x, blocks, values, said)
        chassis = self.plant.make(scaled(self.model.plant.params, self.plant.defaults, values), change)
        own = chassis.params._replace(start=chassis.params.start._replace(speed_mps=float(taken[0, 7])))
        behind, states = three_of(self._chains, PORTS_B, blocks, self.dt_s)
        report, ins = self._chains[Port.REPORT], self._chains[Port.INS]
        params = Bodies(behind, own, report.params(blocks), ins.params(blocks))
        begin = chassis.init(own, self.dt_s)
        state = Bodies(states, begin, report.state(blocks, self.dt_s), ins.state(blocks, self.dt_s))
        shown = np.zeros(len(taken) * WIDE)
        self._ride(params, state, taken.ravel(), shown, x.dt_s)
        found = shown.reshape(-1, WIDE)
        found[0] = found[min(1, len(found) - 1)]
        late = values.get("clock.ins_s", 0.0) / x.dt_s
        if late:
            found[:, INS_COLUMNS] = ahead(found[:, INS_COLUMNS], -late)
        return found

    def _blocks(self, values: Values) -> tuple[dict[str, Block], BodyChange]:
        """Every Block with its params, and all body changes together."""
        on: dict[str, dict[str, float]] = {}
        for key, value in values.items():
            name, _, parameter = key.partition(".")
            if name in self.can:
                on.setdefault(name, {})[parameter] = float(value)
        made = self._neutral | {name: self._kept(name, params) for name, params in on.items()}
        change = BodyChange()
        for one in made.values():
            if not isinstance(one, Block):
                change = one(change)
        return {name: one for name, one in made.items() if isinstance(one, Block)}, change

    def _kept(self, name: str, params: dict[str, float]) -> Any:
        """An effect once made is kept: some wrap kernels, which takes longer than a drive."""
        key = (name, tuple(sorted(params.items())))
        if key not in self._cached:
            if len(self._cached) > 4000:
                self._cached.clear()
            self._cached[key] = self._made(self.can[name], params)
        return self._cached[key]

    def _actuator(self, i: int, initial: float, values: Values) -> ActuatorParams:
        """A channel's own numbers, moved by 'actuator.<channel>.<number>'; times and gains by a log, the rest added."""
        name = CHANNELS[i]
        rest = 0.0 if name == "steer" else self.rest
        own = actuator_params(channel_spec(self.model, name), rest, initial)
        for key in ("dead_time_s", "offset"):
            moved = getattr(own, key) + values.get(f"actuator.{name}.{key}", 0.0)
            own = own._replace(**{key: max(moved, 0.0) if key == "dead_time_s" else moved})
        for key in ("lag_s", "natural_hz", "damping", "gain"):
            own = own._replace(**{key: getattr(own, key) * math.exp(values.get(f"actuator.{name}.{key}", 0.0))})
        return own

    def _commands(self, x: Inputs, blocks: dict[str, Block]) -> Array:
        """Commands [n, 3] when they were given: those read off a late report's frame are put back."""
        late = self._late(Port.REPORT, blocks) / x.dt_s
        if not late:
            return x.commands
        columns = zip(x.commands.T, x.echoed, strict=True)
        return np.stack([ahead(one, late) if echoed else one for one, echoed in columns], axis=1)

    def _taken(self, x: Inputs, blocks: dict[str, Block], values: Values, said: Array) -> Array:
        """Rows of inputs; what a late or shifted report says of the past is put back to where it was. said: of the
        actuators, where they are not measured.
        """
        taken = np.empty((len(x.gear), TAKEN))
        taken[:, :3], taken[:, 6], taken[:, 11] = self._commands(x, blocks), x.gear, x.pinned
        late = self._late(Port.REPORT, blocks) / x.dt_s
        outputs = self._unshifted(x.outputs, blocks)
        for i, name in enumerate(CHANNELS):
            moved = late - values.get(f"clock.{name}_s", 0.0) / x.dt_s
            taken[:, 3 + i] = ahead(outputs[:, i], moved) if x.measured[i] else said[:, 3 + i]
        taken[:, 5] *= 1.0 - values.get(LINKAGE, 0.0) * (taken[:, 5] / self.ratio) ** 2
        late = self._late(Port.INS if x.by_ins else Port.REPORT, blocks) / x.dt_s
        for i, motion in enumerate((x.speed_mps, x.yaw_rate_radps, x.side_speed_mps, x.rate_mps2)):
            taken[:, 7 + i] = ahead(motion, late)
        return taken

    def _late(self, port: Port, blocks: dict[str, Block]) -> float:
        """Seconds by which a port's values come late, by the model's own effects and by those that are tried."""
        some = [blocks[name].params for name in self._chains[port].names]
        return sum(params.delay_s for params in some if isinstance(params, Latency))

    def _unshifted(self, outputs: Array, blocks: dict[str, Block]) -> Array:
        """Measured outputs as they were before effects on the report touched them, the last in series undone first; the
        model's own are the first in series.
        """
        names = [name for name in self._chains[Port.REPORT].names if name in self._shifts and name not in self._own]
        tried = [self._said(blocks[name]) for name in names if blocks[name] is not self._neutral[name]]
        return undone(outputs, [*self._own_said, *tried])


def _tried(effect: Effect, parameter: str) -> float:
    """A value off neutral, to see whether a plant takes it."""
    prior = effect.priors.get(parameter)
    return effect.neutral[parameter] if prior is None or prior.times else prior.typical


ADDED = ("zero_frac", "rise_per_frac")


def scaled(params: Mapping[str, float], defaults: Mapping[str, float], values: Values) -> dict[str, float]:
    """[plant.params] with 'plant.<name>' applied: the log of a factor, an amount for what may be nothing."""
    found = {**defaults, **params}
    for key, value in values.items():
        group, _, name = key.partition(".")
        if group == "plant" and name in found:
            more = found[name] + value if name.endswith(ADDED) else found[name] * math.exp(value)
            found[name] = max(more, LEAST.get(name, -math.inf))
    return found


ACCEL, PEDALS = "accel", ("throttle", "brake")
UNHEARD = "the car is asked for an acceleration: it has no pedal before its actuators"


def is_known(model: ModelSpec, name: str) -> bool:
    """Whether a model says anything of a channel: 'throttle', 'brake', 'steer'."""
    return name in model.actuators or (name != "steer" and ACCEL in model.actuators)


def is_by_accel(model: ModelSpec) -> bool:
    """Whether a model's car is asked for an acceleration and has no pedals of its own."""
    return ACCEL in model.actuators and not any(name in model.actuators for name in PEDALS)


def is_unheard(model: ModelSpec, port: Port) -> bool:
    """Whether an effect at a port does nothing to a model's car: what is before the pedals of one that has none."""
    return port in (Port.THROTTLE_A, Port.THROTTLE_OUT, Port.BRAKE_A, Port.BRAKE_OUT) and is_by_accel(model)


def heard(model: ModelSpec) -> dict[str, tuple[Effect, dict[str, float]]]:
    """A model's own effects that its car hears, each with its parameters, by place in the list and name."""
    loaded = [(spec, parts.load("tunefree_hil.effects", spec.name, "EFFECT")) for spec in model.effects]
    return {
        f"{i} {spec.name}": (effect, spec.params)
        for i, (spec, effect) in enumerate(loaded)
        if not is_unheard(model, effect.port)
    }


def channel_spec(model: ModelSpec, name: str) -> ActuatorSpec:
    """[actuators] of a channel; of a pedal of a car that is asked for an acceleration, its channel 'accel' in duty.

    Dead time and lag do the same to either pedal as to their difference (plant/actuation/acceleration_interface.py); what is an amount, in
    m/s2 there, is one of full duty here; an offset is the throttle's.
    """
    if name in model.actuators or not is_known(model, name):
        return model.actuators.get(name, ActuatorSpec())
    accel = model.actuators[ACCEL]
    amounts = {key: float(value_of(getattr(accel, key))) / FULL_MPS2 for key in ("rate_limit", "dead_band", "offset")}
    return ActuatorSpec(
        dead_time_s=accel.dead_time_s,
        order=accel.order,
        lag_s=accel.lag_s,
        natural_hz=accel.natural_hz,
        damping=accel.damping,
        rate_limit=amounts["rate_limit"],
        dead_band=amounts["dead_band"],
        gain=accel.gain,
        offset=amounts["offset"] if name == "throttle" else 0.0,
    )
