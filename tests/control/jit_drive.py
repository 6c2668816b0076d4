"""Run by test_jit.py in a process of its own: drives every variant of the controller, prints a hash of all it says.

The drive has a start beside the path, a bend, noise, a re-plan, a stop, and at the end numbers that are not finite.
"""

from __future__ import annotations

import hashlib
import struct
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

from conftest import DT_S, Car, linear_map, make_course

from tunefree_hil.control.build import build
from tunefree_hil.control.cascade import ControllerInput
from tunefree_hil.control.contract import LeadLag, Settings, VehicleConstants
from tunefree_hil.control.parameters import BASELINES

VARIANTS: dict[str, tuple[str, dict[str, float], Settings]] = {
    "shipped": ("as_shipped", {"riccati": 1.0}, Settings(lead_lag=LeadLag(1.0, 2.0, 0.5, 0.3))),
    "order 1": ("mrac_on_look_ahead", {"mrac.p": 0.03}, Settings(mrac_dead_zone=0.2)),
    "order 2": ("mrac_on", {}, Settings(mrac_order=2)),
    "order 3": ("mrac_on", {"mrac.p": 0.003}, Settings(mrac_order=3, mrac_dead_zone=0.2)),
    "paper": ("mrac_on", {}, Settings(mrac_form="paper")),
}
TICKS = 1500


def flatten(value: Any) -> list[float]:
    """All numbers of nested tuples and buffers, in order."""
    if isinstance(value, (int, float)):
        return [float(value)]
    return [number for part in value for number in flatten(part)]


def drive(name: str) -> str:
    """SHA-256 over the decisions and the last state of one variant."""
    base, changes, settings = VARIANTS[name]
    course = make_course(
        TICKS * DT_S,
        lambda t: min(6.0, 1.5 * t) if t < 10.0 else max(0.0, 6.0 - 2.0 * (t - 10.0)),
        lambda station: 0.05 if 10.0 < station < 30.0 else -0.02,
    )
    block = build({**BASELINES[base], **changes}, VehicleConstants(), linear_map(), course, settings=settings)
    state = block.init(block.params, DT_S)
    car = Car(-0.1, 0.3, 0.02, 0.0)
    digest, seed, replans = hashlib.sha256(), 12345, 0.0
    for k in range(TICKS):
        seed = (1103515245 * seed + 12345) % 2147483648
        noise = seed / 2147483648 - 0.5
        nudged = car._replace(x_m=car.x_m + 0.02 * noise, y_m=car.y_m + (0.7 if k == 600 else 0.02 * noise))
        seen = nudged._replace(x_m=float("inf")) if k == TICKS - 1 else nudged
        state, decision = block.step(block.params, state, ControllerInput(k, seen.measurement()), DT_S)
        numbers = flatten(decision)
        digest.update(struct.pack(f"<{len(numbers)}d", *(0.0 if number != number else number for number in numbers)))
        replans += decision.tracking.replan
        car = nudged.moved(decision.command.steer_rad / 16.0 * 0.9, decision.command.accel_mps2 * 0.9)
    digest.update(struct.pack(f"<{len(flatten(state))}d", *flatten(state)))
    return f"{name} replans={replans:.0f} last_code={decision.error_code:.0f} {digest.hexdigest()}"


if __name__ == "__main__":
    for variant in sys.argv[1:] or VARIANTS:
        print(drive(variant))
