"""What a drive holds, in the quantities by which effects say what they need to be seen at all (base/contracts.py)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import QUANTITIES, Effect
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.gap.chain import Opened
from tunefree_hil.learn.runs import runs

Array = np.ndarray

MOVING_MPS = 2.0
WITHIN_S = 0.5
PEDAL_STEP, STEER_STEP, STEER_TURN = 0.03, 0.02, 0.01  # duty; shares of the steering limit
STRAIGHT_MPS2, CURVE_MPS2 = 0.3, 0.5
BRAKED_MPS = 3.0
OFF_REST = 0.005  # duty
CURVE, LEFT, RIGHT = "curve_s", "left_s", "right_s"  # of several drives one may hold the one side, another the other


class Excited(NamedTuple):
    """Of an effect: the least of what it needs that the drive holds, as a share (1: just enough). lacks: in words."""

    score: float
    enough: bool
    lacks: tuple[str, ...]


def excitation(effects: Mapping[str, Effect], held: Mapping[str, float]) -> dict[str, Excited]:
    """Of every effect; one without needs is always seen."""
    found = {}
    for name, effect in effects.items():
        shares = {need.quantity: held[need.quantity] / need.least for need in effect.needs if need.least > 0.0}
        least = {need.quantity: need.least for need in effect.needs}
        lacks = tuple(
            f"{held[quantity]:.3g} {QUANTITIES[quantity]}, {least[quantity]:g} are needed"
            for quantity, share in shares.items()
            if share < 1.0
        )
        score = min(shares.values(), default=1.0)
        found[name] = Excited(float(score), not lacks, lacks)
    return found


def held_by(drives: Sequence[Opened], vehicle: VehicleSpec) -> dict[str, float]:
    """Each of QUANTITIES, over all drives: times and counts summed up, of curves each side by
    itself, spans and highest values the most of any.
    """
    some = [_held_by(one, vehicle) for one in drives]
    summed = {name for name in QUANTITIES if name.endswith(("_s", "_moves", "_reversals")) or name == "brakings"}
    found = {name: (sum if name in summed else max)(one[name] for one in some) for name in QUANTITIES if name != CURVE}
    return {**found, CURVE: min(sum(one[side] for one in some) for side in (LEFT, RIGHT))}


def _held_by(opened: Opened, vehicle: VehicleSpec) -> dict[str, float]:
    x, dt_s, rest = opened.inputs, opened.dt_s, vehicle.nominal.rest_pedal_frac
    limit = max(vehicle.limits.steer_rad, 1e-6)
    throttle, brake, steer = x.commands[:, 0], x.commands[:, 1], x.commands[:, 2] / limit
    speed, within = x.speed_mps / opened.pace, max(round(WITHIN_S / dt_s), 1)
    moving = opened.moving & (speed > MOVING_MPS)
    side = speed * x.yaw_rate_radps  # of a model car as of a road car that drives alike
    idle = (throttle < rest + OFF_REST) & (brake < rest + OFF_REST)
    measure: dict[str, Callable[[], float]] = {
        "moving_s": lambda: dt_s * moving.sum(),
        "top_speed_mps": lambda: float(speed[opened.moving].max(initial=0.0)),
        "speed_span_mps": lambda: _span(speed[moving]),
        "straight_s": lambda: dt_s * (moving & (abs(side) < STRAIGHT_MPS2)).sum(),
        LEFT: lambda: dt_s * (moving & (side > CURVE_MPS2)).sum(),
        RIGHT: lambda: dt_s * (moving & (side < -CURVE_MPS2)).sum(),
        "lateral_accel_mps2": lambda: float(opened.pace * abs(side[moving]).max(initial=0.0)),
        "steer_moves": lambda: _moves(steer, STEER_STEP, within),
        "steer_reversals": lambda: _turns(steer, STEER_TURN),
        "steer_span_frac": lambda: _span(steer),
        "throttle_moves": lambda: _moves(throttle, PEDAL_STEP, within),
        "throttle_span_frac": lambda: _span(throttle),
        "throttle_s": lambda: dt_s * (throttle > rest + OFF_REST).sum(),
        "brake_moves": lambda: _moves(brake, PEDAL_STEP, within),
        "brake_span_frac": lambda: _span(brake),
        "brakings": lambda: _brakings(brake > rest + OFF_REST, speed),
        "coast_s": lambda: dt_s * (moving & idle).sum(),
    }
    return {name: float(told()) for name, told in measure.items()}


def _span(values: Array) -> float:
    return float(np.ptp(values)) if len(values) else 0.0


def _moves(values: Array, step: float, within: int) -> float:
    """Separate changes by a step within so many rows."""
    if len(values) <= within:
        return 0.0
    big = np.abs(values[within:] - values[:-within]) >= step
    return float(len(runs(big, 1)))


def _turns(values: Array, by: float) -> float:
    """How often a signal turns back by so much."""
    count, way, furthest = 0, 0, values[0] if len(values) else 0.0
    for value in values[::2].tolist():
        if way * (value - furthest) > 0.0 or way == 0:
            if way == 0 and abs(value - furthest) > by:
                way = 1 if value > furthest else -1
                furthest = value
            elif way:
                furthest = value
        elif abs(value - furthest) > by:
            count, way, furthest = count + 1, -way, value
    return float(count)


def _brakings(braked: Array, speed: Array) -> float:
    """Stretches of braking that take BRAKED_MPS off the speed."""
    return float(sum(speed[begin] - speed[end - 1] >= BRAKED_MPS for begin, end in runs(braked, 1)))
