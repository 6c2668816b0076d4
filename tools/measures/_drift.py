"""Does MRAC drift? Its gains over a long straight drive with noise and offset sensors, where nothing excites them."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tools.measures._in_process import InProcess
from tunefree_hil.bench import Bench
from tunefree_hil.config.dump import to_toml
from tunefree_hil.config.load import load_scenario

SPEED_MPS = 10.0
# Offsets that a vehicle still has which nobody calibrated lately, beside the model's own noise.
BIAS = {"report.steer_rad": 0.02, "report.yaw_rate_radps": 0.0005, "ins.heading_rad": 0.001}
MINUTE_S = 60.0


class _Gains:
    """Sees every step; keeps the extremes, and at each full minute the gains and the largest steering command in it."""

    def __init__(self, dt_s: float) -> None:
        self.per_minute = round(MINUTE_S / dt_s)
        self.ticks = 0
        self.start = self.last = (0.0, 0.0)
        self.largest = [0.0, 0.0]
        self.minutes: list[tuple[float, float]] = []
        self.steer_rad: list[float] = []
        self._steer_rad = 0.0

    def __call__(self, state: Any) -> None:
        now = read_gains(state.inner)
        if self.ticks == 0:
            self.start = now
        self.ticks += 1
        self.largest = [max(old, abs(a - b)) for old, a, b in zip(self.largest, now, self.start, strict=True)]
        self._steer_rad = max(self._steer_rad, abs(float(state.last_steer_rad)))
        if self.ticks % self.per_minute == 0:
            self.minutes.append(now)
            self.steer_rad.append(self._steer_rad)
            self._steer_rad = 0.0
        self.last = now


def read_gains(inner: Any) -> tuple[float, float]:
    """(gain on the angle, gain on the command) in the state of either law."""
    if hasattr(inner, "angle_gain"):  # mrac_robust.py
        return float(inner.angle_gain), float(inner.command_gain)
    return float(inner.gains[0]), float(inner.command_gain)


def drift(bench: Bench, model: Path, values: Mapping[str, float], minutes: int) -> dict[str, Any]:
    """Kx and Kr over `minutes` straight on at 10 m/s; changes are against the gains at the start.

    second_half: change from the middle to the end, which an equilibrium does not have. steer_*: the largest steering
    command (rad at the wheel) of the second and the last minute: what a drift does. `model` has the offsets in it.
    """
    with tempfile.TemporaryDirectory() as folder:
        scenario = load_scenario(_straight(Path(folder), minutes))
        bench.scenarios[scenario.name] = scenario  # type: ignore[index] - ours alone
        gains = _Gains(bench.dt_s)
        done = InProcess(bench, str(model), gains).drive(scenario, values, keep=False)
    middle = gains.minutes[len(gains.minutes) // 2 - 1] if len(gains.minutes) > 1 else gains.start
    return {
        "minutes": done.ticks * bench.dt_s / MINUTE_S,
        "error": done.error,
        "kx_start": gains.start[0],
        "kr_start": gains.start[1],
        "kx_largest_change": gains.largest[0],
        "kr_largest_change": gains.largest[1],
        "kx_change_second_half": gains.last[0] - middle[0],
        "kr_change_second_half": gains.last[1] - middle[1],
        "kx_each_minute": [kx for kx, _ in gains.minutes],
        "steer_begin_rad": max(gains.steer_rad[1:2], default=None),
        "steer_end_rad": gains.steer_rad[-1] if gains.steer_rad else None,
    }


def _straight(folder: Path, minutes: int) -> Path:
    profile = {"t_s": [0.0, minutes * MINUTE_S]}
    path = folder / "straight.toml"
    data = {
        "schema": "tunefree.scenario/1",
        "name": f"straight_{minutes}_min",
        "noise_seed": 1,
        "start": {"speed_mps": SPEED_MPS},
        "speed": {**profile, "value": [SPEED_MPS, SPEED_MPS]},
        "curvature": {**profile, "value": [0.0, 0.0]},
    }
    path.write_text(to_toml(data), encoding="utf-8")
    return path
