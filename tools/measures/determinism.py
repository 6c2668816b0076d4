"""Is a drive the same, whoever starts first, whoever is held up, and whatever else the machine does?"""

from __future__ import annotations

import os
import signal
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random
from typing import Any

from tools.measures._burners import burning
from tools.measures._in_process import InProcess
from tools.measures._summary import rounded
from tunefree_hil.base.errors import BenchError
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.jobs.running.episode_results import DrivenEpisode, read_episode
from tunefree_hil.jobs.running.processes import Processes
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession

VALUE = "distinct frame hashes of one drive: shuffled start order, members held up at random, busy CPUs (1 is right)"
START_S = 30.0
HELD_S = (0.001, 0.008)  # how long a member is held up ...
FREE_S = (0.005, 0.060)  # ... and left alone


def measure(
    runs: int = 10,
    burners: int = 0,
    scenario: str = "serpentine",
    seed: int = 1,
    bench: str = "bench_configs/mkz_steer.toml",
) -> dict[str, Any]:
    """`runs` drives of one scenario, each with processes of its own. 0 burners: one a CPU."""
    loaded = load(bench)
    chosen = loaded.scenarios[scenario]
    _, alone = InProcess(loaded).grade(chosen, parameters_of(loaded))
    found = [_run(loaded, chosen, Random(seed * 1000 + i), burners or os.cpu_count() or 1) for i in range(runs)]
    hashes = Counter(one["hash"] for one in found)
    detail = {
        "scenario": scenario,
        "hashes": dict(hashes),
        "same_as_in_one_process": set(hashes) == {alone},
        "burners": burners or os.cpu_count(),
        "runs": found,
    }
    return {"value": len(hashes), "unit": "distinct hashes", "n": runs, "low": None, "high": None,
            "detail": rounded(detail)}  # fmt: skip


def _run(bench: Bench, scenario: ScenarioSpec, rng: Random, burners: int) -> dict[str, Any]:
    """One drive under all that; what was done to it and its hash."""
    order = ["hub", "ecu", "controller"]
    rng.shuffle(order)
    values = parameters_of(bench)
    with tempfile.TemporaryDirectory() as text, burning(burners):
        folder = Path(text)
        nodes = Processes(folder / "nodes")
        try:
            pids = _start(bench, nodes, order, f"same-{os.getpid()}-{rng.randrange(10**6)}", rng)
            with (
                _join(bench, folder, pids["session"], nodes) as session,
                _held_up([pids[name] for name in order], rng) as stops,
            ):
                outcome = session.drive(scenario, scenario.noise_seed, values, folder)
        finally:
            nodes.stop()
        episode = read_episode(bench, DrivenEpisode(scenario, values, outcome, folder))
    return {"order": order, "held_up": len(stops), "held_up_s": sum(stops), "wall_s": outcome.wall_s,
            "ticks": outcome.ticks, "frames": outcome.logged["vehicle"], "hash": episode.hash}  # fmt: skip


def _start(bench: Bench, nodes: Processes, order: list[str], session: str, rng: Random) -> dict[str, Any]:
    """Start the three in this order, up to 0.5 s apart. The nodes wait for a hub that is not there yet."""
    common = [bench.file, "--session", session, "--bus", f"tfhub:{session}"]
    words = {
        "hub": ["hub", "--session", session, "--clock", "sender"],
        "ecu": ["ecu", *common],
        "controller": ["controller", *common],
    }
    pids: dict[str, Any] = {"session": session}
    for name in order:
        pids[name] = nodes.start(name, words[name], {"TUNEFREE_JIT": "0"})
        time.sleep(rng.uniform(0.0, 0.5))
    return pids


@contextmanager
def _join(bench: Bench, folder: Path, name: str, nodes: Processes) -> Iterator[BenchSession]:
    """A session on nodes that somebody else has started, and may still be starting."""
    limit = time.monotonic() + START_S
    while True:
        session = BenchSession(
            Path(bench.file), folder / "own", BenchLaunch(session=name, bus=f"tfhub:{name}", join=True)
        )
        try:
            opened = session.__enter__()
            break
        except BenchError as error:
            nodes.check()
            if error.code != "no_hub" or time.monotonic() > limit:
                raise
            time.sleep(0.05)
    try:
        yield opened
    finally:
        session.close()


@contextmanager
def _held_up(pids: list[int], rng: Random) -> Iterator[list[float]]:
    """Stop one process after the other for a few milliseconds, all the while; the list of how long each time."""
    stops: list[float] = []
    ended = threading.Event()

    def hold_up() -> None:
        while not ended.wait(rng.uniform(*FREE_S)):
            pid, held_s = rng.choice(pids), rng.uniform(*HELD_S)
            try:
                os.kill(pid, signal.SIGSTOP)
                time.sleep(held_s)
                os.kill(pid, signal.SIGCONT)
            except ProcessLookupError:  # it has ended; the drive itself says so
                return
            stops.append(held_s)

    thread = threading.Thread(target=hold_up, name="hold-up")
    thread.start()
    try:
        yield stops
    finally:
        ended.set()
        thread.join()
