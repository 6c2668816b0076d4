"""How many drives a core does in a second, beside other vehicle simulators for Python, and what each of them does."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from typing import Any

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
# Seconds an episode of 30 s at 100 Hz, one thread of another machine (opt_anchors D).
PUBLISHED = {
    "commonroad-vehicle-models 3.0.2, single-track, RK4, pure Python: plant only": 0.05,
    "f1tenth_gym vehicle_dynamics_st, numba called from Python, RK4: plant only": 0.020,
    "f1tenth_gym vehicle_dynamics_st inside a compiled RK4 loop: plant only": 0.0012,
    "highway-env 1.12.1 BicycleVehicle alone": 0.15,
    "highway-env highway-fast-v0, 20 vehicles, at 100 physics steps/s": 9.0,
}
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
    runs: int = 7, sets: int = 20, model: str = "", peer: str = "", bench: str = "bench_configs/mkz_steer.toml"
) -> dict[str, Any]:
    """`sets` parameter vectors over the bench file's scenarios in one thread, `runs` times; drives scaled to 30 s.

    peer: a Python in which highway-env is installed (`pip install highway-env`), whose vehicle is then run here, too;
    '' is this Python, if it has it.
    """
    before, loaded = machine(), load(bench)
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
    other = _highway_env(peer, runs)
    detail = {
        "machine": before,
        "model": model or loaded.spec.model,
        "drives": len(jobs),
        "what_each_does": DOES,
        "highway_env": other,
        "published_s_an_episode": PUBLISHED,
    }
    return summary(rates, "episodes/s", rounded(detail))


def _highway_env(python: str, runs: int) -> dict[str, Any]:
    """Its vehicle's episodes per second, or how to have them. Raises BenchError where the named Python cannot do it."""
    words = [python or sys.executable, "-c", PEER.format(runs=runs)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode and not python:
        return {"not_run": "pip install highway-env in an environment of its own, then --peer ITS/bin/python"}
    if done.returncode:
        raise BenchError(f"{python} cannot run highway-env: {done.stderr.strip().splitlines()[-1]}", code="peer")
    said = json.loads(done.stdout.splitlines()[-1])
    best = sorted(said["seconds"])
    return {"version": said["version"], "episodes_per_s": 1.0 / best[len(best) // 2], "fastest": 1.0 / best[0]}
