"""Drives that nobody has driven: what the driver wants, drawn from a seed. Ordinary ones, and ones that excite.

An ordinary drive is traffic: speeds held, bends, stops. An excited one goes through manoeuvres that show actuators and
tyres (steps, chirps, small swings about nought and about an offset, circles, coasting, brake steps) in an order and
with sizes of its own. Both stay within the car's limits; a piece of a drive is as long as it is asked for.
"""

from __future__ import annotations

import math

import numpy as np

from tools.gap_exam.car import Vehicle
from tools.gap_exam.driver import TICK_S
from tools.gap_exam.simulate import Plan

SPEEDS_MPS, QUICK_MPS = (3.0, 18.0), (18.5, 22.0)
TIGHTEST_1PM = 0.12
SIDE_MPS2 = (0.6, 3.0)
Array = np.ndarray


class _Wishes:
    """A plan that grows manoeuvre by manoeuvre."""

    def __init__(self, vehicle: Vehicle, rng: np.random.Generator) -> None:
        self.rng = rng
        self.ratio, self.length = vehicle.sheet["steer_ratio"], vehicle.sheet["wheelbase_m"]
        self.throttle_most = vehicle.limits.throttle_frac - vehicle.car.rest_frac
        self.brake_most = vehicle.limits.brake_frac - vehicle.car.rest_frac
        self.brake_1mps2 = vehicle.car.mass_kg / vehicle.car.brake_n  # duty that gives about 1 m/s2
        self.parts: list[tuple[Array, ...]] = []

    def add(
        self, seconds: float, speed: float, *, curvature: float | Array = 0.0, steer: Array | None = None,
        pedal: Array | float | None = None,
    ) -> None:  # fmt: skip
        """Hold a speed for some seconds; curvature [1/m]; steer [rad]: no feedback; pedal over rest, brake negative."""
        n = max(1, round(seconds / TICK_S))

        def row(value: float | Array) -> Array:
            return np.full(n, value) if np.ndim(value) == 0 else np.asarray(value)[:n]

        opened = np.full(n, 0.0 if steer is None else 1.0)
        extra = np.zeros(n) if steer is None else row(steer)
        press = np.full(n, np.nan) if pedal is None else row(pedal)
        self.parts.append((row(speed), row(curvature), extra, opened, press))

    def seconds(self) -> float:
        return TICK_S * sum(len(part[0]) for part in self.parts)

    def plan(self, duration_s: float, start_mps: float) -> Plan:
        n = round(duration_s / TICK_S)
        speed, curvature, steer, opened, pedal = (
            np.concatenate(column)[:n] for column in zip(*self.parts, strict=True)
        )
        tremor = _smooth(self.rng.standard_normal(n), 0.25)
        return Plan(speed, curvature, steer, opened, pedal, tremor, start_mps)

    def curvature(self, speed: float, side_mps2: float | None = None) -> float:
        """A signed curvature that a speed allows."""
        side = self.rng.uniform(*SIDE_MPS2) if side_mps2 is None else side_mps2
        return float(self.rng.choice((-1, 1))) * min(side / max(speed, 2.0) ** 2, TIGHTEST_1PM)

    def wheel(self, speed: float, side_mps2: float) -> float:
        """The steering wheel's angle that gives about so much lateral acceleration."""
        return self.ratio * min(self.length * side_mps2 / max(speed, 2.0) ** 2, 0.3)


def _smooth(x: Array, tau_s: float) -> Array:
    share, y, out = TICK_S / (TICK_S + tau_s), 0.0, np.empty(len(x))
    for k, value in enumerate(x):
        y += share * (value - y)
        out[k] = y
    return out / max(float(out.std()), 1e-9)


def _bend(seconds: float, curvature: float) -> Array:
    """A bend with its transitions."""
    t = np.linspace(0.0, 1.0, round(seconds / TICK_S))
    return curvature * np.clip(1.6 * np.sin(math.pi * t), 0.0, 1.0)


def _times(seconds: float) -> Array:
    return np.arange(round(seconds / TICK_S)) * TICK_S


def ordinary(vehicle: Vehicle, duration_s: float, rng: np.random.Generator) -> Plan:
    """Traffic: stretches at some speed with bends in them, and stops."""
    w = _Wishes(vehicle, rng)
    speed = start = rng.uniform(4.0, 10.0)
    while w.seconds() < duration_s:
        for _ in range(rng.integers(1, 4)):
            kind = rng.choice(("straight", "bend", "swerve"), p=(0.35, 0.45, 0.2))
            seconds = rng.uniform(2.5, 7.0)
            if kind == "straight":
                w.add(seconds, speed)
            elif kind == "bend":
                w.add(seconds, speed, curvature=_bend(seconds, w.curvature(speed)))
            else:
                there = _bend(0.5 * seconds, w.curvature(speed, rng.uniform(0.6, 2.0)))
                w.add(seconds, speed, curvature=np.concatenate([there, -there, [0.0] * 2]))
        if rng.random() < 0.22:
            w.add(rng.uniform(5.0, 9.0), 0.0)
        speed = rng.uniform(*SPEEDS_MPS)
        w.add(rng.uniform(3.0, 6.0), speed)
    return w.plan(duration_s, start)


def excited(vehicle: Vehicle, duration_s: float, rng: np.random.Generator) -> Plan:
    """Manoeuvres in an order of their own, again and again until the time is over."""
    w = _Wishes(vehicle, rng)
    start = rng.uniform(4.0, 8.0)
    menu = (_steps, _chirp, _swings, _circle, _push, _coast, _brakes, _stop, _weave)
    while w.seconds() < duration_s:
        for place in rng.permutation(len(menu)):
            menu[place](w)
    return w.plan(duration_s, start)


def _steps(w: _Wishes) -> None:
    """Steps of the steering to both sides, of different sizes."""
    speed = w.rng.uniform(4.0, 15.0)
    w.add(3.0, speed)
    held = [np.full(round(w.rng.uniform(0.8, 1.5) / TICK_S), sign * w.wheel(speed, w.rng.uniform(0.7, 3.0)))
            for sign in (1, -1, 1, -1, 0)]  # fmt: skip
    steer = np.concatenate(held)
    w.add(len(steer) * TICK_S, speed, steer=steer)


def _chirp(w: _Wishes) -> None:
    """From a slow to a quick swing of the steering wheel."""
    speed, seconds = w.rng.uniform(6.0, 16.0), w.rng.uniform(7.0, 10.0)
    low, high = 0.25, w.rng.uniform(1.6, 2.6)
    t = _times(seconds)
    phase = 2.0 * math.pi * low * seconds / math.log(high / low) * ((high / low) ** (t / seconds) - 1.0)
    w.add(3.0, speed)
    w.add(seconds, speed, steer=w.wheel(speed, w.rng.uniform(0.8, 1.6)) * np.sin(phase))


def _swings(w: _Wishes) -> None:
    """Small swings about straight ahead, then about an offset."""
    speed = w.rng.uniform(7.0, 14.0)
    size, hertz = w.wheel(speed, w.rng.uniform(0.25, 0.6)), w.rng.uniform(0.35, 0.7)
    t = _times(4.0)
    w.add(2.5, speed)
    w.add(4.0, speed, steer=size * np.sin(2.0 * math.pi * hertz * t))
    offset = w.wheel(speed, w.rng.uniform(1.0, 2.0)) * float(w.rng.choice((-1, 1)))
    w.add(4.0, speed, steer=offset * np.clip(t, 0.0, 1.0) + size * np.sin(2.0 * math.pi * hertz * t))


def _circle(w: _Wishes) -> None:
    """A part of a circle."""
    speed = w.rng.uniform(3.0, 14.0)
    w.add(3.0, speed)
    w.add(w.rng.uniform(4.5, 7.0), speed, curvature=w.curvature(speed, w.rng.uniform(1.5, 3.2)))


def _push(w: _Wishes) -> None:
    """Steps of the throttle, small to large, with the pedals let go between them."""
    w.add(2.5, w.rng.uniform(3.0, 7.0))
    for _ in range(3):
        duty = w.throttle_most * w.rng.uniform(0.08, 0.85)
        w.add(w.rng.uniform(0.9, 1.8), 8.0, pedal=duty)
        w.add(w.rng.uniform(0.5, 1.0), 8.0, pedal=0.0)


def _coast(w: _Wishes) -> None:
    """Roll out from some speed with both pedals let go."""
    w.add(5.0, w.rng.uniform(10.0, 18.0))
    w.add(w.rng.uniform(4.0, 6.5), 9.0, pedal=0.0)


def _brakes(w: _Wishes) -> None:
    """Steps of the brake, light to firm."""
    w.add(4.5, w.rng.uniform(11.0, 17.0))
    for _ in range(3):
        duty = min(w.brake_1mps2 * w.rng.uniform(0.35, 3.2), w.brake_most)
        w.add(w.rng.uniform(0.7, 1.2), 8.0, pedal=-duty)
        w.add(w.rng.uniform(0.5, 0.9), 8.0, pedal=0.0)


def _stop(w: _Wishes) -> None:
    """A firm stop, and away again."""
    w.add(3.5, w.rng.uniform(7.0, 13.0))
    seconds = 4.5
    press = np.full(round(seconds / TICK_S), -w.brake_1mps2 * w.rng.uniform(2.0, 3.6))
    w.add(seconds, 0.0, pedal=press)
    w.add(2.0, w.rng.uniform(3.0, 6.0), pedal=np.clip(_times(2.0) * 0.1, 0.0, 0.12))


def _weave(w: _Wishes) -> None:
    """Bends in a row while speed changes."""
    speed = w.rng.uniform(5.0, 12.0)
    for _ in range(2):
        seconds = w.rng.uniform(2.0, 3.5)
        w.add(seconds, speed, curvature=_bend(seconds, w.curvature(speed)))
        speed = w.rng.uniform(5.0, 14.0)


def quick(vehicle: Vehicle, duration_s: float, rng: np.random.Generator) -> Plan:
    """Faster than all other drives: bends, swerves and changes of speed between 18.5 and 22 m/s, no stops."""
    w = _Wishes(vehicle, rng)
    speed = start = rng.uniform(*QUICK_MPS)
    while w.seconds() < duration_s:
        seconds = rng.uniform(2.5, 5.0)
        there = _bend(seconds, w.curvature(speed))
        w.add(seconds, speed, curvature=there)
        w.add(seconds, speed, curvature=-there)
        w.add(rng.uniform(1.0, 2.0), speed, pedal=0.0)
        speed = rng.uniform(*QUICK_MPS)
        w.add(rng.uniform(2.0, 4.0), speed)
    return w.plan(duration_s, start)


KINDS = {"ordinary": ordinary, "excited": excited, "quick": quick}
