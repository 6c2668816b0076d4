"""A car of the exam as a bench's vehicle: by the contract of a plant alone, the same car as in its logs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.house import ROOT

SCRIPT = """
import sys
from pathlib import Path
from tunefree_hil.bench.vehicle import load_plant
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import Command, Disturbance, GEAR_DRIVE
from tunefree_hil.plant.body import BodyInput, Driver
from tunefree_hil.plant.vehicle import assemble, first_output, for_episode

def driven(path, throttle, steer, seconds=3.0):
    plant = load_plant(f"{sys.argv[1]}:VEHICLE").open(Path(path))
    body = for_episode(assemble(plant, {}, rest_frac=(0.15, 0.15)), Start(speed_mps=8.0))
    state, out = first_output(body, 0.01)
    outs = []
    for _ in range(round(seconds / 0.01)):
        x = BodyInput(Command(throttle, 0.15, steer, GEAR_DRIVE), Driver(), Disturbance())
        state, out = body.block.step(body.block.params, state, x, 0.01)
        outs.append(out)
    return outs

clean, late = (driven(path, 0.35, 0.4) for path in sys.argv[2:])
begins = [next(k for k, out in enumerate(some) if out.actuation.steer_rad > 0.01) for some in (clean, late)]
last = clean[-1]
print(begins[1] - begins[0], last.motion.yaw_rate_radps > 0.0, last.motion.speed_mps > 8.5,
      abs(last.measurement.report.steer_rad - 0.4) < 1e-3, last.motion.lateral_accel_mps2 > 0.5, "numba" in sys.modules)
"""


def bench_model(folder: Path, *effect: str) -> Path:
    words = [sys.executable, "-m", "tools.gap_exam", "bench", "--domain", "dev:tests", "--out", str(folder)]
    subprocess.run([*words, *effect], cwd=ROOT, check=True, capture_output=True, timeout=100)
    return folder / "hidden.json"


@pytest.mark.slow
def test_the_bench_drives_it_with_what_is_hidden(tmp_path: Path) -> None:
    """In a process of its own: there the exam's loops are plain Python, as in a node."""
    clean = bench_model(tmp_path / "clean")
    late = bench_model(tmp_path / "late", "--effect", "steer_dead_time=0.12")
    assert "steer" not in late.read_text(), "under seal"
    assert "steer_dead" not in (tmp_path / "late" / "model.toml").read_text()
    words = [sys.executable, "-c", SCRIPT, str(ROOT / "tools/gap_exam/bench_car.py"), str(clean), str(late)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.stdout == "12 True True True True False\n", done.stderr


@pytest.mark.slow
def test_a_blind_one_is_never_of_sensing(tmp_path: Path) -> None:
    script = "import sys; sys.argv = ['x']\nfrom tools.gap_exam.bench_car import plant_of\n"
    script += "try: plant_of(1, 0.0, {'speed_scale': {'scale_frac': 1.1}})\nexcept ValueError as e: print(e)"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.stdout == "speed_scale: sensors are the bench's own, behind the plant\n", done.stderr
    for number in range(3):
        bench_model(tmp_path / str(number), "--blind", "--number", str(number))
