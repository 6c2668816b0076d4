"""One compiled vehicle with every effect of the catalogue in it, each neutral until its parameters say otherwise.

    commands -> effects A -> actuators -> effects on outputs -+-> reported outputs
                                                              |
    measured outputs (or those) -> effects B -> chassis -> sensors -> effects on reports and INS -> comparison

The chassis takes the measured outputs where there are any, so that a link is judged without those before it. In a
pinned row it starts from the measured motion and gives the rates that follow; in other rows it runs freely. Effects are
Blocks in series at their ports, and body changes are constants of the plant: which of them are on is data, so nothing
is compiled for a candidate.
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
from tunefree_hil.base.records import Actuation
from tunefree_hil.config.schema import ActuatorSpec, ModelSpec, VehicleSpec, value_of
from tunefree_hil.effects import catalogue
from tunefree_hil.gap.model.effect_chain import (
    PORTS_A,
    PORTS_B,
    PORTS_OUT,
    SCALAR_PORTS,
    OutputMap,
    chain_effects,
    identify_output_map,
    join_channel_chains,
    undo_output_maps,
)
from tunefree_hil.gap.model.history import ResultCache, shift_earlier
from tunefree_hil.gap.model.kernels import (
    INS_COLUMNS,
    N_INPUTS,
    N_OUTPUTS,
    N_SIMULATED,
    NOT_USED,
    InputRow,
    make_actuator_loop,
    make_vehicle_loop,
)
from tunefree_hil.learn.evaluation.free_run import open_plant
from tunefree_hil.learn.evaluation.motion import actuator_params
from tunefree_hil.plant.actuation.acceleration_interface import FULL_MPS2
from tunefree_hil.plant.actuation.actuators import ActuatorParams, init_actuator
from tunefree_hil.plant.constants import LEAST
from tunefree_hil.plant.vehicle import BodyParams, BodyState

Array = np.ndarray
# Parameter values by key: 'steer_lag.tau_s' of an effect; 'plant.drive_force_n' and 'actuator.steer.lag_s', log of a
# factor; 'clock.steer_s', by which an output reaches the chassis later than its report; 'clock.ins_s', by which the
# INS is later than its time stamp; LINKAGE_BEND_KEY, in addition to the plant's own parameter
Values = Mapping[str, float]

LINKAGE_BEND_KEY, LINKAGE_BEND_PARAM = "linkage.bend", "linkage_bend"
CHANNELS = ("throttle", "brake", "steer")
MAX_CACHED_EFFECTS = 4000


class DriveInputs(NamedTuple):
    """A drive as the graph takes it, one row a tick.

    Args:
        commands, outputs: (n_rows, 3) of throttle, brake, steer; outputs as they were measured.
        gear: (n_rows,).
        speed_mps, yaw_rate_radps, side_speed_mps, speed_rate_mps2: (n_rows,), measured motion.
        is_pinned: (n_rows,), 1 where the chassis is set to the measured motion, else 0.
        has_output: whether the chassis takes the measured output, by channel.
        is_echoed: whether the commands were read from the report frames, by channel.
        uses_ins_speed: whether the speed is the INS's.
        dt_s: length of a tick.
    """

    commands: Array
    outputs: Array
    gear: Array
    speed_mps: Array
    yaw_rate_radps: Array
    side_speed_mps: Array
    speed_rate_mps2: Array
    is_pinned: Array
    has_output: tuple[bool, bool, bool]
    is_echoed: tuple[bool, bool, bool]
    uses_ins_speed: bool
    dt_s: float


load_catalogue = cache(catalogue)  # once a process


class EffectGraph:
    """The vehicle of a model folder with the catalogue in it.

    The model's own [[effects]] are in series before those of the catalogue, so that a value adds to the model.

    Attributes:
        supported: by name, the effects that the model's plant can have.
        unsupported: by name, why it cannot have the others.
    """

    def __init__(self, model: ModelSpec, vehicle: VehicleSpec, dt_s: float) -> None:
        """Compile the loops.

        Raises:
            InputError: the plant cannot be set to a measured motion.
        """
        self.model, self.vehicle, self.dt_s = model, vehicle, dt_s
        self.plant = open_plant(model)
        self.rest_frac = vehicle.nominal.rest_pedal_frac
        self.steer_ratio = {**self.plant.defaults, **model.plant.params}["steer_ratio"]
        self._cached: dict[Any, Any] = {}
        self.supported, self.unsupported = self._split_catalogue()
        own = load_model_effects(model)
        self._model_effects = {name: self._make(effect, params) for name, (effect, params) in own.items()}
        ports = {name: effect.port for name, (effect, _) in own.items()} | {
            name: effect.port for name, effect in self.supported.items()
        }
        self._neutral = self._model_effects | {name: self._make(effect, {}) for name, effect in self.supported.items()}
        blocks = {name: made for name, made in self._neutral.items() if isinstance(made, Block)}
        self._chains = {
            port: chain_effects([name for name in blocks if ports[name] is port], blocks)
            for port in (*SCALAR_PORTS, Port.REPORT, Port.INS)
        }
        chassis = self.plant.make(model.plant.params, BodyChange())
        effects = [(port, chain.block) for port, chain in self._chains.items()]
        self._run_actuators = make_actuator_loop(effects)
        self._run_vehicle = make_vehicle_loop(effects, chassis.step, self.plant.observe)
        report_effects = self._chains[Port.REPORT].names
        self._output_effects = {name for name in report_effects if self._changes_reported_outputs(name)}
        self._model_output_maps = [
            self._output_map(self._model_effects[name]) for name in report_effects if name in self._model_effects
        ]
        self._output_cache, self._motion_cache = ResultCache(), ResultCache()

    def _split_catalogue(self) -> tuple[dict[str, Effect], dict[str, str]]:
        """Supported effects, and why the others are not; effects that change a body are tried on the plant."""
        supported, unsupported = {}, {}
        for name, effect in load_catalogue().items():
            if is_inert_port(self.model, effect.port):
                unsupported[name] = NO_PEDAL
                continue
            try:
                made = self._make(effect, {key: _trial_value(effect, key) for key in effect.neutral})
                if not isinstance(made, Block):
                    self.plant.make(self.model.plant.params, made(BodyChange()))
                elif effect.port is Port.REPORT:
                    self._output_map(self._make_typical(effect))
                supported[name] = effect
            except InputError as error:
                unsupported[name] = error.message
        return supported, unsupported

    def _make(self, effect: Effect, params: Mapping[str, float]) -> Any:
        rest = self.rest_frac if effect.port.value.startswith(("throttle", "brake")) else 0.0
        return make_effect(effect, params, rest=rest)

    def simulate(self, x: DriveInputs, values: Values) -> Array:
        """Simulate a drive.

        Where outputs were measured, the parts before and after them do not influence each other: a half whose values
        are those of a recent run is not simulated again.

        Returns:
            (n_rows, len(SIMULATED_FIELDS)); row 0 is a copy of row 1.

        Raises:
            InputError: no effect has such values.
        """
        blocks, change = self._make_blocks(values)
        output_values = {key: value for key, value in values.items() if self._affects_outputs(key)}
        outputs = self._output_cache.get(x, output_values)
        if outputs is None:
            outputs = self._output_cache.store(x, output_values, self._simulate_actuators(x, blocks, values))
        motion_values = values
        if all(x.has_output):
            motion_values = {key: value for key, value in values.items() if not self._affects_outputs(key, only=True)}
        simulated = self._motion_cache.get(x, motion_values)
        if simulated is None:
            rows = self._simulate_vehicle(x, blocks, change, values, outputs)
            simulated = self._motion_cache.store(x, motion_values, rows)
        simulated = simulated.copy()
        simulated[:, :3] = outputs[:, :3]
        return simulated

    def _affects_outputs(self, key: str, *, only: bool = False) -> bool:
        """Whether a value changes reported outputs; only: and nothing after them."""
        name = key.partition(".")[0]
        if name == "actuator":
            return True
        port = self.supported[name].port if name in self.supported else None
        if port in (*PORTS_A, *PORTS_OUT):
            return True
        return not only and port is Port.REPORT and name in self._output_effects

    def _changes_reported_outputs(self, name: str) -> bool:
        """Whether an effect on the report changes the outputs in it, by delay or by amount."""
        block = self._neutral[name]
        if isinstance(block.params, Latency):
            return True
        typical = self._make_typical(self.supported[name]) if name in self.supported else block
        output_map = self._output_map(typical)
        return bool(output_map.shift.any() or (output_map.gain != 1.0).any())

    def _output_map(self, block: Block) -> OutputMap:
        return identify_output_map(block, self.dt_s)

    def _make_typical(self, effect: Effect) -> Block:
        """An effect with the typical values of its priors."""
        return self._make(effect, {key: prior.typical for key, prior in effect.priors.items()})

    def _simulate_actuators(self, x: DriveInputs, blocks: dict[str, Block], values: Values) -> Array:
        """Output rows, (n_rows, N_OUTPUTS)."""
        commands = self._issued_commands(x, blocks)
        empty = InputRow(*(np.zeros(len(commands)),) * N_INPUTS)
        rows = _stack_inputs(_replace_commands(empty, commands)._replace(gear=x.gear))
        actuators = tuple(self._actuator_params(i, float(commands[0, i]), values) for i in range(3))
        command_effects, output_effects = (
            join_channel_chains(self._chains, ports, blocks, self.dt_s) for ports in (PORTS_A, PORTS_OUT)
        )
        report = self._chains[Port.REPORT]
        params = BodyParams(
            front=((command_effects[0], actuators), output_effects[0]),
            behind=NOT_USED,
            chassis=NOT_USED,
            sensors=NOT_USED,
            ends=(report.params(blocks), NOT_USED),
            late_s=NOT_USED,
        )
        actuator_states = tuple(init_actuator(channel, self.dt_s) for channel in actuators)
        state = BodyState(
            front=((command_effects[1], actuator_states), output_effects[1]),
            behind=NOT_USED,
            chassis=NOT_USED,
            sensors=NOT_USED,
            ends=(report.state(blocks, self.dt_s), NOT_USED),
        )
        outputs = np.zeros(len(rows) * N_OUTPUTS)
        self._run_actuators(params, state, rows.ravel(), outputs, x.dt_s)
        return _fill_first_row(outputs.reshape(-1, N_OUTPUTS))

    def _simulate_vehicle(
        self, x: DriveInputs, blocks: dict[str, Block], change: BodyChange, values: Values, outputs: Array
    ) -> Array:
        """Simulated rows, (n_rows, N_SIMULATED), without the outputs."""
        inputs = self._vehicle_inputs(x, blocks, values, outputs)
        rows = _stack_inputs(inputs)
        chassis = self.plant.make(scale_plant_params(self.model.plant.params, self.plant.defaults, values), change)
        start = chassis.params.start._replace(speed_mps=float(inputs.speed_mps[0]))
        chassis_params = chassis.params._replace(start=start)
        effects, effect_states = join_channel_chains(self._chains, PORTS_B, blocks, self.dt_s)
        report, ins = self._chains[Port.REPORT], self._chains[Port.INS]
        params = BodyParams(
            front=NOT_USED,
            behind=effects,
            chassis=chassis_params,
            sensors=NOT_USED,
            ends=(report.params(blocks), ins.params(blocks)),
            late_s=NOT_USED,
        )
        state = BodyState(
            front=Actuation(0.0, 0.0, 0.0, 0.0),  # the loop sets it in every row
            behind=effect_states,
            chassis=chassis.init(chassis_params, self.dt_s),
            sensors=NOT_USED,
            ends=(report.state(blocks, self.dt_s), ins.state(blocks, self.dt_s)),
        )
        simulated = np.zeros(len(rows) * N_SIMULATED)
        self._run_vehicle(params, state, rows.ravel(), simulated, x.dt_s)
        simulated = _fill_first_row(simulated.reshape(-1, N_SIMULATED))
        delay = values.get("clock.ins_s", 0.0) / x.dt_s
        if delay:
            simulated[:, INS_COLUMNS] = shift_earlier(simulated[:, INS_COLUMNS], -delay)
        return simulated

    def _make_blocks(self, values: Values) -> tuple[dict[str, Block], BodyChange]:
        """Every Block with its params, and all body changes together."""
        changed: dict[str, dict[str, float]] = {}
        for key, value in values.items():
            name, _, parameter = key.partition(".")
            if name in self.supported:
                changed.setdefault(name, {})[parameter] = float(value)
        made = self._neutral | {name: self._make_cached(name, params) for name, params in changed.items()}
        change = BodyChange()
        for effect in made.values():
            if not isinstance(effect, Block):
                change = effect(change)
        return {name: effect for name, effect in made.items() if isinstance(effect, Block)}, change

    def _make_cached(self, name: str, params: dict[str, float]) -> Any:
        """An effect, from the cache if possible: some wrap kernels, which takes longer than a drive."""
        key = (name, tuple(sorted(params.items())))
        if key not in self._cached:
            if len(self._cached) > MAX_CACHED_EFFECTS:
                self._cached.clear()
            self._cached[key] = self._make(self.supported[name], params)
        return self._cached[key]

    def _actuator_params(self, i: int, initial: float, values: Values) -> ActuatorParams:
        """A channel's parameters with 'actuator.<channel>.<number>' applied: times and gains by the log of a factor."""
        name = CHANNELS[i]
        rest = 0.0 if name == "steer" else self.rest_frac
        params = actuator_params(channel_spec_from_model(self.model, name), rest, initial)
        for key in ("dead_time_s", "offset"):
            moved = getattr(params, key) + values.get(f"actuator.{name}.{key}", 0.0)
            params = params._replace(**{key: max(moved, 0.0) if key == "dead_time_s" else moved})
        for key in ("lag_s", "natural_hz", "damping", "gain"):
            factor = math.exp(values.get(f"actuator.{name}.{key}", 0.0))
            params = params._replace(**{key: getattr(params, key) * factor})
        return params

    def _issued_commands(self, x: DriveInputs, blocks: dict[str, Block]) -> Array:
        """Commands when they were given, (n_rows, 3): those read from a late report frame are moved back."""
        delay = self._port_delay_s(Port.REPORT, blocks) / x.dt_s
        if not delay:
            return x.commands
        columns = zip(x.commands.T, x.is_echoed, strict=True)
        return np.stack([shift_earlier(command, delay) if echoed else command for command, echoed in columns], axis=1)

    def _vehicle_inputs(self, x: DriveInputs, blocks: dict[str, Block], values: Values, outputs: Array) -> InputRow:
        """Columns (n_rows,) of the input rows; late or shifted values of reports are corrected.

        outputs: of the actuators, for channels without a measured output.
        """
        delay = self._port_delay_s(Port.REPORT, blocks) / x.dt_s
        measured = self._undo_report_effects(x.outputs, blocks)
        taken = []
        for i, name in enumerate(CHANNELS):
            channel_delay = delay - values.get(f"clock.{name}_s", 0.0) / x.dt_s
            taken.append(shift_earlier(measured[:, i], channel_delay) if x.has_output[i] else outputs[:, 3 + i])
        throttle, brake, steer = taken
        steer = steer * (1.0 - values.get(LINKAGE_BEND_KEY, 0.0) * (steer / self.steer_ratio) ** 2)
        delay = self._port_delay_s(Port.INS if x.uses_ins_speed else Port.REPORT, blocks) / x.dt_s
        inputs = InputRow(
            throttle_command_frac=None,
            brake_command_frac=None,
            steer_command_rad=None,
            throttle_frac=throttle,
            brake_frac=brake,
            steer_rad=steer,
            gear=x.gear,
            speed_mps=shift_earlier(x.speed_mps, delay),
            yaw_rate_radps=shift_earlier(x.yaw_rate_radps, delay),
            side_speed_mps=shift_earlier(x.side_speed_mps, delay),
            speed_rate_mps2=shift_earlier(x.speed_rate_mps2, delay),
            is_pinned=x.is_pinned,
        )
        return _replace_commands(inputs, self._issued_commands(x, blocks))

    def _port_delay_s(self, port: Port, blocks: dict[str, Block]) -> float:
        """By how much the values at a port are late, by the model's own effects and by those that are tried."""
        params = [blocks[name].params for name in self._chains[port].names]
        return sum(one.delay_s for one in params if isinstance(one, Latency))

    def _undo_report_effects(self, outputs: Array, blocks: dict[str, Block]) -> Array:
        """Measured outputs before the effects on the report, (n_rows, 3); the model's own effects come first."""
        names = [
            name
            for name in self._chains[Port.REPORT].names
            if name in self._output_effects and name not in self._model_effects
        ]
        tried = [self._output_map(blocks[name]) for name in names if blocks[name] is not self._neutral[name]]
        return undo_output_maps(outputs, [*self._model_output_maps, *tried])


def _replace_commands(columns: InputRow, commands: Array) -> InputRow:
    """Columns of the input rows with these commands, (n_rows, 3)."""
    throttle, brake, steer = commands.T
    return columns._replace(throttle_command_frac=throttle, brake_command_frac=brake, steer_command_rad=steer)


def _stack_inputs(columns: InputRow) -> Array:
    """Input rows, (n_rows, N_INPUTS)."""
    rows = np.empty((len(columns.gear), N_INPUTS))
    for i, column in enumerate(columns):
        rows[:, i] = column
    return rows


def _fill_first_row(rows: Array) -> Array:
    """Row 0 is not simulated: it becomes a copy of row 1."""
    rows[0] = rows[min(1, len(rows) - 1)]
    return rows


def _trial_value(effect: Effect, parameter: str) -> float:
    """A value off neutral, to see whether a plant takes it."""
    prior = effect.priors.get(parameter)
    return effect.neutral[parameter] if prior is None or prior.times else prior.typical


ADDITIVE_SUFFIXES = ("zero_frac", "rise_per_frac")


def scale_plant_params(params: Mapping[str, float], defaults: Mapping[str, float], values: Values) -> dict[str, float]:
    """[plant.params] with 'plant.<name>' applied: log of a factor, or an amount for what may be zero."""
    scaled = {**defaults, **params}
    for key, value in values.items():
        group, _, name = key.partition(".")
        if group == "plant" and name in scaled:
            moved = scaled[name] + value if name.endswith(ADDITIVE_SUFFIXES) else scaled[name] * math.exp(value)
            scaled[name] = max(moved, LEAST.get(name, -math.inf))
    return scaled


ACCEL, PEDALS = "accel", ("throttle", "brake")
NO_PEDAL = "the vehicle takes acceleration commands: it has no pedals before its actuators"


def has_channel(model: ModelSpec, name: str) -> bool:
    """Whether a model describes a channel: 'throttle', 'brake', 'steer'."""
    return name in model.actuators or (name != "steer" and ACCEL in model.actuators)


def is_acceleration_controlled(model: ModelSpec) -> bool:
    """Whether a model's vehicle takes acceleration commands and has no pedals of its own."""
    return ACCEL in model.actuators and not any(name in model.actuators for name in PEDALS)


def is_inert_port(model: ModelSpec, port: Port) -> bool:
    """Whether an effect at a port changes nothing: the pedals' inputs of a vehicle that has no pedals."""
    return port in (Port.THROTTLE_A, Port.THROTTLE_OUT, Port.BRAKE_A, Port.BRAKE_OUT) and is_acceleration_controlled(
        model
    )


def load_model_effects(model: ModelSpec) -> dict[str, tuple[Effect, dict[str, float]]]:
    """A model's own effects that change something, with their parameters, by '<place in the list> <name>'."""
    loaded = [(spec, parts.load("tunefree_hil.effects", spec.name, "EFFECT")) for spec in model.effects]
    return {
        f"{i} {spec.name}": (effect, spec.params)
        for i, (spec, effect) in enumerate(loaded)
        if not is_inert_port(model, effect.port)
    }


def channel_spec_from_model(model: ModelSpec, name: str) -> ActuatorSpec:
    """[actuators] of a channel; of a pedal of an acceleration-controlled vehicle its channel 'accel', in duty.

    Dead time and lag act on either pedal as on their difference (plant/actuation/acceleration_interface.py). Amounts in
    m/s2 become shares of full duty; the offset is the throttle's.
    """
    if name in model.actuators or not has_channel(model, name):
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
