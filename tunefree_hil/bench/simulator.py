"""The drives of a bench in this process, by the episode kernel of batch/: compiled with TUNEFREE_JIT=batch, else slow.

It is made once for a structure (vehicle folder, kind of plant, names of effects, controller parts, delays). Parameters,
scenario, seed and values of effects are data and need no compilation.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base import parts
from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import buffer, table
from tunefree_hil.base.records import NAN
from tunefree_hil.batch.bits import bit_params, init_bits
from tunefree_hil.batch.commands import command_params, init_commands
from tunefree_hil.batch.episode import (
    COMMAND,
    INS,
    NEEDS_THE_BUS,
    REPORT,
    TRACKING,
    WIDTH,
    ControllerStart,
    End,
    LinkParams,
    Setting,
    VehicleStart,
    WireStates,
    make_episode,
)
from tunefree_hil.bench.controller import ControllerFor, needed_messages
from tunefree_hil.bench.load import Bench, model_of
from tunefree_hil.bench.scaling import scaled
from tunefree_hil.bench.user_kernels import list_user_kernels, require_kernel_parts, run_kernel
from tunefree_hil.bench.vehicle import VehicleFor
from tunefree_hil.bus.bench_channel import ErrorCode
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.wire_block import wire
from tunefree_hil.config.fault_check import DRIVER
from tunefree_hil.config.schema import EffectSpec, ScenarioSpec
from tunefree_hil.control import follower
from tunefree_hil.episode.columns import assemble_columns
from tunefree_hil.episode.recording import Recording
from tunefree_hil.nodes.controller import MISSING_CODES, STAGE_CODES, Assignment
from tunefree_hil.nodes.ecu import Vehicle
from tunefree_hil.nodes.handshake import STAGES, Stage, limits_of
from tunefree_hil.nodes.measurement_decoder import MeasurementDecoder

KEPT_VEHICLES = 64  # the noise of a scenario each: 0.4 MB for a drive of a minute
KEPT_ROWS = 8  # lengths of drives a thread: 0.9 MB for a drive of 20 s


class Job(NamedTuple):
    """One drive. values: a complete vector by name; seed: None is the scenario's own noise seed.

    effects: values for the batch's `extra_effects`, by name; those left out are neutral. scale: factors on the
    actuators' "dead_time" and "lag" (bench/scaling.py).
    """

    values: Mapping[str, float]
    scenario: ScenarioSpec
    seed: int | None = None
    effects: Mapping[str, Mapping[str, float]] = {}
    scale: Mapping[str, float] = {}


class EpisodeRun(NamedTuple):
    """A drive of the kernel: its course, how it ended, and its rows column by column."""

    course: Course
    end: End
    rows: np.ndarray


class EpisodeSetup(NamedTuple):
    """The kernel of an episode and its input."""

    kernel: Any
    setting: Setting
    link: WireStates
    controller: ControllerStart
    car: VehicleStart


class SimulatedDrive(NamedTuple):
    """Result of a drive. error: '' when it was driven to its end, else the error's name."""

    recording: Recording
    ticks: int
    error: str


class Simulator:
    """A bench, a model (default: the bench's own) and effects after theirs, neutral unless a job gives values.

    Thread-safe. Raises InputError for a bench that cannot be built, or not for a batch.
    """

    def __init__(self, bench: Bench, model: str = "", extra_effects: Sequence[str] = ()) -> None:
        self._scenarios = dict(bench.scenarios)
        self.bench = replace(bench, scenarios=self._scenarios)
        self.model = model or bench.spec.model
        self.extra_effects = tuple(extra_effects)
        self._require_effects()
        self._require_no_faults()
        require_kernel_parts(self.bench)
        self._controllers = ControllerFor(self.bench)
        self._vehicle_makers: dict[Any, VehicleFor] = {}
        self._vehicles: dict[Any, Vehicle] = {}
        self._starts: dict[int, tuple[Vehicle, VehicleStart]] = {}
        self._lock = threading.Lock()
        self._own = threading.local()
        self._base = self._vehicle_maker({}, {})
        self._driver = _driver_rows(self.bench, self._base)
        self._link = _link_params(self.bench, self._base.phases)
        self._wires = {group: wire(bench.codec, group, self._base.phases) for group in ("report", "ins", "command")}
        self._user_kernels = list_user_kernels(self.bench, self._base.model)
        self._kernel: Any = None

    def drive(self, job: Job) -> SimulatedDrive:
        """One drive."""
        course, end, rows = self.run(job)
        records: Any = rows.reshape(WIDTH, course.ticks)[:, : end.ticks].T
        recording = assemble_columns(
            records[:, REPORT:INS], records[:, INS:COMMAND], records[:, COMMAND:TRACKING], records[:, TRACKING:],
            self.bench.dt_s,
        )  # fmt: skip
        return SimulatedDrive(recording, end.ticks, ErrorCode(int(end.code)).name.lower() if end.code else "")

    def run(self, job: Job) -> EpisodeRun:
        """Drive a job. This thread's next drive overwrites the rows."""
        with self._lock:
            task = self._assignment(job)
            vehicle = self._vehicle(job)
            kernel, setting, link, controller, car = self._episode(task, vehicle)
        out = self._rows(vehicle.course.ticks)
        end = End._make(run_kernel(kernel, (self._link, link, setting, controller, car, out), self._user_kernels))
        if end.code == NEEDS_THE_BUS:
            raise InputError(
                "an override is latched before the take-over: the batch does not drive that",
                code="not_in_batch",
                file=self.bench.file,
                key="faults",
                hint="let the driver take over later, or leave out --backend batch",
            )
        return EpisodeRun(vehicle.course, end, np.asarray(out))

    def _rows(self, ticks: int) -> Any:
        cache = self._own.__dict__.setdefault("rows", {})
        if ticks not in cache:
            if len(cache) >= KEPT_ROWS:
                cache.pop(next(iter(cache)))
            cache[ticks] = buffer(WIDTH * ticks, NAN)
        return cache[ticks]

    def _episode(self, task: Assignment, vehicle: Vehicle) -> EpisodeSetup:
        """The kernel and its input with fresh states."""
        bench, course, block = self.bench, vehicle.course, task.block
        if self._kernel is None:
            self._kernel = make_episode(block.step, vehicle.unit.step, follower.step)
        report, ins = (self._wires[group].init(self._wires[group].params, bench.dt_s) for group in ("report", "ins"))
        link = WireStates(
            report,
            ins,
            init_bits(self._link.bits),
            buffer(max(len(self._link.bit_period), 1)),
            init_commands(self._wires["command"], self._link.command),
        )
        setting = Setting(
            course.ticks,
            bench.dt_s,
            course.grade_rad,
            course.friction_frac,
            course.bank_rad,
            course.side_wind_mps2,
            self._driver,
        )
        follow = block.params.follower
        controller = ControllerStart(
            block.params, block.init(block.params, bench.dt_s), follow, follower.init(follow, bench.dt_s)
        )
        return EpisodeSetup(self._kernel, setting, link, controller, self._start_of(vehicle))

    def _start_of(self, vehicle: Vehicle) -> VehicleStart:
        """The vehicle at tick 0 with its own buffers; its constants are cached with its noise."""
        key = id(vehicle)
        if key not in self._starts:
            if len(self._starts) >= KEPT_VEHICLES:
                self._starts.pop(next(iter(self._starts)))
            self._starts[key] = vehicle, VehicleStart(*vehicle.unit.start(vehicle.body, self.bench.dt_s))
        start = self._starts[key][1]
        return start._replace(state=_fresh(start.state))

    def _assignment(self, job: Job) -> Assignment:
        """The controller for a job; only its params are used, the steps are those of the first one."""
        self._know(job.scenario)
        return self._controllers(bytes.fromhex(job.scenario.hash)[:6], self._controllers.indexed(job.values))

    def _vehicle(self, job: Job) -> Vehicle:
        """The vehicle at a job's start, with its noise; cached, as drawing noise takes long."""
        self._know(job.scenario)
        seed = job.scenario.noise_seed if job.seed is None else job.seed
        key = (job.scenario.hash, seed, _key(job.effects, job.scale))
        if key not in self._vehicles:
            if len(self._vehicles) >= KEPT_VEHICLES:
                self._vehicles.pop(next(iter(self._vehicles)))
            vehicle = self._vehicle_maker(job.effects, job.scale)(bytes.fromhex(job.scenario.hash)[:6], seed)
            self._vehicles[key] = self._with_base_steps(vehicle)
        return self._vehicles[key]

    def _with_base_steps(self, vehicle: Vehicle) -> Vehicle:
        """The same vehicle with the kernels of the structure: own numbers, shared code."""
        base = self._base.body
        block = base.block._replace(params=vehicle.body.block.params)
        return vehicle._replace(unit=self._base.unit, body=base._replace(block=block))

    def _vehicle_maker(self, effects: Mapping[str, Mapping[str, float]], scale: Mapping[str, float]) -> VehicleFor:
        key = _key(effects, scale)
        if key not in self._vehicle_makers:
            if len(self._vehicle_makers) >= KEPT_VEHICLES:
                self._vehicle_makers.pop(next(iter(self._vehicle_makers)))
            unknown = sorted(set(effects) - set(self.extra_effects))
            if unknown:
                raise InputError(
                    f"{', '.join(unknown)} is none of this batch's extra effects",
                    code="unknown_effect",
                    hint=f"they are {', '.join(self.extra_effects) or 'none'}",
                )
            extra = [EffectSpec(name=name, params=dict(effects.get(name, {}))) for name in self.extra_effects]
            model = scaled(model_of(self.bench, self.model), scale)
            self._vehicle_makers[key] = VehicleFor(with_effects(self.bench, extra), model)
        return self._vehicle_makers[key]

    def _know(self, scenario: ScenarioSpec) -> None:
        known = self._scenarios.get(scenario.name)
        if known is None or known.hash != scenario.hash:
            self._scenarios[scenario.name if known is None else scenario.hash] = scenario

    def _require_no_faults(self) -> None:
        """Faults of the driver are simulated; faults of frames and nodes need the bus."""
        for i, fault in enumerate(self.bench.spec.faults):
            if fault.kind != DRIVER:
                raise InputError(
                    f"the batch has no frames that a fault {fault.kind!r} could befall",
                    code="not_in_batch",
                    file=self.bench.file,
                    key=f"faults[{i}].kind",
                    hint="drive it over the bus: leave out --backend batch",
                )

    def _require_effects(self) -> None:
        for name in self.extra_effects:
            parts.load("tunefree_hil.effects", name, "EFFECT")


def with_effects(bench: Bench, extra: Sequence[EffectSpec]) -> Bench:
    """The same bench with more effects after its own."""
    spec = bench.spec
    fields = {name: getattr(spec, name) for name in spec.__struct_fields__}
    return replace(bench, spec=type(spec)(**{**fields, "effects": [*spec.effects, *extra]}))


def _key(effects: Mapping[str, Mapping[str, float]], scale: Mapping[str, float]) -> tuple[Any, ...]:
    changed = tuple(sorted((name, tuple(sorted(values.items()))) for name, values in effects.items()))
    return changed, tuple(sorted(scale.items()))


def _fresh(state: Any) -> Any:
    """A copy of the state with its own buffers."""
    if isinstance(state, tuple):
        parts = map(_fresh, state)
        return type(state)._make(parts) if hasattr(state, "_make") else tuple(parts)  # type: ignore[attr-defined]
    return state.copy() if isinstance(state, np.ndarray | list) else state


def _driver_rows(bench: Bench, vehicle: VehicleFor) -> Any:
    """Rows of 6 numbers up to the end of the last fault."""
    last = max((fault.to_tick for fault in bench.spec.faults), default=0)
    return table(value for tick in range(last + 1) for value in vehicle.driver(tick))


def _link_params(bench: Bench, phases: Mapping[str, int]) -> LinkParams:
    """The bus of a vehicle as tables."""
    codec = bench.codec
    speaking = [message for message in codec.telemetry if message.states]
    missing_tick, missing_code = _first_missing(codec, bench.dt_s, phases)
    codes = [float(STAGE_CODES.get(stage, ErrorCode.NONE)) for stage in STAGES]
    codes[STAGES.index(Stage.CLEARING)] = NEEDS_THE_BUS
    return LinkParams(
        wire(codec, "report", phases).params,
        wire(codec, "ins", phases).params,
        bit_params(speaking),
        table(message.period_ticks for message in speaking),
        table(phases[message.name] for message in speaking),
        table(message.unproven_frames for message in speaking),
        command_params(codec),
        missing_tick,
        missing_code,
        table(codes),
        limits_of(bench.dt_s),
    )


def _first_missing(codec: Codec, dt_s: float, phases: Mapping[str, int]) -> tuple[int, float]:
    """(tick, error code) at which the controller lacks a needed message; (-1, 0) for never.

    The bus loses no frames here, so this depends on periods and phases only.
    """
    decoder, needed = MeasurementDecoder(codec, dt_s), needed_messages(codec)
    sent = dict.fromkeys(phases, 0)
    longest = max((message.period_ticks for message in codec.telemetry), default=1)
    for k in range(4 * longest + 2 * decoder.limit_ticks):
        for message in codec.telemetry:
            if (k + phases[message.name]) % message.period_ticks == 0:
                sent[message.name] += 1
                if sent[message.name] > message.unproven_frames:
                    decoder.heard_at[message.name] = k
        late = decoder.missing(k, needed)
        if late is not None:
            return k, float(MISSING_CODES[late[0]])
    return -1, 0.0
