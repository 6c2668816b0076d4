"""Families of roads, one file for each small group (docs/reference/files.md)."""

from __future__ import annotations

from tunefree_hil.roads.families.circles import STEADY_CIRCLE, U_TURN
from tunefree_hil.roads.families.evasions import EVASION
from tunefree_hil.roads.families.family import RoadFamily
from tunefree_hil.roads.families.hills import HILLS
from tunefree_hil.roads.families.lane_changes import DOUBLE_LANE_CHANGE, LANE_CHANGE
from tunefree_hil.roads.families.ramps import OFF_RAMP, ON_RAMP
from tunefree_hil.roads.families.roundabouts import ROUNDABOUT
from tunefree_hil.roads.families.sines import SLALOM, WEAVE
from tunefree_hil.roads.families.stops import FULL_STOP, STOP_AND_GO
from tunefree_hil.roads.families.straights import SPEED_STEPS, STRAIGHT
from tunefree_hil.roads.families.turns import TURN, WINDING

FAMILIES: tuple[RoadFamily, ...] = (
    *(TURN, WINDING, LANE_CHANGE, DOUBLE_LANE_CHANGE, SLALOM, WEAVE, EVASION, OFF_RAMP, ON_RAMP),
    *(ROUNDABOUT, STEADY_CIRCLE, U_TURN, HILLS, STOP_AND_GO, FULL_STOP, STRAIGHT, SPEED_STEPS),
)

__all__ = ["FAMILIES", "RoadFamily"]
