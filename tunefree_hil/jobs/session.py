"""A running bench: hub, ECU and controller as processes of their own, and a runner that conducts episodes over them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bus.bench_channel import FAULT_ID, HELLO_ID, STATUS_ID
from tunefree_hil.bus.link import Link, Owner
from tunefree_hil.bus.open import BusChoice, open_link
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.control.parameters import NAMES
from tunefree_hil.jobs.node_links import TIMING_VARIABLE, require_recorder, usable_bus
from tunefree_hil.jobs.processes import Processes
from tunefree_hil.nodes.runner import Outcome, Runner

START_LIMIT_S = 30.0
JOIN_LIMIT_S = 10.0  # the nodes run already, or have just been started
RUNNER_HEARS = (STATUS_ID, HELLO_ID, FAULT_ID)  # not every TICK and DONE: the runner is no part of the lockstep


class Session:
    """Context manager. `join`: the nodes run already (four terminals), only the runner is ours."""

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
    ) -> None:
        self.bench_file = bench_file
        self.session = session
        self.model = model
        self.realtime = realtime
        self.join = join
        self.jitted_ecu = jitted_ecu
        self.bus_text, self.bench_bus = bus, bench_bus
        self.choice: BusChoice = usable_bus(bus, session, bench_bus)
        require_recorder(self.choice)
        if bus.startswith("tfhub:"):  # it names the session
            self.session = self.choice.bench_address.removeprefix("tfhub:").rpartition("/")[0]
        self.processes = Processes(words, core)
        self.links: list[Link] = []

    def __enter__(self) -> Session:
        self._open()
        return self

    def _open(self) -> None:
        try:
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

    def _start(self) -> None:
        common = ["--session", self.session, "--bus", self.bus_text]
        if self.bench_bus:
            common += ["--bench-bus", self.bench_bus]
        clock = "real" if self.realtime else "sender"
        pace = ["--realtime"] if self.realtime else []
        self.hub_pid = self.processes.start("hub", ["hub", "--session", self.session, "--clock", clock, "--owned"])
        model = ["--model", self.model] if self.model else []
        timing = {TIMING_VARIABLE: str(self.processes.folder)}
        # NUMBA_OPT=1: as fast a tick here, a quarter less to compile, 20 MB less to keep
        compiled = {"TUNEFREE_JIT": "1", "NUMBA_OPT": "1"} if self.jitted_ecu else {"TUNEFREE_JIT": "0"}
        self.processes.start("ecu", ["ecu", str(self.bench_file), *model, *common, *pace], {**timing, **compiled})
        plain = {"TUNEFREE_JIT": "0"}
        self.processes.start("controller", ["controller", str(self.bench_file), *common, *pace], {**timing, **plain})

    def _conduct(self) -> Runner:
        owner = self._patiently(self._own)
        bench = open_link(self.choice, "bench", name="runner", only=RUNNER_HEARS)
        self.owner = owner
        self.links.append(bench)
        runner = Runner(bench, owner, self.processes.check)
        runner.meet(JOIN_LIMIT_S if self.join else START_LIMIT_S)
        return runner

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
        limit = time.monotonic() + START_LIMIT_S
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
        """One episode; `folder/vehicle.log` and `folder/bench.log` are written by the hub."""
        logs = {"vehicle": folder / "vehicle.log", "bench": folder / "bench.log"}
        vector = [parameters[name] for name in NAMES]
        try:
            return self.runner.drive(bytes.fromhex(scenario.hash)[:6], seed, vector, logs)
        except BenchError as error:  # a process that failed knows more of it than those who lost it
            raise self.processes.explain(error) from error

    def close(self) -> None:
        """End the nodes and the hub; nothing of ours stays."""
        for link in self.links:
            link.close()
        self.links.clear()
        if hasattr(self, "owner"):
            self.owner.close()
        self.processes.stop()


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
    """How many benches to run side by side: one a core, at most two; one where the nodes or the bus are given."""
    return 1 if join or bus not in ("auto", "tfhub") else max(1, min(2, os.cpu_count() or 1))
