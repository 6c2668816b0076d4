"""The part of the measure `vcan` that needs a kernel with CAN: prints one line of JSON.

python -m tools.measures._over_vcan [--bench FILE] [--scenarios N] [--rounds N] LINK
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
from pathlib import Path
from typing import Any

from tunefree_hil.base.records import CanFrame
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bus.open import open_link
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.session import Session
from tunefree_hil.jobs.track import Track

ASK_ID, STOP_ID, READY_ID = 0x100, 0x7FF, 0x7FE
PATIENCE_S = 60.0


def main(words: list[str]) -> int:
    """Drive, count round trips, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("link")
    parser.add_argument("--bench", default="tests/vcan/bench.toml")
    parser.add_argument("--scenarios", type=int, default=6)
    parser.add_argument("--rounds", type=int, default=2000)
    parser.add_argument("--echo", action="store_true", help="be the other end of the round trips")
    options = parser.parse_args(words)
    if options.echo:
        echo(options.link)
        return 0
    print(json.dumps(measured(load(Path(options.bench)), options.link, options.scenarios, options.rounds)))
    return 0


def measured(bench: Bench, link: str, scenarios: int, rounds: int) -> dict[str, Any]:
    """Hashes and pace of each scenario over both buses; the factor is wall time over vcan by wall time over tfhub."""
    buses = {"tfhub": "tfhub", "vcan": f"socketcan:{link}"}
    over = {name: drives(bench, bus, bench.spec.scenarios[:scenarios]) for name, bus in buses.items()}
    each = {
        name: {
            "hashes": {bus: over[bus][name][0] for bus in buses},
            "wall_s": {bus: over[bus][name][1] for bus in buses},
        }
        for name in bench.spec.scenarios[:scenarios]
    }
    wall_s = {bus: sum(seconds for _, seconds in over[bus].values()) for bus in buses}
    ticks = sum(bench.course(bench.scenarios[name]).ticks for name in each)
    return {
        "drives": each,
        "ticks_per_s": {bus: ticks / seconds for bus, seconds in wall_s.items()},
        "factor_vcan_to_tfhub": wall_s["vcan"] / wall_s["tfhub"],
        "round_trips_per_s": round_trips(link, rounds),
    }


def drives(bench: Bench, bus: str, names: list[str]) -> dict[str, tuple[str, float]]:
    """Scenario -> (frame hash, wall seconds of the drive alone), one after the other over one bench."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        run = RunFolder(Path(folder), {})
        with Session(Path(bench.file), run.words(), session=f"measure-{os.getpid()}", bus=bus) as session:
            track = Track(session, bench, run)
            try:
                for k, name in enumerate(names):
                    before_s = track.wall_s
                    episodes = track.drive_all(parameters_of(bench), [bench.scenarios[name]], k)
                    found[name] = episodes[name].hash, track.wall_s - before_s
            finally:
                track.close()
    return found


def round_trips(link: str, rounds: int) -> float:
    """Round trips a second of one frame there and one back, between two processes on a link."""
    words = [sys.executable, "-m", "tools.measures._over_vcan", "--echo", link]
    bus = open_link(f"socketcan:{link}", name="asker", only=(READY_ID, ASK_ID))
    with subprocess.Popen(words):
        try:
            if not bus.receive(PATIENCE_S):
                raise TimeoutError("the echo does not come up")
            started_s = time.perf_counter()
            for _ in range(rounds):
                bus.send([CanFrame(ASK_ID, bytes(8))])
                if not bus.receive(PATIENCE_S):
                    raise TimeoutError("no echo")
            return rounds / (time.perf_counter() - started_s)
        finally:
            bus.send([CanFrame(STOP_ID, b"")])
            bus.close()


def echo(link: str) -> None:
    """Send back each frame until STOP_ID comes or nothing does."""
    bus = open_link(f"socketcan:{link}", name="echo", only=(ASK_ID, STOP_ID))
    bus.send([CanFrame(READY_ID, b"")])
    while frames := bus.receive(PATIENCE_S):
        if any(frame.id == STOP_ID for frame in frames):
            break
        bus.send(frames)
    bus.close()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
