"""A car of the exam as a bench's vehicle: by the contract of a plant alone, the same car as in its logs."""

from __future__ import annotations

import math
import subprocess
import sys
from collections import namedtuple
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.house import ROOT
from tests.tools.gap_exam.drives_for_tests import hidden
from tools.gap_exam.bench_sensors import SPEEDS, Past, late, report_step

SCRIPT = """
import sys
from pathlib import Path
from tunefree_hil.bench.vehicle import load_plant
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import Command, Disturbance, GEAR_DRIVE
from tunefree_hil.plant.types import BodyInput, Driver
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


SENSED = """
import sys
from pathlib import Path
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import Command, Disturbance, GEAR_DRIVE
from tunefree_hil.bench.vehicle import effects_of, plant_of
from tunefree_hil.config.load import load_model
from tunefree_hil.plant.types import BodyInput, Driver
from tunefree_hil.plant.vehicle import assemble, first_output, for_episode

def driven(folder):
    model = load_model(Path(folder))
    body = assemble(plant_of(model), {}, effects=effects_of(model.effects, 0.15), rest_frac=(0.15, 0.15))
    body = for_episode(body, Start(speed_mps=8.0))
    state, out = first_output(body, 0.01)
    outs = [out.measurement]
    for k in range(300):
        x = BodyInput(Command(0.35, 0.15, 0.4 if k > 60 else 0.0, GEAR_DRIVE), Driver(), Disturbance())
        state, out = body.block.step(body.block.params, state, x, 0.01)
        outs.append(out.measurement)
    return outs

clean, other = (driven(path) for path in sys.argv[1:3])
for part in ("report", "ins"):
    for name in getattr(clean[0], part)._fields:
        values = [[float(getattr(getattr(one, part), name)) for one in some] for some in (clean, other)]
        print(part, name, *(repr(x) for some in values for x in some[-3:] + some[20:22]))
"""


def sensed(clean: Path, other: Path) -> dict[str, tuple[list[float], list[float]]]:
    """Field -> its last values and some of the beginning, of both vehicles on the same commands."""
    words = [sys.executable, "-c", SENSED, str(clean.parent), str(other.parent)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    rows = (line.split() for line in done.stdout.splitlines())
    return {f"{row[0]}.{row[1]}": ([float(x) for x in row[2:7]], [float(x) for x in row[7:]]) for row in rows}


@pytest.mark.slow
def test_sensors_of_a_bench_say_what_their_effects_make_of_it(tmp_path: Path) -> None:
    clean = bench_model(tmp_path / "clean")
    words = ("--effect", "speed_scale=1.05", "--effect", "yaw_rate_bias=0.02", "--effect", "steer_report_offset=0.03")
    other = bench_model(tmp_path / "other", *words, "--effect", "accel_bias=-0.2")
    assert (clean.parent / "sensors.py").read_text() == (other.parent / "sensors.py").read_text()
    found = sensed(clean, other)
    wanted = {"report.speed_mps": lambda x: 1.05 * x, "report.wheel_rl_radps": lambda x: 1.05 * x,
              "report.yaw_rate_radps": lambda x: x + 0.02, "report.steer_rad": lambda x: x + 0.03,
              "report.accel_mps2": lambda x: x - 0.2}  # fmt: skip
    for name, (true, said) in found.items():
        change = wanted.get(name, lambda x: x)
        if not name.startswith("report.wheel") and all(math.isfinite(x) for x in true):
            assert said == pytest.approx([change(x) for x in true], abs=1e-9), name
    assert found["report.wheel_rl_radps"][1][0] == pytest.approx(1.05 * found["report.wheel_rl_radps"][0][0])


@pytest.mark.slow
def test_frames_of_a_bench_are_late_as_a_whole(tmp_path: Path) -> None:
    clean, other = bench_model(tmp_path / "clean"), bench_model(tmp_path / "late", "--effect", "report_latency=0.015")
    found = sensed(clean, other)
    for name in ("report.speed_mps", "report.yaw_rate_radps", "report.steer_rad"):
        true, said = found[name]
        assert said[2] == pytest.approx(0.5 * (true[0] + true[1]), abs=1e-9), name
    assert found["ins.speed_mps"][0] == found["ins.speed_mps"][1]
    assert found["report.gear"][0] == found["report.gear"][1]


class Turned(NamedTuple):
    """A record with an angle and with what has no value between two."""

    heading_rad: float
    gear: float


def test_a_late_record_turns_the_short_way() -> None:
    record = Turned
    records, said = late((), record(3.1, 4.0), 0.005, 0.01)
    assert said == record(pytest.approx(3.1), 4.0), "nothing is that old yet"
    _, said = late(records, record(-3.1, 5.0), 0.005, 0.01)
    assert abs(said.heading_rad) == pytest.approx(math.pi) and said.gear == 5.0


def test_a_filter_takes_its_time() -> None:
    record = namedtuple("record", (*SPEEDS, "yaw_rate_radps", "accel_mps2", "steer_rad"))
    past, said = Past(), None
    for k in range(21):
        past, said = report_step(hidden(yaw_rate_filter=0.2), past, record(*[0.0] * 5, float(k > 0), 0.0, 0.0), 0.01)
    assert said.yaw_rate_radps == pytest.approx(1.0 - math.exp(-1.0))


@pytest.mark.slow
def test_a_blind_one_may_be_any_of_the_catalogue(tmp_path: Path) -> None:
    for number in range(3):
        bench_model(tmp_path / str(number), "--blind", "--number", str(number))
    script = "import sys; sys.argv = ['x']\nfrom tools.gap_exam.bench_car import plant_of\n"
    script += "try: plant_of(1, 0.0, {'frame_loss': {'burst_s': 0.2}})\nexcept ValueError as e: print(e)"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.stdout.startswith("frame_loss: frames are the bench's own"), done.stderr
