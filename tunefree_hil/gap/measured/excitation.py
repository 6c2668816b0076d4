"""What a drive holds, in the quantities by which effects say what they need to be seen at all (base/contracts.py).

Whether logs hold enough to be asked for a name: long enough, and driven.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import QUANTITIES, Effect
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GEAR_DRIVE
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.gap.measured.blocks import (
    BLOCK_S,
    FEWEST,
    FEWEST_DRIVEN,
    GUARD_S,
    SHORTEST_S,
    Blocks,
    block_s_of,
    blocks_of,
)
from tunefree_hil.gap.measured.chain import Opened
from tunefree_hil.gap.measured.observability import OUTPUTS
from tunefree_hil.gap.measured.targets import LEAST_MPS
from tunefree_hil.gap.model.graph import CHANNELS
from tunefree_hil.learn.drives.runs import runs

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


LEAST_TOLD = 0.05  # of the time, that a cause is named
LEAST_S = FEWEST * SHORTEST_S * (1.0 + GUARD_S / BLOCK_S)  # that a question's logs have to hold


def refuse_untold(drives: Sequence[Opened]) -> None:
    """Raises InputError for logs that are too short, and for a car that stands: its few moving rows would be all that
    is fitted to.
    """
    ticks, dt_s = [one.ticks for one in drives], drives[0].dt_s
    blocks, block_s = blocks_of(ticks, dt_s), block_s_of(ticks, dt_s)
    if blocks.count < FEWEST:
        held = f"{blocks.count} blocks of {block_s:.3g} s"
        raise InputError(
            f"the logs hold {held}; {FEWEST} are needed to fit, to choose and to prove",
            code="too_short",
            key="LOG",
            hint=f"record {LEAST_S:.0f} s or more; twice that tells more",
        )
    driven = sum(_driven(one, blocks, i) for i, one in enumerate(drives))
    if driven < FEWEST_DRIVEN:
        raise InputError(
            f"the car moves above walking pace in {driven} stretches of {block_s:.3g} s, as far as the logs say; "
            f"{FEWEST_DRIVEN} are needed{_why(drives)}",
            code="standing",
            key="LOG",
            hint=f"drive for {LEAST_S:.0f} s or more, in gear, with the by-wire unit obeying; a report that falls "
            "silent is worse than none: a log that has it nowhere is read without it",
        )


def _why(drives: Sequence[Opened]) -> str:
    """What takes most of the time away from driving, the greatest first, in words; '' where nothing does."""
    seconds: dict[str, float] = {}
    for one in drives:
        source = "ins.speed_mps" if one.inputs.by_ins else "report.speed_mps"
        names = [source, *(f"report.{OUTPUTS[channel]}" for channel in CHANNELS)]
        causes = {f"{name} is silent": ~one.signals[name].there for name in names if name in one.signals}
        causes["the car stands"] = one.inputs.speed_mps <= LEAST_MPS * one.pace
        causes["it is in no forward gear"] = one.inputs.gear < GEAR_DRIVE
        for words, rows in causes.items():
            seconds[words] = seconds.get(words, 0.0) + float(rows.sum()) * one.dt_s
    whole = sum(one.ticks * one.dt_s for one in drives)
    most = sorted((some, words) for words, some in seconds.items() if some > LEAST_TOLD * whole)[::-1]
    said = ", ".join(f"{words} for {some:.0f} s" for some, words in most)
    return f" (of {whole:.0f} s {said})" if said else ""


def _driven(one: Opened, blocks: Blocks, drive: int) -> int:
    """Blocks of a drive in which the car drives most of the time."""
    moves, mine = one.moving & (one.inputs.speed_mps > LEAST_MPS * one.pace), blocks.drives == drive
    ends = zip(blocks.begins[mine], blocks.ends[mine], strict=True)
    return sum(bool(moves[begin:end].mean() > 0.5) for begin, end in ends)
