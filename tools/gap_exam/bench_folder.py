"""The model folder of a car of the exam for a bench: what stands for the vehicle there, its answer under seal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tools.gap_exam.car import Noise
from tools.gap_exam.files import write, write_json
from tools.gap_exam.seal import seal

PLANT = Path(__file__).resolve().parent / "bench_car.py"
SENSORS = '''"""Sensors of this vehicle as two effects of a bench; what they do is under seal beside it."""

import sys
from functools import partial
from pathlib import Path

sys.path.insert(0, {root!r})

from tunefree_hil.base.contracts import Block, Effect, Port

from tools.gap_exam.bench_sensors import Past, hidden_in, ins_step, report_step


def _on(port, step):
    def make(params, rest):
        hidden = hidden_in(Path(__file__).with_name("hidden.json"))
        one = partial(_step, step, hidden)
        return Block(lambda params, dt_s: Past(), one, 0.0)

    return Effect(port, {{}}, {{}}, make, "")


def _step(step, hidden, params, state, x, dt_s):
    return step(hidden, state, x, dt_s)


REPORT = _on(Port.REPORT, report_step)
INS = _on(Port.INS, ins_step)
'''


def write_model(folder: Path, truth: dict[str, Any], noise: Noise, nonce: str) -> None:
    """model.toml, sensors.py and hidden.json. truth: seed, mismatch, effects of a vehicle.

    All vehicles have the same files, whatever is hidden in them.
    """
    write_json(folder / "hidden.json", seal(truth, nonce))
    write(folder / "sensors.py", SENSORS.format(root=str(PLANT.parents[2])))
    lines = ['schema = "tunefree.model/1"', 'vehicle = "car"', "", "[plant]", f'kind = "{PLANT}:VEHICLE"']
    lines += ['file = "hidden.json"', "", "[timing]", "report_ticks = 1", "command_ticks = 1", "phase_seed = 1", ""]
    lines.append("[noise]")
    lines += [f'"{name}" = {value:.4g}' for name, value in _noise(noise).items()]
    for export in ("REPORT", "INS"):
        lines += ["", "[[effects]]", f'name = "{folder.resolve() / "sensors.py"}:{export}"', "params = {}"]
    write(folder / "model.toml", "\n".join(lines) + "\n")


def _noise(n: Noise) -> dict[str, float]:
    wheels = {f"report.wheel_{at}_radps": n.wheel_radps for at in ("fl", "fr", "rl", "rr")}
    return {
        "report.throttle_frac": n.pedal_frac,
        "report.brake_frac": n.pedal_frac,
        "report.steer_rad": n.steer_rad,
        "report.speed_mps": n.speed_mps,
        **wheels,
        "report.accel_mps2": n.accel_mps2,
        "report.lateral_accel_mps2": n.accel_mps2,
        "report.yaw_rate_radps": n.yaw_radps,
        "ins.x_m": n.ins_m,
        "ins.y_m": n.ins_m,
        "ins.heading_rad": n.ins_heading_rad,
        "ins.speed_mps": n.ins_speed_mps,
        "ins.accel_mps2": n.ins_accel_mps2,
        "ins.yaw_rate_radps": n.ins_yaw_radps,
    }
