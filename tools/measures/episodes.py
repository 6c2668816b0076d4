"""How many drives a core does in a second, beside other vehicle simulators for Python, and what each of them does."""

from __future__ import annotations

import json
import subprocess
import sys
import time
import venv
from pathlib import Path
from typing import Any

import numpy as np

from tools.measures._ledger import FOLDER
from tools.measures._summary import machine, rounded, summary
from tools.measures.parity import parameter_sets
from tunefree_hil.base.errors import BenchError
from tunefree_hil.bench import load
from tunefree_hil.bench.batch import Batch, Job

VALUE = "30 s episodes per second per core in the compiled batch: vehicle, bus, controllers and grade (median of runs)"
EPISODE_S = 30.0
DOES = {
    "ours": "by-wire vehicle with delays, lags, noise, bus quantisation and state bits; LQR, MRAC, PID; grade; 100 Hz",
    "highway_env": "BicycleVehicle alone, on one lane, 100 Hz: no actuators, no controller, no grade; pure Python",
}
# Seconds an episode of 30 s at 100 Hz, one thread of another machine.
PUBLISHED = {
    "commonroad-vehicle-models 3.0.2, single-track, RK4, pure Python: plant only": 0.05,
    "f1tenth_gym vehicle_dynamics_st, numba called from Python, RK4: plant only": 0.020,
    "f1tenth_gym vehicle_dynamics_st inside a compiled RK4 loop: plant only": 0.0012,
    "highway-env 1.12.1 BicycleVehicle alone": 0.15,
    "highway-env highway-fast-v0, 20 vehicles, at 100 physics steps/s": 9.0,
}
HIGHWAY_ENV = "highway-env==1.12.1"
INSTALL = "install"
PEER = """
import json, math, time
from importlib.metadata import version
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.dynamics import BicycleVehicle
found = []
for _ in range({runs}):
    road = Road(network=RoadNetwork.straight_road_network(lanes=1, length=2000.0))
    car = BicycleVehicle(road, [0.0, 0.0], speed=8.0)
    started = time.perf_counter()
    for k in range(3000):
        car.act({{"acceleration": 0.0, "steering": 0.02 * math.sin(0.01 * k)}})
        car.step(0.01)
    found.append(time.perf_counter() - started)
print(json.dumps({{"seconds": found, "version": version("highway-env")}}))
"""


def measure(
    runs: int = 7,
    sets: int = 20,
    model: str = "",
    peer: str = "",
    bench: str = "bench_configs/mkz_steer.toml",
    folder: str = f"{FOLDER}/episodes",
) -> dict[str, Any]:
    """`sets` parameter vectors over the bench file's scenarios in one thread, `runs` times; drives scaled to 30 s.

    peer: a Python that has highway-env, whose vehicle is then run here, too. `install` makes an environment in `folder`
    and installs it there with pip; '' is the one that was made so, else this Python, if it has it.
    """
    before, loaded = machine(), load(bench)
    python = _peer(peer, Path(folder) / HIGHWAY_ENV)
    scenarios = [loaded.scenarios[name] for name in loaded.spec.scenarios]
    jobs = [Job(values, scenario) for values in parameter_sets(loaded, sets).values() for scenario in scenarios]
    rates = []
    with Batch(loaded, model, threads=1) as batch:
        batch.drive(jobs[: len(scenarios)])  # compiled, courses and noise made
        for _ in range(runs):
            started = time.perf_counter()
            driven = batch.drive(jobs)
            seconds = time.perf_counter() - started
            rates.append(sum(one.ticks for one in driven) * loaded.dt_s / EPISODE_S / seconds)
    other = _highway_env(python, runs, needed=bool(peer))
    detail = {
        "machine": before,
        "model": model or loaded.spec.model,
        "drives": len(jobs),
        "what_each_does": DOES,
        "highway_env": other,
        "published_s_an_episode": PUBLISHED,
    }
    if "episodes_per_s" in other:
        detail["times_highway_env"] = float(np.median(rates)) / other["episodes_per_s"]
    return summary(rates, "episodes/s", rounded(detail))


def _peer(asked: str, folder: Path) -> str:
    """The Python to run highway-env with; its environment is made in `folder` where that is asked for.

    Raises BenchError where it cannot be made.
    """
    own = folder / "bin" / "python"
    if asked == INSTALL and not (folder / "made").is_file():
        venv.create(folder, with_pip=True, clear=True)
        words = [str(own), "-m", "pip", "--disable-pip-version-check", "install", "--quiet", HIGHWAY_ENV]
        done = subprocess.run(words, stdout=sys.stderr, check=False)
        if done.returncode:
            hint = "pip's words stand above; or give --peer a Python that has it"
            raise BenchError(f"{HIGHWAY_ENV} does not install into {folder}", code="peer", hint=hint)
        (folder / "made").touch()
    if asked in ("", INSTALL):
        return str(own) if (folder / "made").is_file() else sys.executable
    return asked


def _highway_env(python: str, runs: int, *, needed: bool) -> dict[str, Any]:
    """Its vehicle's episodes per second, or how to have them. Raises BenchError where it is `needed` and fails."""
    done = subprocess.run([python, "-c", PEER.format(runs=runs)], capture_output=True, text=True, check=False)
    if done.returncode and not needed:
        return {"not_run": f"tools/measure episodes --peer {INSTALL}"}
    if done.returncode:
        last = (done.stderr.strip().splitlines() or [f"status {done.returncode}"])[-1]
        raise BenchError(f"{python} cannot run highway-env: {last}", code="peer")
    said = json.loads(done.stdout.splitlines()[-1])
    best = sorted(said["seconds"])
    return {"version": said["version"], "episodes_per_s": 1.0 / best[len(best) // 2], "fastest": 1.0 / best[0]}
