"""One compiled car with every effect of the catalogue in it, each neutral until its parameters say otherwise.

    commands -> effects A -> actuators -+-> reported outputs
                                        |
    measured outputs (or those) -> effects B -> chassis -> sensors -> effects on reports and INS -> what is compared

The chassis takes the *measured* outputs where there are any, so that a link is judged without the links before it. In a
row that is pinned it is told the measured speed, so that what it says is the rate of speed and the sideways motion that
follow from there; in a row that is not it runs free. Effects are Blocks in series at their ports, body changes are
constants of the plant: which of them are on is data, and nothing is compiled for a candidate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base import parts
from tunefree_hil.base.contracts import BodyChange, Effect, Latency, Port, make_effect
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block, kernel, series
from tunefree_hil.base.records import Report
from tunefree_hil.config.schema import ActuatorSpec, ModelSpec, VehicleSpec
from tunefree_hil.gap.ride import INS_COLUMNS, WIDE, Params, State, make_ride
from tunefree_hil.learn.free_run import plant_of
from tunefree_hil.learn.motion import actuator_params
from tunefree_hil.plant.actuators import ActuatorParams, init_actuator

Array = np.ndarray
# 'steer_lag.tau_s'; 'plant.drive_force_n' (log of a factor); 'actuator.steer.lag_s' (the same); 'clock.steer_s', by
# which the car feels an output later than its report says, 'clock.ins_s', by which the INS is later than it says
Values = Mapping[str, float]

CHANNELS = ("throttle", "brake", "steer")
SCALAR_PORTS = (Port.THROTTLE_A, Port.BRAKE_A, Port.STEER_A, Port.THROTTLE_B, Port.BRAKE_B, Port.STEER_B)


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


@kernel
def _same(params: float, state: float, x: Any, dt_s: float) -> tuple[float, Any]:
    return state, x


def _nothing() -> Block:
    return Block(lambda params, dt_s: 0.0, _same, 0.0)


class Chain(NamedTuple):
    """The effects of a port in series: their steps compiled once, params and states laid out for them by name."""

    names: tuple[str, ...]
    block: Block

    def params(self, blocks: Mapping[str, Block]) -> Any:
        """Params for the chain's step, each effect's from its Block."""
        return _nested([blocks[name].params for name in self.names])

    def state(self, blocks: Mapping[str, Block], dt_s: float) -> Any:
        """The state that the chain starts with."""
        return _nested([blocks[name].init(blocks[name].params, dt_s) for name in self.names])


def _nested(some: Sequence[Any]) -> Any:
    """As `series` nests: ((a, b), c)."""
    if not some:
        return 0.0
    whole = some[0]
    for one in some[1:]:
        whole = (whole, one)
    return whole


def _chain(names: Sequence[str], blocks: Mapping[str, Block]) -> Chain:
    if not names:
        return Chain((), _nothing())
    whole = blocks[names[0]]
    for name in names[1:]:
        whole = series(whole, blocks[name])
    return Chain(tuple(names), whole)


@cache
def effects() -> dict[str, Effect]:
    """The catalogue: every file of effects/, by name."""
    package = "tunefree_hil.effects"
    return {name: parts.load("tunefree_hil.effects", name, "EFFECT") for name in parts.names(package)}


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
        self._cached: dict[Any, Any] = {}
        self.can, self.cannot = self._able()
        own = {f"{i} {spec.name}": (effects()[spec.name], spec.params) for i, spec in enumerate(model.effects)}
        self._own = {name: self._made(effect, params) for name, (effect, params) in own.items()}
        ports = {name: effect.port for name, (effect, _) in own.items()} | {n: e.port for n, e in self.can.items()}
        self._neutral = self._own | {name: self._made(effect, {}) for name, effect in self.can.items()}
        blocks = {name: made for name, made in self._neutral.items() if isinstance(made, Block)}
        self._chains = {
            port: _chain([name for name in blocks if ports[name] is port], blocks)
            for port in (*SCALAR_PORTS, Port.REPORT, Port.INS)
        }
        chassis = self.plant.make(model.plant.params, BodyChange())
        steps = [self._chains[port].block.step for port in (*SCALAR_PORTS, Port.REPORT, Port.INS)]
        self._ride = make_ride(steps, chassis.step, self.plant.observe)

    def _able(self) -> tuple[dict[str, Effect], dict[str, str]]:
        """Which effects this plant can have: those that change a body are tried on it."""
        can, cannot = {}, {}
        for name, effect in effects().items():
            try:
                made = self._made(effect, {key: _tried(effect, key) for key in effect.neutral})
                if not isinstance(made, Block):
                    self.plant.make(self.model.plant.params, made(BodyChange()))
                can[name] = effect
            except InputError as error:
                cannot[name] = error.message
        return can, cannot

    def _made(self, effect: Effect, params: Mapping[str, float]) -> Any:
        rest = self.rest if effect.port.value.startswith(("throttle", "brake")) else 0.0
        return make_effect(effect, params, rest=rest)

    def run(self, x: Inputs, values: Values) -> Array:
        """What the car shows, [n, SHOWN]. Row 0 is not simulated. Raises InputError for values that make no effect."""
        blocks, change = self._blocks(values)
        taken = self._taken(x, blocks, values)
        params, state = self._begin(taken, blocks, change, values)
        shown = np.zeros(len(taken) * WIDE)
        source = tuple(1.0 if one else 0.0 for one in x.measured)
        self._ride(params, state, taken.ravel(), shown, source, x.dt_s)
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

    def _begin(self, taken: Array, blocks: dict[str, Block], change: BodyChange, values: Values) -> tuple[Any, Any]:
        chains, dt_s = self._chains, self.dt_s
        chassis = self.plant.make(scaled(self.model.plant.params, self.plant.defaults, values), change)
        start = chassis.params.start._replace(speed_mps=float(taken[0, 7]))
        own = chassis.params._replace(start=start)
        throttle, brake, steer = (self._actuator(i, float(taken[0, i]), values) for i in range(3))
        channels = (throttle, brake, steer)
        groups = [chains[port].params(blocks) for port in SCALAR_PORTS]
        states = [chains[port].state(blocks, dt_s) for port in SCALAR_PORTS]
        params = Params(
            (groups[0], groups[1], groups[2]), channels, (groups[3], groups[4], groups[5]), own,
            chains[Port.REPORT].params(blocks), chains[Port.INS].params(blocks),
        )  # fmt: skip
        state = State(
            (states[0], states[1], states[2]),
            (init_actuator(throttle, dt_s), init_actuator(brake, dt_s), init_actuator(steer, dt_s)),
            (states[3], states[4], states[5]),
            chassis.init(own, dt_s), chains[Port.REPORT].state(blocks, dt_s), chains[Port.INS].state(blocks, dt_s),
        )  # fmt: skip
        return params, state

    def _actuator(self, i: int, initial: float, values: Values) -> ActuatorParams:
        """A channel's own numbers, moved by 'actuator.<channel>.<number>'; times and gains by a log, the rest added."""
        name = CHANNELS[i]
        rest = 0.0 if name == "steer" else self.rest
        own = actuator_params(self.model.actuators.get(name, ActuatorSpec()), rest, initial)
        for key in ("dead_time_s", "offset"):
            moved = getattr(own, key) + values.get(f"actuator.{name}.{key}", 0.0)
            own = own._replace(**{key: max(moved, 0.0) if key == "dead_time_s" else moved})
        for key in ("lag_s", "natural_hz", "damping", "gain"):
            own = own._replace(**{key: getattr(own, key) * math.exp(values.get(f"actuator.{name}.{key}", 0.0))})
        return own

    def _taken(self, x: Inputs, blocks: dict[str, Block], values: Values) -> Array:
        """Rows of inputs; what a late or shifted report says of the past is put back to where it was."""
        commands, outputs = x.commands, self._unshifted(x, x.outputs, blocks)
        clocks = [values.get(f"clock.{name}_s", 0.0) / x.dt_s for name in CHANNELS]
        if any(clocks):
            outputs = np.stack([ahead(one, -late) for one, late in zip(outputs.T, clocks, strict=True)], axis=1)
        late = self._late(Port.REPORT, blocks) / x.dt_s
        motion = np.stack([x.speed_mps, x.yaw_rate_radps, x.side_speed_mps, x.rate_mps2], axis=1)
        if late:
            outputs = ahead(outputs, late)
            commands = np.stack(
                [ahead(one, late) if echoed else one for one, echoed in zip(commands.T, x.echoed, strict=True)], axis=1
            )
        late = self._late(Port.INS if x.by_ins else Port.REPORT, blocks) / x.dt_s
        if late:
            motion = ahead(motion, late)
        return np.column_stack([commands, outputs, x.gear, motion, x.pinned]).astype(np.float64)

    def _late(self, port: Port, blocks: dict[str, Block]) -> float:
        names = self._chains[port].names
        return sum(blocks[n].params.delay_s for n in names if isinstance(blocks[n].params, Latency) and n in self.can)

    def _unshifted(self, x: Inputs, outputs: Array, blocks: dict[str, Block]) -> Array:
        """Measured outputs without what effects on the report add to them: m - (E(m) - m) for each that is on."""
        chain = self._chains[Port.REPORT].names
        on = [n for n in chain if blocks[n] is not self._neutral[n] and not isinstance(blocks[n].params, Latency)]
        for name in on:
            block = blocks[name]
            state = block.init(block.params, x.dt_s)
            _, said = block.step(block.params, state, Report(*(1.0,) * len(Report())), x.dt_s)
            said = np.array([said.throttle_frac, said.brake_frac, said.steer_rad]) - 1.0
            outputs = outputs - said  # an offset; no effect of the catalogue scales or filters an output
        return outputs


def _tried(effect: Effect, parameter: str) -> float:
    """A value off neutral, to see whether a plant takes it."""
    prior = effect.priors.get(parameter)
    return effect.neutral[parameter] if prior is None or prior.times else prior.typical


def scaled(params: Mapping[str, float], defaults: Mapping[str, float], values: Values) -> dict[str, float]:
    """[plant.params] with 'plant.<name>' applied: the log of a factor, an amount for what is a place on the pedal."""
    found = {**defaults, **params}
    for key, value in values.items():
        group, _, name = key.partition(".")
        if group == "plant" and name in found:
            found[name] = found[name] + value if name.endswith("zero_frac") else found[name] * math.exp(value)
    return found


def ahead(values: Array, rows: float) -> Array:
    """A signal `rows` rows earlier, parts of a row by a straight line; held at its end. [n] or [n, k]."""
    at = np.clip(np.arange(len(values)) + rows, 0.0, len(values) - 1.0)
    low = np.floor(at).astype(np.int64)
    high = np.minimum(low + 1, len(values) - 1)
    share = at - low
    share = share if values.ndim == 1 else share[:, None]
    return values[low] + share * (values[high] - values[low])
