"""Which channels a vehicle's model has, and where the pairs of each come from: reports, or else the motion."""

from __future__ import annotations

from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.learn.by_motion import Law, law_of, pairs_by_motion
from tunefree_hil.learn.drives import Split
from tunefree_hil.learn.pairs import CHANNELS, Pairs, pairs_of, up_to_stops
from tunefree_hil.learn.sheet import asks_accel

PEDALS_AND_WHEEL = ("throttle", "brake", "steer")


def channels_of(vehicle: VehicleSpec) -> list[str]:
    """The channels of a vehicle's model: what its plant takes, and what else it is commanded by."""
    needed = ("accel", "steer") if asks_accel(vehicle) else PEDALS_AND_WHEEL
    return [name for name in CHANNELS if name in needed or CHANNELS[name] in vehicle.command]


def sources(split: Split, channel: str, vehicle: VehicleSpec) -> tuple[Pairs, Pairs, Law | None]:
    """Training and held-out pairs of a channel; with a law where they are had from the motion, by it."""
    training, held_out = pairs_of(split.training, channel), pairs_of(split.held_out, channel)
    law = None if training.some or held_out.some else law_of(split.training, channel, vehicle)
    if law is None:
        return *up_to_stops(training, held_out), None
    return pairs_by_motion(split.training, law, vehicle), pairs_by_motion(split.held_out, law, vehicle), law
