"""The same bits compiled: 300 ticks of each assembled body, and of the by-wire unit, in a process of their own."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
TICKS = 300


def bits(record: Any) -> str:
    """Every number of nested records as hex; -0.0 is 0.0."""
    if isinstance(record, tuple):
        return " ".join(bits(value) for value in record)
    return (float(record) + 0.0).hex()


def body_lines(kind: str, chosen: str) -> list[str]:
    """chosen: 'none' of the effects, 'all' of them, or all of them 'neutral'."""
    from tests.effects.shared import EFFECTS, strong
    from tests.plant.drives import REST, car, command, drive
    from tunefree_hil.base.course import Start
    from tunefree_hil.base.records import Disturbance
    from tunefree_hil.plant.measurement.sensors import noise_table

    names = sorted(EFFECTS) if chosen != "none" else ()
    effects = tuple((EFFECTS[name], strong(name) if chosen == "all" else {}) for name in names)
    outputs = drive(
        car(kind, effects=effects, ins_latency_s=0.02),
        lambda t: command(0.3 if t < 1.2 else REST, REST if t < 1.6 else 0.3, 3.0 * math.sin(2.0 * t)),
        0.01 * TICKS,
        start=Start(2.0, -1.0, 3.0, 4.0),
        road=Disturbance(0.02, 0.8, 0.03, -0.4),
        noise=noise_table({"ins.x_m": 0.01, "report.speed_mps": 0.02}, {"report.accel_mps2": 0.01}, TICKS, 3),
    )
    return [bits(out) for out in outputs]


def bywire_lines() -> list[str]:
    from tests.plant.actuation.test_bywire import NOTHING, Bench, said
    from tunefree_hil.plant.types import Driver

    bench = Bench()
    driver, foot = Driver(), Driver(brake_frac=0.25)
    lines = []
    for k in range(TICKS):
        bench.steer_rad = math.sin(0.1 * k)
        heard = said(0.2 + 0.001 * k, 0.15 + 0.002 * (k % 90), -1.0 + 0.01 * k, brake_clear=float(k == 150))
        quiet = k % 3 == 2 or k > 280
        lines.append(bits(bench.tick(NOTHING if quiet else heard, foot if 100 < k < 120 else driver)))
    return lines


def learned_lines() -> list[str]:
    """The chassis of every learned kind, weights drawn: speeding up, turning, stopping."""
    from tempfile import TemporaryDirectory

    from tests.plant.model_files import KINDS, plant_of
    from tunefree_hil.base.contracts import BodyChange
    from tunefree_hil.base.course import Start
    from tunefree_hil.base.records import GEAR_DRIVE, Actuation, Disturbance
    from tunefree_hil.plant.types import ChassisInput

    lines = []
    for kind in KINDS:
        with TemporaryDirectory() as folder:
            block = plant_of(Path(folder), kind, 3).make({}, BodyChange(grade_rad=0.01))
        params = block.params._replace(start=Start(1.0, 2.0, 0.3, 6.0))
        state = block.init(params, 0.01)
        for k in range(TICKS):
            pedals = (0.35, 0.15) if k < 100 else (0.15, 0.15 + 0.001 * min(k - 100, 150))
            act = Actuation(*pedals, 3.0 * math.sin(0.03 * k), GEAR_DRIVE)
            state, motion = block.step(params, state, ChassisInput(act, Disturbance(0.02, 0.8, 0.03, -0.4)), 0.01)
            lines.append(bits(motion))
    return lines


# The effects are the same functions around either chassis: to compile all of them once more takes a minute.
CASES = {
    "learned": learned_lines,
    "physics": lambda: body_lines("physics", "none"),
    "reference": lambda: body_lines("reference", "none"),
    "physics_effects": lambda: body_lines("physics", "all"),
    "physics_neutral": lambda: body_lines("physics", "neutral"),
    "bywire": bywire_lines,
}


def lines_of(cases: Iterable[str]) -> str:
    """For a process of their own."""
    return json.dumps({case: CASES[case]() for case in cases})


@cache
def compiled_lines(case: str) -> dict[str, list[str]]:
    """A case in a process that compiles its kernels, and with it the one that needs the very same."""
    environment = {**os.environ, "TUNEFREE_JIT": "1", "PYTHONPATH": str(ROOT)}
    cases = [one for one in CASES if one.replace("_neutral", "_effects") == case]
    code = f"from tests.plant.test_jit import lines_of; print(lines_of({cases}))"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


@pytest.mark.compiled
@pytest.mark.timeout(300)
@pytest.mark.parametrize("case", CASES)
def test_compiled_says_the_same_bits(case: str) -> None:
    """Effects that are neutral say, compiled, what the car without any says uncompiled."""
    compiled = compiled_lines(case.replace("_neutral", "_effects"))[case]
    plain = CASES[case.removesuffix("_neutral")]()
    assert len(plain) >= TICKS
    different = [k for k, (a, b) in enumerate(zip(plain, compiled, strict=True)) if a != b]
    assert not different, f"first at tick {different[0]}:\n{plain[different[0]]}\n{compiled[different[0]]}"
    assert len(set(plain)) > TICKS // 8, "the case moves"
