"""A running bench: hub, ECU and controller as separate processes, and a runner that conducts the episodes.

On SocketCAN a recorder writes the logs (bus/recording/recorder.py); with the bench channel on a vcan link too there is
no hub.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bench import load
from tunefree_hil.bus.bench_channel import FAULT_ID, HELLO_ID, STATUS_ID, Role
from tunefree_hil.bus.error_frames import error_words
from tunefree_hil.bus.link import BusLink
from tunefree_hil.bus.open import BusChoice, LinkRequest, open_link
from tunefree_hil.bus.recording.recorder_owner import BusTrouble, RecorderOwner
from tunefree_hil.bus.socketcan.kernel_link import Claim
from tunefree_hil.bus.tfhub.owner import Owner
from tunefree_hil.bus.tfhub.records import EFF_MASK
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.jobs.command_text import option_arguments
from tunefree_hil.jobs.running.node_links import TIMING_VARIABLE, hub_clock, resolve_process_bus
from tunefree_hil.jobs.running.processes import Processes
from tunefree_hil.jobs.running.session_parts import (
    make_placeholders,
    socketcan_links,
    start_recorder,
    uses_hub,
    write_reference_paths,
)
from tunefree_hil.nodes.runner import Outcome, Runner

START_LIMIT_S = 30.0
JOIN_LIMIT_S = 10.0  # for nodes that are running or have just been started
SLOW_VARIABLE = "TUNEFREE_START_LIMIT_S"  # a longer limit for slow machines
MAX_NAMED = 8  # foreign ids in one line
RUNNER_IDS = (STATUS_ID, HELLO_ID, FAULT_ID)  # without TICK and DONE, as the runner is not part of the lockstep


class BenchLaunch(NamedTuple):
    """How a bench is started.

    model: '' for that of the bench file. join: the nodes are already running; only the runner is started. core: CPU
    core of the processes, None for any. controller_command: program of a foreign controller, with placeholders
    (session_parts.CommandPlaceholders). controller_role: own command that runs as the controller ('controller' or
    'collector').
    """

    session: str
    model: str = ""
    bus: str = "auto"
    bench_bus: str = ""
    realtime: bool = False
    join: bool = False
    jitted_ecu: bool = False
    core: int | None = None
    controller_command: Sequence[str] | None = None
    controller_role: str = "controller"


class BenchSession:
    """A bench as a context manager."""

    def __init__(self, bench_file: Path, output_folder: Path, launch: BenchLaunch) -> None:
        self.bench_file = bench_file
        self.choice: BusChoice = resolve_process_bus(launch.bus, launch.session, launch.bench_bus)
        if launch.bus.startswith("tfhub:"):  # the address contains the session
            launch = launch._replace(session=self.choice.bench_address.removeprefix("tfhub:").rpartition("/")[0])
        self.launch = launch
        self.processes = Processes(output_folder, launch.core)
        self.notes: list[str] = []  # observations on the bus, as text
        self.links: list[BusLink] = []
        self.claims: list[Claim] = []
        self.owner: Owner | None = None
        self.recorder: RecorderOwner | None = None

    def __enter__(self) -> BenchSession:
        self._open()
        return self

    def _open(self) -> None:
        try:
            self.claims = [Claim(name) for name in socketcan_links(self.choice)]
            if not self.launch.join:
                self._start()
            self.runner = self._open_runner()
        except BaseException:
            self.close()
            raise

    def reopen(self) -> None:
        """Close a failed bench and start it again; with `join` only join again."""
        self.close()
        self._open()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _start(self) -> None:
        launch = self.launch
        if uses_hub(self.choice):
            transport = "tcp" if launch.controller_command else None
            hub = option_arguments(
                session=launch.session, clock=hub_clock(launch.realtime), owned=True, transport=transport
            )
            self.hub_pid = self.processes.start("hub", ["hub", *hub])
        # all nodes get the bus that `auto` resolved to, even if a link appears or disappears meanwhile
        bus = self.choice.vehicle_address if self.choice.kind == "socketcan" else "tfhub"
        bench_bus = launch.bench_bus or None
        common = option_arguments(session=launch.session, bus=bus, bench_bus=bench_bus, realtime=launch.realtime)
        model = option_arguments(model=launch.model or None)
        timing = {TIMING_VARIABLE: str(self.processes.folder)}
        # NUMBA_OPT=1: same speed for a single vehicle, 25 % less compile time, 20 MB less memory
        compiled = {"TUNEFREE_JIT": "1", "NUMBA_OPT": "1"} if launch.jitted_ecu else {"TUNEFREE_JIT": "0"}
        self.processes.start("ecu", ["ecu", str(self.bench_file), *model, *common], {**timing, **compiled})
        if launch.controller_command is None:
            arguments = [launch.controller_role, str(self.bench_file), *common]
            self.processes.start("controller", arguments, {**timing, "TUNEFREE_JIT": "0"})

    def _start_foreign(self, command: Sequence[str]) -> None:
        """Start a foreign controller, after the hub has published its addresses."""
        bench = load(self.bench_file)
        launch, vehicle = self.launch, Path(bench.vehicle.folder)
        places = make_placeholders(self.choice, launch.session, vehicle, launch.realtime)
        places = places._replace(paths=write_reference_paths(command, bench, self.processes.folder / "paths"))
        self.processes.run("controller", places.fill(command), places.environment())

    def _open_runner(self) -> Runner:
        launch, limit_s = self.launch, _start_limit_s(START_LIMIT_S)
        if uses_hub(self.choice):
            self.owner = self._own_when_ready()
        if launch.controller_command and not launch.join:
            self._start_foreign(launch.controller_command)
        if self.choice.kind == "socketcan":
            self.recorder = self._start_recorder(limit_s)
        keeper = self.recorder or self.owner
        assert keeper is not None
        clock = hub_clock(launch.realtime)  # checks that running nodes and hub have the same kind of clock
        bench = open_link(self.choice, "bench", LinkRequest("runner", only=RUNNER_IDS, clock=clock))
        self.links.append(bench)
        runner = Runner(bench, keeper, self._check)
        runner.meet(_start_limit_s(JOIN_LIMIT_S) if launch.join else limit_s)
        if launch.join:
            self._require_model(runner.collector.name(Role.ECU))
        return runner

    def _require_model(self, model: str) -> None:
        """Raise InputError where the joined ECU simulates another model than the wanted one."""
        wanted = self.launch.model or load(self.bench_file).spec.model
        if Path(model).name != Path(wanted).name:
            message = f"the ecu of session {self.launch.session} simulates {model}, but {wanted} is wanted"
            hint = f"start it with --model {wanted}, or leave out --join to start a separate bench"
            raise InputError(message, code="other_model", key="--join", hint=hint)

    def _start_recorder(self, limit_s: float) -> RecorderOwner:
        try:
            return start_recorder(self.processes, self.choice, load(self.bench_file), self.launch, limit_s)
        except BenchError as error:
            raise self.processes.explain(error) from error

    def _check(self) -> None:
        """Raise for a process of this bench that has ended, or for trouble on the bus."""
        if self.recorder is not None:
            self.recorder.check()
        self.processes.check()

    def _own_hub(self) -> Owner:
        """Become the owner of the hub. Raises InputError when another bench's hub has the session."""
        owner = Owner(self.launch.session, name="runner")
        if not self.launch.join and owner.pid != self.hub_pid:
            owner.close()
            message = f"session {self.launch.session} is in use by another hub, pid {owner.pid}"
            hint = "join that bench with --join, or leave out --session to start a separate bench"
            raise InputError(message, code="session_in_use", key="--session", hint=hint)
        return owner

    def _own_when_ready(self) -> Owner:
        limit = time.monotonic() + _start_limit_s(START_LIMIT_S)
        while True:
            try:
                return self._own_hub()
            except BenchError:
                self.processes.check()
                if self.launch.join or time.monotonic() > limit:
                    raise
                time.sleep(0.05)

    def drive(self, scenario: ScenarioSpec, seed: int, parameters: Mapping[str, float], folder: Path) -> Outcome:
        """Drive one episode; hub or recorder write `folder/vehicle.log` and `folder/bench.log`.

        parameters: by name, of the built-in controller and those that the controller announced.
        """
        logs = {"vehicle": folder / "vehicle.log", "bench": folder / "bench.log"}
        try:
            values = dict(sorted(self.runner.indexed(parameters).items()))
            outcome = self.runner.drive(bytes.fromhex(scenario.hash)[:6], seed, values, logs)
            self._note_foreign_frames(scenario.name)
            return outcome
        except BusTrouble:
            raise
        except BenchError as error:  # the error of the failed process is more specific
            raise self._most_specific_error(error) from error

    def _most_specific_error(self, error: BenchError) -> BenchError:
        """The most specific of several errors of one loss: the recorder's of the bus, a failed process's, `error`."""
        explained = self.processes.explain(error)  # also gives the recorder time to report
        try:
            if self.recorder is not None:
                self.recorder.check()
        except BusTrouble as trouble:
            return trouble
        except BenchError:
            return explained  # the recorder itself was lost
        return explained

    def _note_foreign_frames(self, scenario: str) -> None:
        """Add error frames, remote frames and foreign frames seen by the recorder to `notes`."""
        if self.recorder is None:
            return
        link = self.choice.vehicle_address.partition(":")[2]
        errors, foreign = error_words(Counter(self.recorder.errors)), self.recorder.foreign
        if errors:
            self.notes.append(f"{scenario}: error frames on {link}: {errors}")
        if self.recorder.remote:
            self.notes.append(f"{scenario}: {self.recorder.remote} remote frames on {link}")
        if foreign:
            ids = ", ".join(f"0x{key & EFF_MASK:03X} {count}" for key, count in sorted(foreign.items())[:MAX_NAMED])
            self.notes.append(f"{scenario}: {sum(foreign.values())} frames of other nodes on {link} ({ids} ...)")

    def close(self) -> None:
        """End the nodes, the recorder and the hub."""
        for link in self.links:
            link.close()
        self.links.clear()
        for keeper in (self.recorder, self.owner):
            if keeper is not None:
                keeper.close()
        self.recorder = self.owner = None
        self.processes.stop()
        for claim in self.claims:
            claim.close()
        self.claims.clear()


def _start_limit_s(default_s: float) -> float:
    """Time limit for the start of a bench."""
    return float(os.environ.get(SLOW_VARIABLE, "") or default_s)


@contextmanager
def open_lanes(count: int, bench_file: Path, output_folder: Path, launch: BenchLaunch) -> Iterator[list[BenchSession]]:
    """Run `count` benches in parallel, each with a session name of its own and on one CPU core.

    The processes of a lockstep bench wait for each other, so one bench uses one core.
    """
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    with ExitStack() as stack:
        lanes = []
        for i in range(count):
            core = cores[i % len(cores)] if count > 1 and cores else None
            session = f"{launch.session}-{i}" if count > 1 else launch.session
            own = launch._replace(session=session, core=core)
            lanes.append(BenchSession(bench_file, output_folder / str(i), own))
        for lane in lanes:
            stack.enter_context(lane)
        yield lanes


def choose_lane_count(join: bool, bus: str) -> int:
    """Number of parallel benches: one a core, at most two; one where nodes or bus are given, or on vcan0."""
    alone = join or bus not in ("auto", "tfhub") or resolve_process_bus(bus, "lanes", "").kind != "tfhub"
    return 1 if alone else max(1, min(2, os.cpu_count() or 1))
