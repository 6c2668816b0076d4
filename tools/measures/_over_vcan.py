"""The part of the measure `vcan` that needs a kernel with CAN: prints one line of JSON for each thing it has found.

python -m tools.measures._over_vcan [--bench FILE] [--scenarios NAME,NAME] [--runs N] [--rounds N] LINK
"""

from __future__ import annotations

import os

os.environ.setdefault("TUNEFREE_JIT", "0")  # as the nodes; before any kernel is imported

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from tools.measures._hub_process import start_hub
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bus.link import BusLink
from tunefree_hil.bus.open import LinkRequest, open_link
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.running.session import SLOW_VARIABLE, BenchLaunch, BenchSession
from tunefree_hil.jobs.running.trial_driver import TrialDriver

ASK_ID, STOP_ID, READY_ID = 0x100, 0x7FF, 0x7FE
PATIENCE_S = float(os.environ.get(SLOW_VARIABLE, "60"))


def main(words: list[str]) -> int:
    """Drive and count round trips as wanted; say each as it is known."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("link")
    parser.add_argument("--bench", default="tests/vcan/bench.toml")
    parser.add_argument("--scenarios", default="", help="names with commas between; none are driven without")
    parser.add_argument("--runs", type=int, default=0, help="of round trips over each bus")
    parser.add_argument("--rounds", type=int, default=2000, help="round trips in a run")
    parser.add_argument("--echo", action="store_true", help="be the other end of the round trips over LINK")
    options = parser.parse_args(words)
    if options.echo:
        echo(options.link)
        return 0
    if options.scenarios:
        for name, drive in drives(load(Path(options.bench)), options.link, options.scenarios.split(",")):
            say({"scenario": name, "found": drive})
    if options.runs:
        say({"round_trips_per_s": round_trips(options.link, options.runs, options.rounds)})
    return 0


def say(found: dict[str, Any]) -> None:
    """One line, at once: what has been said is not lost when we are cut off."""
    print(json.dumps(found), flush=True)


def drives(bench: Bench, link: str, names: Sequence[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """(scenario, hash and wall time over each bus, ticks): two benches are up, and drive it one after the other."""
    with ExitStack() as stack:
        buses = {"tfhub": "tfhub", "vcan": f"socketcan:{link}"}
        tracks = {name: stack.enter_context(_track(bench, bus, name)) for name, bus in buses.items()}
        for k, name in enumerate(names):
            scenario = bench.scenarios[name]
            found: dict[str, Any] = {"ticks": bench.course(scenario).ticks, "hashes": {}, "wall_s": {}}
            for bus, track in tracks.items():
                before_s = track.wall_s
                episodes = track.drive_scenarios(parameters_of(bench), [scenario], k, keep=False)
                found["hashes"][bus] = episodes[name].hash
                found["wall_s"][bus] = track.wall_s - before_s
            yield name, found


@contextmanager
def _track(bench: Bench, bus: str, name: str) -> Iterator[TrialDriver]:
    """A bench that is up, in a folder that goes with it."""
    with tempfile.TemporaryDirectory() as folder:
        run = RunFolder(Path(folder), {})
        session = f"measure-{os.getpid()}-{name}"
        with BenchSession(Path(bench.file), run.node_output(), BenchLaunch(session=session, bus=bus)) as opened:
            track = TrialDriver(opened, bench, run)
            try:
                yield track
            finally:
                track.close()


def round_trips(link: str, runs: int, rounds: int) -> dict[str, list[float]]:
    """Round trips a second of one frame there and one back between two processes, by bus, a number for each run.

    The buses take turns; the hub is one that writes no log.
    """
    found: dict[str, list[float]] = {"tfhub": [], "vcan": []}
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        hub = stack.enter_context(start_hub(str(Path(folder) / "hub"), clock="sender"))
        addresses = {"tfhub": f"tfhub:{hub.vehicle}", "vcan": f"socketcan:{link}"}
        askers = {name: stack.enter_context(_asker(address)) for name, address in addresses.items()}
        for _ in range(runs):
            for name, bus in askers.items():
                found[name].append(rate_of(bus, rounds))
    return found


def rate_of(bus: BusLink, rounds: int) -> float:
    """Round trips a second over a link whose frames come back."""
    started_s = time.perf_counter()
    for _ in range(rounds):
        bus.send([CanFrame(ASK_ID, bytes(8))])
        _answer(bus, "no echo")
    return rounds / (time.perf_counter() - started_s)


@contextmanager
def _asker(address: str) -> Iterator[BusLink]:
    """A link whose frames come back from another process."""
    bus = open_link(address, "vehicle", LinkRequest(name="asker", only=(READY_ID, ASK_ID)))
    with subprocess.Popen([sys.executable, "-m", "tools.measures._over_vcan", "--echo", address]) as other:
        try:
            _answer(bus, "the echo does not come up")
            yield bus
        except BaseException:
            other.kill()
            raise
        finally:
            bus.send([CanFrame(STOP_ID, b"")])
            bus.close()


def _answer(bus: BusLink, missing: str) -> None:
    if not bus.receive(PATIENCE_S):
        raise TimeoutError(f"{missing}, for {PATIENCE_S:.0f} s")


def echo(address: str) -> None:
    """Send back each frame until STOP_ID comes or nothing does."""
    bus = open_link(address, "vehicle", LinkRequest(name="echo", only=(ASK_ID, STOP_ID)))
    bus.send([CanFrame(READY_ID, b"")])
    while frames := bus.receive(PATIENCE_S):
        if any(frame.id == STOP_ID for frame in frames):
            break
        bus.send(frames)
    bus.close()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
