"""From the words by which an effect is told apart to drives that a bench can make: one menu, one mapping.

The planner of `collect` drives them: cells of steering, speed and pedal with steps, a chirp, small sines and stairs
laid over them, and gentle stretches, inside the vehicle's limits and a bounded area. What separates two effects is a
choice among these; an effect of somebody's own is driven by the words it says, or else by what it needs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Effect
from tunefree_hil.collect.bounds import Bounds
from tunefree_hil.collect.cells import LEAST_MPS, fastest_mps, needs_of
from tunefree_hil.collect.envelope import side_needed_m
from tunefree_hil.collect.plan import DrivePlan, bounded, driven_stretches, driven_targets
from tunefree_hil.config.schema import VehicleSpec

AREA_M = 500.0  # side of the square that a drive stays in: room to coast from 14 m/s
MOST = 3  # manoeuvres a round: more would hide the log that was there before
LONG_COAST_S = 12.0  # what slows a car down shows in how that changes with the speed: some m/s have to go
FITS = 0.9  # a top speed for which the area is too small is lowered by this
SHARP_RIGHT, TURN_RIGHT, BRANCH_RIGHT, AHEAD, BRANCH_LEFT, TURN_LEFT, SHARP_LEFT = range(7)  # cells.STEERS
BRAKE_HIGH, BRAKE_MID, BRAKE_LIGHT, THROTTLE_LIGHT, THROTTLE_MID, THROTTLE_HIGH = range(6)  # cells.PEDALS
SLOW, MEDIUM, FAST = range(3)


class Manoeuvre(NamedTuple):
    """A drive from standstill to standstill. steers, speeds, pedals: bands of collect/cells.py, each with each.

    seconds: in each cell. first_hold: by it the planner chooses the waves that come first (collect/excitation_signals.py): steps of
    the pedals after 3, of the steering after 0, small sines of the steering after 3. gentle: the stretches that hold a
    speed, coast and come to a stand, instead of cells. drive_s: it begins to stop after so long.
    """

    name: str
    words: str
    steers: tuple[int, ...] = ()
    speeds: tuple[int, ...] = ()
    pedals: tuple[int, ...] = ()
    seconds: float = 6.0
    first_hold: int = 0
    gentle: bool = False
    drive_s: float = 120.0


MENU = {
    one.name: one
    for one in (
        Manoeuvre(
            "steer_steps", "steps and a chirp of the steering, small and large, at two speeds",
            (TURN_RIGHT, BRANCH_RIGHT, AHEAD, BRANCH_LEFT, TURN_LEFT), (SLOW, MEDIUM), (THROTTLE_LIGHT,),
        ),
        Manoeuvre(
            "steer_sines", "small sines of the steering about straight ahead and about an offset",
            (BRANCH_RIGHT, AHEAD, BRANCH_LEFT), (SLOW, MEDIUM), (THROTTLE_LIGHT,), 8.0, first_hold=3,
        ),
        Manoeuvre(
            "steer_lock", "steering from lock to lock, slowly driven",
            (SHARP_RIGHT, TURN_RIGHT, TURN_LEFT, SHARP_LEFT), (SLOW,), (THROTTLE_LIGHT,), 8.0,
        ),
        Manoeuvre(
            "circles", "circles both ways at growing speeds",
            (TURN_RIGHT, BRANCH_RIGHT, BRANCH_LEFT, TURN_LEFT), (SLOW, MEDIUM), (THROTTLE_LIGHT, THROTTLE_MID), 8.0,
        ),
        Manoeuvre(
            "throttle_steps", "steps of the throttle, small and large, at two speeds",
            (AHEAD,), (SLOW, MEDIUM), (THROTTLE_LIGHT, THROTTLE_MID, THROTTLE_HIGH), first_hold=3,
        ),
        Manoeuvre(
            "full_throttle", "much throttle from a stand to high speed",
            (AHEAD,), (SLOW, MEDIUM, FAST), (THROTTLE_HIGH,), 8.0, first_hold=3,
        ),
        Manoeuvre(
            "brake_levels", "steps of the brake and braking at growing levels",
            (AHEAD,), (SLOW, MEDIUM), (BRAKE_HIGH, BRAKE_MID, BRAKE_LIGHT), first_hold=3,
        ),
        Manoeuvre(
            "stops", "equal brakings, one after the other",
            (AHEAD,), (MEDIUM,), (BRAKE_HIGH,), 16.0, drive_s=180.0,
        ),
        Manoeuvre(
            "gentle", "straight on and coasting at several speeds, and standing",
            seconds=4.0, gentle=True, drive_s=300.0,
        ),
    )
}  # fmt: skip

# What effects say in `manoeuvre`, before its colon, and what that is on the menu.
SAID: tuple[tuple[str, tuple[str, ...]], ...] = (
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
# What a drive is asked for (base/contracts.py QUANTITIES), and what gives it.
GIVEN_BY = {
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


def manoeuvres_of(effect: Effect) -> tuple[Manoeuvre, ...]:
    """What drives the words by which an effect is told apart; where they say nothing that is known, what it needs."""
    asked = effect.manoeuvre.partition(":")[0].lower()
    names = [name for words, some in SAID if words in asked for name in some]
    return tuple(MENU[name] for name in dict.fromkeys(names)) or needed_by(effect)


def needed_by(effect: Effect) -> tuple[Manoeuvre, ...]:
    """What gives a drive that an effect shows in."""
    return tuple(MENU[name] for name in dict.fromkeys(GIVEN_BY[need.quantity] for need in effect.needs))


def to_drive(
    answer: Mapping[str, Any], driven: Collection[str], effects: Mapping[str, Effect]
) -> tuple[Manoeuvre, ...]:
    """What a round drives for an answer (gap.json), without what has been driven; none where nothing would decide it.

    Of a set: what tells the first name apart of which something is still to be driven, and once all of that is driven,
    what the names need to be seen. Where the logs cannot tell: what most of the effects that could not have shown
    themselves ask for.
    """
    if answer["verdict"] == "set":
        return _first_of(answer["set"], driven, effects)
    if answer["verdict"] != "cannot_test":
        return ()
    lacking = [name for name, one in answer["excitation"].items() if not one["enough"]] or list(effects)
    known = [manoeuvres_of(effects[name]) for name in lacking if name in effects]
    count = Counter(one.name for some in known for one in some if one.name not in driven)
    return tuple(MENU[name] for name, _ in count.most_common(MOST))


def _first_of(names: Sequence[str], driven: Collection[str], effects: Mapping[str, Effect]) -> tuple[Manoeuvre, ...]:
    known = [effects[name] for name in names if name in effects]
    for asked in (manoeuvres_of, needed_by):
        for effect in known:
            fresh = [one for one in asked(effect) if one.name not in driven]
            if fresh:
                return tuple(fresh[:MOST])
    return ()


def top_speed_mps(vehicle: VehicleSpec, bounds: Bounds | None = None) -> float:
    """The highest speed that is driven: the vehicle's own, or less where bounds say so or the area is too small for it;
    0 where that leaves none.
    """
    if bounds is not None and not bounds.is_drivable:
        return 0.0
    envelope = bounded(vehicle, bounds)
    top = fastest_mps(envelope, bounds and bounds.speed_mps)
    while top > LEAST_MPS and side_needed_m(envelope, top) > AREA_M:
        top *= FITS
    return top if top > LEAST_MPS else 0.0


def plan_for(vehicle: VehicleSpec, manoeuvre: Manoeuvre, dt_s: float, bounds: Bounds | None = None) -> DrivePlan | None:
    """The planner's plan of a manoeuvre for a vehicle, inside of bounds; None where it can drive no part of it."""
    top = top_speed_mps(vehicle, bounds)
    if not top:
        return None
    targets = driven_targets(vehicle, top, bounds)
    have = needs_of(targets, manoeuvre.seconds, dt_s)  # full, and so not asked for
    wanted = [
        number
        for number, one in enumerate(targets)
        if not one.excluded
        and not one.place.backwards
        and one.place.steer in manoeuvre.steers
        and one.place.speed in manoeuvre.speeds
        and one.place.pedal in manoeuvre.pedals
    ]
    for number in wanted:
        have[number] = 0
    every = driven_stretches(vehicle, manoeuvre.seconds, manoeuvre.drive_s, AREA_M, top, bounds)
    stretches = every if manoeuvre.gentle else ()
    if not wanted and not stretches:
        return None
    straight_first = (0, len(stretches) // 2)  # each speed once
    return DrivePlan(
        manoeuvre.seconds, AREA_M, top, None, tuple(have), manoeuvre.first_hold, manoeuvre.drive_s, straight_first,
        bounds, LONG_COAST_S,
    )  # fmt: skip
