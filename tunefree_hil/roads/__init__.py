"""Roads that are made for a vehicle: families of manoeuvres over speed, curvature and acceleration, in sets."""

from __future__ import annotations

from tunefree_hil.roads.coverage import DrivenEnvelope, RoadBeyond, envelope, outside, outside_text
from tunefree_hil.roads.sets import held_out_roads, road_set, search_roads, verify_roads, write_roads

__all__ = [
    "DrivenEnvelope",
    "RoadBeyond",
    "envelope",
    "held_out_roads",
    "outside",
    "outside_text",
    "road_set",
    "search_roads",
    "verify_roads",
    "write_roads",
]
