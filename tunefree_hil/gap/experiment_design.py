"""Drives that separate effects: from the manoeuvres that an effect names, or the needs it has, to plans of a bench.

The planner of `collect` drives them: cells of steering, speed and pedal with steps, a chirp, small sines and stairs
added, and gentle stretches, within the limits of the vehicle and a bounded area. Each manoeuvre selects some of these.
An effect that a user adds is driven by the manoeuvres in its text, or else by what it needs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Effect
from tunefree_hil.collect.bounds import DriveBounds
from tunefree_hil.collect.cells import MIN_SPEED_MPS, max_planned_speed_mps, needed_frames
from tunefree_hil.collect.envelope import area_side_for_speed_m
from tunefree_hil.collect.plan import DrivePlan, bounded_envelope, plannable_cells, plannable_stretches
from tunefree_hil.config.schema import VehicleSpec

AREA_M = 500.0  # side of the square that a drive stays in: room to coast from 14 m/s
MAX_MANOEUVRES = 3  # in a round: with more, the original log would have little weight
LONG_COAST_S = 12.0  # resistances show in how the deceleration depends on the speed, which must fall by some m/s
TOP_SPEED_FACTOR = 0.9  # by which a top speed is lowered until the area is large enough
# Numbers of the bands of collect/cells.py: steering, pedal and speed
SHARP_RIGHT, TURN_RIGHT, BRANCH_RIGHT, STRAIGHT, BRANCH_LEFT, TURN_LEFT, SHARP_LEFT = range(7)
BRAKE_HIGH, BRAKE_MID, BRAKE_LIGHT, THROTTLE_LIGHT, THROTTLE_MID, THROTTLE_HIGH = range(6)
SLOW, MEDIUM, FAST = range(3)
FIRST_PEDAL_STEPS = FIRST_STEERING_SINES = 3  # number of the first hold of these excitation signals


class Manoeuvre(NamedTuple):
    """A drive from standstill to standstill.

    Args:
        name: of the manoeuvre
        description: for reports
        steers: steering bands of collect/cells.py that are combined with all `speeds` and `pedals`
        speeds: speed bands
        pedals: pedal bands
        cell_s: time in each cell
        first_hold: which excitation signals come first (collect/excitation_signals.py): steps of the pedals after
            FIRST_PEDAL_STEPS, of the steering after 0, small sines of the steering after FIRST_STEERING_SINES
        is_gentle: instead of cells, the stretches that hold a speed, coast and stop
        drive_s: time after which it begins to stop
    """

    name: str
    description: str
    steers: tuple[int, ...] = ()
    speeds: tuple[int, ...] = ()
    pedals: tuple[int, ...] = ()
    cell_s: float = 6.0
    first_hold: int = 0
    is_gentle: bool = False
    drive_s: float = 120.0


MANOEUVRES = {
    manoeuvre.name: manoeuvre
    for manoeuvre in (
        Manoeuvre(
            "steer_steps",
            "steps and a chirp of the steering, small and large, at two speeds",
            steers=(TURN_RIGHT, BRANCH_RIGHT, STRAIGHT, BRANCH_LEFT, TURN_LEFT),
            speeds=(SLOW, MEDIUM),
            pedals=(THROTTLE_LIGHT,),
        ),
        Manoeuvre(
            "steer_sines",
            "small sines of the steering about straight ahead and about an offset",
            steers=(BRANCH_RIGHT, STRAIGHT, BRANCH_LEFT),
            speeds=(SLOW, MEDIUM),
            pedals=(THROTTLE_LIGHT,),
            cell_s=8.0,
            first_hold=FIRST_STEERING_SINES,
        ),
        Manoeuvre(
            "steer_lock",
            "steering from lock to lock, slowly driven",
            steers=(SHARP_RIGHT, TURN_RIGHT, TURN_LEFT, SHARP_LEFT),
            speeds=(SLOW,),
            pedals=(THROTTLE_LIGHT,),
            cell_s=8.0,
        ),
        Manoeuvre(
            "circles",
            "circles both ways at growing speeds",
            steers=(TURN_RIGHT, BRANCH_RIGHT, BRANCH_LEFT, TURN_LEFT),
            speeds=(SLOW, MEDIUM),
            pedals=(THROTTLE_LIGHT, THROTTLE_MID),
            cell_s=8.0,
        ),
        Manoeuvre(
            "throttle_steps",
            "steps of the throttle, small and large, at two speeds",
            steers=(STRAIGHT,),
            speeds=(SLOW, MEDIUM),
            pedals=(THROTTLE_LIGHT, THROTTLE_MID, THROTTLE_HIGH),
            first_hold=FIRST_PEDAL_STEPS,
        ),
        Manoeuvre(
            "full_throttle",
            "much throttle from a stand to high speed",
            steers=(STRAIGHT,),
            speeds=(SLOW, MEDIUM, FAST),
            pedals=(THROTTLE_HIGH,),
            cell_s=8.0,
            first_hold=FIRST_PEDAL_STEPS,
        ),
        Manoeuvre(
            "brake_levels",
            "steps of the brake and braking at growing levels",
            steers=(STRAIGHT,),
            speeds=(SLOW, MEDIUM),
            pedals=(BRAKE_HIGH, BRAKE_MID, BRAKE_LIGHT),
            first_hold=FIRST_PEDAL_STEPS,
        ),
        Manoeuvre(
            "stops",
            "equal brakings, one after the other",
            steers=(STRAIGHT,),
            speeds=(MEDIUM,),
            pedals=(BRAKE_HIGH,),
            cell_s=16.0,
            drive_s=180.0,
        ),
        Manoeuvre(
            "gentle",
            "straight on and coasting at several speeds, and standing",
            cell_s=4.0,
            is_gentle=True,
            drive_s=300.0,
        ),
    )
}

# Phrases in an effect's `manoeuvre`, before its colon, and the manoeuvres that they stand for
MANOEUVRES_BY_PHRASE: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("steps of the steering", ("steer_steps",)),
    ("chirp", ("steer_steps",)),
    ("small sine", ("steer_sines",)),
    ("from stop to stop", ("steer_lock",)),
    ("circles", ("circles",)),
    ("steps of steering, throttle and brake", ("steer_steps", "throttle_steps", "brake_levels")),
    ("steps of the throttle", ("throttle_steps",)),
    ("throttle steps", ("throttle_steps",)),
    ("and throttle", ("throttle_steps",)),
    ("full throttle", ("full_throttle",)),
    ("steps of the brake", ("brake_levels",)),
    ("brake steps", ("brake_levels",)),
    ("braking", ("brake_levels",)),
    ("equal stops", ("stops",)),
    ("firm stop", ("stops",)),
    ("coasting", ("gentle",)),
    ("straight on", ("gentle",)),
    ("standing", ("gentle",)),
)
# The manoeuvre that gives each quantity an effect may need (base/contracts.py QUANTITIES)
MANOEUVRE_BY_QUANTITY = {
    "moving_s": "gentle",
    "top_speed_mps": "full_throttle",
    "speed_span_mps": "full_throttle",
    "straight_s": "gentle",
    "curve_s": "circles",
    "lateral_accel_mps2": "circles",
    "steer_moves": "steer_steps",
    "steer_reversals": "steer_sines",
    "steer_span_frac": "steer_lock",
    "throttle_moves": "throttle_steps",
    "throttle_span_frac": "full_throttle",
    "throttle_s": "throttle_steps",
    "brake_moves": "brake_levels",
    "brake_span_frac": "brake_levels",
    "brakings": "stops",
    "coast_s": "gentle",
}


def manoeuvres_for_effect(effect: Effect) -> tuple[Manoeuvre, ...]:
    """The manoeuvres that an effect names; those for its needs if it names none that is known."""
    text = effect.manoeuvre.partition(":")[0].lower()
    names = [name for phrase, matches in MANOEUVRES_BY_PHRASE if phrase in text for name in matches]
    return tuple(MANOEUVRES[name] for name in dict.fromkeys(names)) or manoeuvres_for_needs(effect)


def manoeuvres_for_needs(effect: Effect) -> tuple[Manoeuvre, ...]:
    """The manoeuvres that give a drive in which an effect shows."""
    names = dict.fromkeys(MANOEUVRE_BY_QUANTITY[need.quantity] for need in effect.needs)
    return tuple(MANOEUVRES[name] for name in names)


def next_manoeuvres(
    answer: Mapping[str, Any], driven: Collection[str], effects: Mapping[str, Effect]
) -> tuple[Manoeuvre, ...]:
    """The manoeuvres of the next round.

    Of a set: those of its first effect that has some left, and when all are driven, those for the needs of its effects.
    Where the logs cannot tell: those that most of the insufficiently excited effects ask for.

    Args:
        answer: gap.json
        driven: names of the manoeuvres that were driven
        effects: the catalogue

    Returns: at most MAX_MANOEUVRES; none where no drive would decide anything
    """
    if answer["verdict"] == "set":
        return _manoeuvres_for_set(answer["set"], driven, effects)
    if answer["verdict"] != "cannot_test":
        return ()
    lacking = [name for name, entry in answer["excitation"].items() if not entry["enough"]] or list(effects)
    lists = [manoeuvres_for_effect(effects[name]) for name in lacking if name in effects]
    counts = Counter(manoeuvre.name for manoeuvres in lists for manoeuvre in manoeuvres if manoeuvre.name not in driven)
    return tuple(MANOEUVRES[name] for name, _ in counts.most_common(MAX_MANOEUVRES))


def _manoeuvres_for_set(
    names: Sequence[str], driven: Collection[str], effects: Mapping[str, Effect]
) -> tuple[Manoeuvre, ...]:
    known = [effects[name] for name in names if name in effects]
    for select in (manoeuvres_for_effect, manoeuvres_for_needs):
        for effect in known:
            remaining = [manoeuvre for manoeuvre in select(effect) if manoeuvre.name not in driven]
            if remaining:
                return tuple(remaining[:MAX_MANOEUVRES])
    return ()


def drivable_top_speed_mps(vehicle: VehicleSpec, bounds: DriveBounds | None = None) -> float:
    """The highest speed that is driven: the vehicle's own, or less for the bounds or the area; 0 where none is left."""
    if bounds is not None and not bounds.is_drivable:
        return 0.0
    envelope = bounded_envelope(vehicle, bounds)
    top_mps = max_planned_speed_mps(envelope, bounds and bounds.speed_mps)
    while top_mps > MIN_SPEED_MPS and area_side_for_speed_m(envelope, top_mps) > AREA_M:
        top_mps *= TOP_SPEED_FACTOR
    return top_mps if top_mps > MIN_SPEED_MPS else 0.0


def plan_manoeuvre(
    vehicle: VehicleSpec, manoeuvre: Manoeuvre, dt_s: float, bounds: DriveBounds | None = None
) -> DrivePlan | None:
    """Plan a manoeuvre for a vehicle within bounds; None where it can drive no part of it."""
    top_mps = drivable_top_speed_mps(vehicle, bounds)
    if not top_mps:
        return None
    cells = plannable_cells(vehicle, top_mps, bounds)
    frames = needed_frames(cells, manoeuvre.cell_s, dt_s)  # of a full cell, which is not driven
    selected = [
        number
        for number, cell in enumerate(cells)
        if not cell.excluded
        and not cell.index.backwards
        and cell.index.steer in manoeuvre.steers
        and cell.index.speed in manoeuvre.speeds
        and cell.index.pedal in manoeuvre.pedals
    ]
    for number in selected:
        frames[number] = 0
    gentle = plannable_stretches(vehicle, manoeuvre.cell_s, manoeuvre.drive_s, AREA_M, top_mps, bounds)
    stretches = gentle if manoeuvre.is_gentle else ()
    if not selected and not stretches:
        return None
    return DrivePlan(
        quota_s=manoeuvre.cell_s,
        area_m=AREA_M,
        top_mps=top_mps,
        centre=None,
        have=tuple(frames),
        first_hold=manoeuvre.first_hold,
        stop_s=manoeuvre.drive_s,
        stretches=(0, len(stretches) // 2),  # straight ahead, each speed once
        bounds=bounds,
        coast_s=LONG_COAST_S,
    )
