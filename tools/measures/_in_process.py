"""A bench in one process: the parts of ECU and controller stepped in turn, frame for frame as over the bus.

Both nodes run as they are; only the Exchange between them is another one. So the frame hash of a drive is that of the
same drive over the bus (tests/tools/test_measures.py compares them). For sweeps over models, and for very long drives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, cast

from tunefree_hil.base.kernel import Block
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bench import Bench, ControllerFor, VehicleFor, follower_of, needed_messages
from tunefree_hil.bench.faults import CONTROLLER, ECU, driver_script, faults_of
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.link import Sending
from tunefree_hil.config.schema import FaultSpec, ScenarioSpec
from tunefree_hil.episode.candump import FD, LogFrame
from tunefree_hil.episode.columns import columns_from_frames
from tunefree_hil.episode.frame_hash import frame_hash
from tunefree_hil.grade.score import ScenarioEnd, ScenarioGrade, grade_drive, grade_vehicle_from_spec
from tunefree_hil.nodes.controller import Assignment, ControllerPart
from tunefree_hil.nodes.ecu import EcuPart
from tunefree_hil.nodes.exchange import Exchange, can_key
from tunefree_hil.nodes.timing import CycleTimes

Watch = Callable[[Any], None]


class Drive(NamedTuple):
    """How a drive went. error: '' when it was driven to its end.

    words: Status and Fault messages of both nodes; said: what they said to people.
    """

    frames: list[LogFrame]
    ticks: int
    error: str
    words: list[Any]
    said: list[str]


class InProcess:
    """A model of a bench and its controller. `watch` sees the controller's state after every step."""

    def __init__(self, bench: Bench, model: str = "", watch: Watch | None = None) -> None:
        self.bench = bench
        codec = bench.codec
        assign = ControllerFor(bench)

        def watched(scenario: bytes, parameters: Mapping[int, float]) -> Assignment:
            task = assign(scenario, parameters)
            return task if watch is None else task._replace(block=watch_block(task.block, watch))

        self._said: list[str] = []
        self._vehicle, self._assign = VehicleFor(bench, model or bench.spec.model), assign
        self.ecu = EcuPart(codec, self._vehicle, CycleTimes(), lambda text: self._said.append(text))
        self.controller = ControllerPart(
            codec, needed_messages(codec), watched, CycleTimes(), lambda text: self._said.append(text)
        )

    def script(self, faults: Sequence[FaultSpec]) -> None:
        """From now on with these faults instead of the bench file's. Raises InputError as a bench file would."""
        bench = self.bench
        self._vehicle.faults, self._assign.faults = faults_of(bench, ECU, faults), faults_of(bench, CONTROLLER, faults)
        self._vehicle.driver = driver_script(faults, bench.vehicle.nominal.rest_pedal_frac)

    def drive(
        self, scenario: ScenarioSpec, values: Mapping[str, float], *, keep: bool = True, until: int | None = None
    ) -> Drive:
        """One drive with the scenario's own noise seed. keep=False: the frames are not kept. until: stopped there."""
        self._said = []
        start = bytes.fromhex(scenario.hash)[:6]
        parameters = self._assign.indexed(values)
        self.ecu.load(start, scenario.noise_seed, parameters)
        self.controller.load(start, scenario.noise_seed, parameters)
        self.controller.decoder.reception.expect_every_period()  # as its own lockstep does
        between = _Between(self.controller, keep, until)
        self.ecu.lockstep(cast(Exchange, between), lambda message: False)
        code = between.failure or between.end.error_code
        error = bc.ErrorCode(code).name.lower() if code else ""
        return Drive(between.frames, between.end.tick, error, between.words, self._said)

    def grade(self, scenario: ScenarioSpec, values: Mapping[str, float]) -> tuple[ScenarioGrade, str]:
        """(grade, frame hash) of a drive, made as jobs/running/episode_results.py makes them."""
        bench, drive = self.bench, self.drive(scenario, values)
        commands = {message.key for message in bench.codec.commands}
        hashed = frame_hash(drive.frames, bench.dt_s, commands, bench.codec.by_id.keys())
        follower = follower_of(bench, scenario, values)
        recording = columns_from_frames(drive.frames, bench.codec, follower, bench.dt_s, ticks=drive.ticks)
        vehicle = grade_vehicle_from_spec(bench.vehicle)
        course = bench.course(scenario)
        graded = grade_drive(recording, course, bench.weights, vehicle, ScenarioEnd(scenario.name, drive.error))
        return graded, hashed.hex


class _Between:
    """What an Exchange is to the ECU: phase 1 of a tick is the controller's cycle on phase 0."""

    def __init__(self, controller: ControllerPart, keep: bool, until: int | None) -> None:
        self.controller = controller
        self.keep = keep
        self.until = until
        self.words: list[Any] = []
        self.frames: list[LogFrame] = []
        self.failure = 0
        self.end = bc.Status(bc.Role.ECU, bc.State.FAILED, 0, 0)
        self._reports: list[CanFrame] = []

    def prepare(self, k: int, phase: int, frames: list[CanFrame], *before: Any) -> Sending:
        return partial(self._announce, frames)

    def _announce(self, frames: list[CanFrame]) -> None:
        self._reports = self._in_order(frames)

    def await_phase(self, k: int, phase: int, interrupt: Callable[[Any], bool]) -> list[CanFrame] | None:
        if k == self.until:
            return None
        reply, words = self.controller.cycle(k, self._reports)
        self.words += words
        for word in words:
            if isinstance(word, bc.Status):
                self.failure = self.failure or word.error_code
            interrupt(word)
        return self._in_order(reply)

    def send_messages(self, *messages: Any, k: int = 0) -> None:
        self.words += messages
        for message in messages:
            if isinstance(message, bc.Status):
                self.end = message

    def _in_order(self, frames: list[CanFrame]) -> list[CanFrame]:
        frames.sort(key=can_key)
        if self.keep:
            self.frames += [LogFrame(f.time_s, "can0", can_key(f), f.data, FD if f.fd else 0) for f in frames]
        return frames


def watch_block(block: Block, watch: Watch) -> Block:
    """The same Block, whose state somebody sees after every step."""

    def step(params: Any, state: Any, x: Any, dt_s: float) -> tuple[Any, Any]:
        state, y = block.step(params, state, x, dt_s)
        watch(state)
        return state, y

    return block._replace(step=step)
