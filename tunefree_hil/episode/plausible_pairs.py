"""Pairs of redundant columns of a test drive: integrals over windows (episode/plausible.py)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.base.records import WHEEL_FIELDS

WINDOW_S = 0.5
Array = NDArray[np.float64]
Sample = tuple[Array, Array]  # stamps, values


class Pair(NamedTuple):
    """One comparison: two groups of fields, allowed factor of the second by the first, least movement to be judged."""

    check: str
    first: tuple[str, ...]
    second: tuple[str, ...]
    allowed: tuple[float, float]
    least: float
    windows: Callable[[Sequence[Sample], Sequence[Sample], Array], tuple[Array, Array]]
    centred: bool = False  # a constant offset (gravity, a sensor's bias) is ignored


def _integral(sample: Sample, edges: Array) -> Array:
    """The integral over each window (trapezoids)."""
    times, values = sample
    total = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(times))])
    return np.diff(np.interp(edges, times, total), axis=1)[:, 0]


def _change(sample: Sample, edges: Array) -> Array:
    return np.diff(np.interp(edges, *sample), axis=1)[:, 0]


def _distance(first: Sequence[Sample], second: Sequence[Sample], edges: Array) -> tuple[Array, Array]:
    """Speed's integral, and the distance between the positions at the window's ends."""
    speed = (first[0][0], np.abs(first[0][1]))
    return _integral(speed, edges), np.hypot(_change(second[0], edges), _change(second[1], edges))


def _turn(first: Sequence[Sample], second: Sequence[Sample], edges: Array) -> tuple[Array, Array]:
    """Yaw rate's integral, and the change of a heading that may wrap."""
    times, heading = second[0]
    return _integral(first[0], edges), _change((times, np.unwrap(heading)), edges)


def _speeding(first: Sequence[Sample], second: Sequence[Sample], edges: Array) -> tuple[Array, Array]:
    return _integral(first[0], edges), _change(second[0], edges)


def _same(first: Sequence[Sample], second: Sequence[Sample], edges: Array) -> tuple[Array, Array]:
    return _integral(first[0], edges), _integral(second[0], edges)


def _steering(yaw: str, wheelbase_m: float, steer_ratio: float) -> Pair:
    """Speed times the kinematic curvature against a yaw rate; understeer makes the factor small."""

    def windows(first: Sequence[Sample], second: Sequence[Sample], edges: Array) -> tuple[Array, Array]:
        (times, steer), speed = first
        curvature = np.tan(np.clip(steer / steer_ratio, -1.4, 1.4)) / wheelbase_m
        return _integral((times, curvature * np.interp(times, *speed)), edges), _integral(second[0], edges)

    return Pair("steer_and_yaw_rate", ("report.steer_rad", "report.speed_mps"), (yaw,), (0.3, 2.0), 0.3, windows)


def _rolling(wheel_radius_m: float) -> Pair:
    """The distance from four wheel speeds against the integral of speed; slip and the radius are a few per cent."""

    def windows(first: Sequence[Sample], second: Sequence[Sample], edges: Array) -> tuple[Array, Array]:
        ways = [wheel_radius_m * _integral(wheel, edges) for wheel in first]
        return np.mean(ways, axis=0), _integral(second[0], edges)

    wheels = tuple(f"report.{name}" for name in WHEEL_FIELDS)
    return Pair("wheels_and_speed", wheels, ("report.speed_mps",), HALF, 2.0, windows)


def _course(first: Sequence[Sample], second: Sequence[Sample], edges: Array) -> tuple[Array, Array]:
    """The change of heading, and that of the course over ground, from one moving window to the next."""
    times, heading = first[0]
    dx, dy = _change(second[0], edges), _change(second[1], edges)
    distance = np.hypot(dx, dy)
    moving = distance > 0.2 * distance.max(initial=0.0)
    pairs = moving[1:] & moving[:-1] & (np.abs(np.diff(edges[:, 0]) - WINDOW_S) < 1e-6)
    middle = np.interp(edges.mean(axis=1), times, np.unwrap(heading))
    turned = np.diff(np.arctan2(dy, dx))
    return np.diff(middle)[pairs], (np.mod(turned + np.pi, 2.0 * np.pi) - np.pi)[pairs]


PLACE = ("ins.x_m", "ins.y_m")
HALF = (1.0 / 1.5, 1.5)
WIDE = (0.45, 2.2)  # an acceleration's own noise makes its factor small
PAIRS = (
    *(Pair("speed_and_path", (name,), PLACE, HALF, 2.0, _distance) for name in ("report.speed_mps", "ins.speed_mps")),
    *(
        Pair("yaw_rate_and_heading", (name,), ("ins.heading_rad",), HALF, 0.3, _turn)
        for name in ("report.yaw_rate_radps", "ins.yaw_rate_radps")
    ),
    *(
        Pair("accel_and_speed", (f"{group}.accel_mps2",), (f"{other}.speed_mps",), WIDE, 2.0, _speeding, centred=True)
        for group, other in (("report", "report"), ("ins", "ins"), ("report", "ins"))
    ),
    Pair("heading_and_path", ("ins.heading_rad",), PLACE, (0.5, 2.0), 0.5, _course),
    Pair("same_quantity", ("report.speed_mps",), ("ins.speed_mps",), HALF, 2.0, _same),
    Pair("same_quantity", ("report.yaw_rate_radps",), ("ins.yaw_rate_radps",), HALF, 0.3, _same),
    Pair("same_quantity", ("report.steer_command_rad",), ("report.steer_rad",), (0.4, 2.5), 0.3, _same),
    Pair("same_quantity", ("command.steer_rad",), ("report.steer_rad",), (0.4, 2.5), 0.3, _same),
)


def pairs_of(wheelbase_m: float | None, steer_ratio: float | None, wheel_radius_m: float | None) -> Iterator[Pair]:
    """All comparisons; those that need one of the car's constants where it is known."""
    yield from PAIRS
    if wheelbase_m and steer_ratio:
        for yaw in ("report.yaw_rate_radps", "ins.yaw_rate_radps"):
            yield _steering(yaw, wheelbase_m, steer_ratio)
    if wheel_radius_m:
        yield _rolling(wheel_radius_m)
