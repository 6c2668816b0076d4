"""A running bench: hub, ECU and controller as processes of their own, and a runner that conducts episodes over them.

Where the vehicle's frames run over SocketCAN a recorder writes the logs (bus/recording/recorder.py), and with the bench channel
on a vcan link too there is no hub at all.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bench import load
from tunefree_hil.bus.bench_channel import FAULT_ID, HELLO_ID, STATUS_ID, Role
from tunefree_hil.bus.error_frames import error_words
from tunefree_hil.bus.link import Link, Owner
from tunefree_hil.bus.open import BusChoice, open_link
from tunefree_hil.bus.recording.recorder_owner import BusTrouble, RecorderOwner
from tunefree_hil.bus.socketcan.kernel_link import Claim
from tunefree_hil.bus.tfhub.records import EFF_MASK
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.jobs.running.node_links import TIMING_VARIABLE, clock_of, usable_bus
from tunefree_hil.jobs.running.processes import Processes
from tunefree_hil.jobs.running.session_parts import links_of, paths_for, places_of, start_recorder, uses_hub
from tunefree_hil.nodes.runner import Outcome, Runner

START_LIMIT_S = 30.0
JOIN_LIMIT_S = 10.0  # the nodes run already, or have just been started
SLOW_VARIABLE = "TUNEFREE_START_LIMIT_S"  # a longer limit for a machine that starts Python slowly (an emulated one)
MOST_NAMED = 8  # foreign ids in one line
RUNNER_HEARS = (STATUS_ID, HELLO_ID, FAULT_ID)  # not every TICK and DONE: the runner is no part of the lockstep


class Session:
    """Context manager. `join`: the nodes run already (four terminals), only the runner is ours.

    `controller_command`: starts this program instead of our controller, its {places} filled in (bench_parts.Places).
    `controller_role`: which command of ours is the controller's process (`collector`: jobs/collector.py).
    """

    def __init__(
        self,
        bench_file: Path,
        words: Path,
        *,
        session: str,
        model: str = "",
        bus: str = "auto",
        bench_bus: str = "",
        realtime: bool = False,
        join: bool = False,
        jitted_ecu: bool = False,
        core: int | None = None,
        controller_command: Sequence[str] | None = None,
        controller_role: str = "controller",
    ) -> None:
        self.bench_file = bench_file
        self.session = session
        self.model = model
        self.realtime = realtime
        self.join = join
        self.jitted_ecu = jitted_ecu
        self.controller_command = controller_command
        self.controller_role = controller_role
        self.choice: BusChoice = usable_bus(bus, session, bench_bus)
        self.bench_bus = bench_bus
        if bus.startswith("tfhub:"):  # it names the session
            self.session = self.choice.bench_address.removeprefix("tfhub:").rpartition("/")[0]
        # what `auto` found is settled: a link that comes or goes meanwhile must not part the nodes
        self.bus_text = self.choice.vehicle_address if self.choice.kind == "socketcan" else "tfhub"
        self.processes = Processes(words, core)
        self.notes: list[str] = []  # what stood out on the bus, in words
        self.links: list[Link] = []
        self.claims: list[Claim] = []
        self.owner: Owner | None = None
        self.recorder: RecorderOwner | None = None

    def __enter__(self) -> Session:
        self._open()
        return self

    def _open(self) -> None:
        try:
            self.claims = [Claim(name) for name in links_of(self.choice)]
            if not self.join:
                self._start()
            self.runner = self._conduct()
        except BaseException:
            self.close()
            raise

    def reopen(self) -> None:
        """End what is left of a bench that failed, and start it anew. Where the nodes are not ours, only join again."""
        self.close()
        self._open()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def _common(self) -> list[str]:
        words = ["--session", self.session, "--bus", self.bus_text]
        words += ["--bench-bus", self.bench_bus] if self.bench_bus else []
        return [*words, "--realtime"] if self.realtime else words

    def _start(self) -> None:
        if uses_hub(self.choice):
            clock = clock_of(self.realtime)
            transport = ["--transport", "tcp"] if self.controller_command else []
            words = ["hub", "--session", self.session, "--clock", clock, "--owned", *transport]
            self.hub_pid = self.processes.start("hub", words)
        model = ["--model", self.model] if self.model else []
        timing = {TIMING_VARIABLE: str(self.processes.folder)}
        # NUMBA_OPT=1: as fast a tick here, a quarter less to compile, 20 MB less to keep
        compiled = {"TUNEFREE_JIT": "1", "NUMBA_OPT": "1"} if self.jitted_ecu else {"TUNEFREE_JIT": "0"}
        self.processes.start("ecu", ["ecu", str(self.bench_file), *model, *self._common], {**timing, **compiled})
        if self.controller_command is None:
            plain = {"TUNEFREE_JIT": "0"}
            words = [self.controller_role, str(self.bench_file), *self._common]
            self.processes.start("controller", words, {**timing, **plain})

    def _start_foreign(self, command: Sequence[str]) -> None:
        """Start the controller of the user's own, once the addresses that it is told are there."""
        bench = load(self.bench_file)
        places = places_of(self.choice, self.session, Path(bench.vehicle.folder), self.realtime)
        places = places._replace(paths=paths_for(command, bench, self.processes.folder / "paths"))
        self.processes.run("controller", places.fill(command), places.environment())

    def _conduct(self) -> Runner:
        limit_s = _start_limit_s(START_LIMIT_S)
        if uses_hub(self.choice):
            self.owner = self._patiently(self._own)
        if self.controller_command and not self.join:
            self._start_foreign(self.controller_command)
        if self.choice.kind == "socketcan":
            self.recorder = self._start_recorder(limit_s)
        keeper = self.recorder or self.owner
        assert keeper is not None
        clock = clock_of(self.realtime)  # nodes and hub that run already may be those of the other kind of bench
        bench = open_link(self.choice, "bench", name="runner", only=RUNNER_HEARS, clock=clock)
        self.links.append(bench)
        runner = Runner(bench, keeper, self._check)
        runner.meet(_start_limit_s(JOIN_LIMIT_S) if self.join else limit_s)
        if self.join:
            self._refuse_another_model(runner.collector.name(Role.ECU))
        return runner

    def _refuse_another_model(self, said: str) -> None:
        """Raise InputError where the ECU that was joined drives another model than is wanted: all that follows would
        be said of the wrong car.
        """
        wanted = self.model or load(self.bench_file).spec.model
        if Path(said).name != Path(wanted).name:
            raise InputError(
                f"the ecu of session {self.session} drives {said}, and {wanted} is to be driven",
                code="other_model",
                key="--join",
                hint=f"start it with --model {wanted}, or leave --join out for a bench of your own",
            )

    def _start_recorder(self, limit_s: float) -> RecorderOwner:
        bench, choice = load(self.bench_file), self.choice
        try:
            return start_recorder(
                self.processes, choice, bench, self.session, realtime=self.realtime, patience_s=limit_s
            )
        except BenchError as error:
            raise self.processes.explain(error) from error

    def _check(self) -> None:
        """Raise for a process of ours that has ended, or for what the recorder told of the bus."""
        if self.recorder is not None:
            self.recorder.check()
        self.processes.check()

    def _own(self) -> Owner:
        """Own the hub; where we started one, that one. Raises InputError when somebody else's hub has the session."""
        owner = Owner(self.session, name="runner")
        if not self.join and owner.pid != self.hub_pid:
            owner.close()
            raise InputError(
                f"session {self.session} is in use by another hub, pid {owner.pid}",
                code="session_in_use",
                key="--session",
                hint="join its bench with --join, or leave --session out for a bench of your own",
            )
        return owner

    def _patiently(self, open_it: Callable[[], Owner]) -> Owner:
        limit = time.monotonic() + _start_limit_s(START_LIMIT_S)
        while True:
            try:
                return open_it()
            except BenchError:
                self.processes.check()
                if self.join or time.monotonic() > limit:
                    raise
                time.sleep(0.05)

    def drive(
        self,
        scenario: ScenarioSpec,
        seed: int,
        parameters: Mapping[str, float],
        folder: Path,
    ) -> Outcome:
        """One episode; `folder/vehicle.log` and `folder/bench.log` are written by hub or recorder.

        parameters: by name, those of interfaces 7 and those that the controller announced.
        """
        logs = {"vehicle": folder / "vehicle.log", "bench": folder / "bench.log"}
        try:
            values = dict(sorted(self.runner.indexed(parameters).items()))
            outcome = self.runner.drive(bytes.fromhex(scenario.hash)[:6], seed, values, logs)
            self._note_oddities(scenario.name)
            return outcome
        except BusTrouble:
            raise
        except BenchError as error:  # a process that failed knows more of it than those who lost it
            raise self._better(error) from error

    def _better(self, error: BenchError) -> BenchError:
        """The best of the reports of one loss: the recorder's of the bus, a failed process's, the one that came."""
        explained = self.processes.explain(error)  # gives the recorder a moment too
        try:
            if self.recorder is not None:
                self.recorder.check()
        except BusTrouble as trouble:
            return trouble
        except BenchError:
            return explained  # the recorder is what was lost
        return explained

    def _note_oddities(self, scenario: str) -> None:
        """Into `notes`: what the recorder heard beside the vehicle's frames. A hub's frames have their senders."""
        if self.recorder is None:
            return
        link = self.choice.vehicle_address.partition(":")[2]
        errors, foreign = error_words(Counter(self.recorder.errors)), self.recorder.foreign
        if errors:
            self.notes.append(f"{scenario}: error frames on {link}: {errors}")
        if self.recorder.remote:
            self.notes.append(f"{scenario}: {self.recorder.remote} remote frames on {link}")
        if foreign:
            ids = ", ".join(f"0x{key & EFF_MASK:03X} {count}" for key, count in sorted(foreign.items())[:MOST_NAMED])
            self.notes.append(f"{scenario}: {sum(foreign.values())} frames of other nodes on {link} ({ids} ...)")

    def close(self) -> None:
        """End the nodes, the recorder and the hub; nothing of ours stays."""
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


def _start_limit_s(usual_s: float) -> float:
    """How long a bench may take to come up."""
    return float(os.environ.get(SLOW_VARIABLE, "") or usual_s)


@contextmanager
def open_lanes(count: int, bench_file: Path, words: Path, *, session: str, **more: Any) -> Iterator[list[Session]]:
    """`count` benches side by side, each on a core of its own; `more` goes to each Session.

    One lockstep bench is a chain of processes that wait for each other, so it fills one core and no more.
    """
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    with ExitStack() as stack:
        lanes = []
        for i in range(count):
            core = cores[i % len(cores)] if count > 1 and cores else None
            name = f"{session}-{i}" if count > 1 else session
            lanes.append(Session(bench_file, words / str(i), session=name, core=core, **more))
        for lane in lanes:
            stack.enter_context(lane)
        yield lanes


def lanes_of(join: bool, bus: str) -> int:
    """How many benches to run side by side: one a core, at most two; one where nodes or bus are given, or on vcan0."""
    alone = join or bus not in ("auto", "tfhub") or usable_bus(bus, "lanes", "").kind != "tfhub"
    return 1 if alone else max(1, min(2, os.cpu_count() or 1))
