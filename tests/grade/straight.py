"""A short straight course for tests that need any."""

from __future__ import annotations

from tunefree_hil.base.course import Course
from tunefree_hil.config.schema import ProfileSpec, ScenarioSpec
from tunefree_hil.episode.scenario import build_course


def straight(speed_mps: float, duration_s: float = 0.5, dt_s: float = 0.01) -> Course:
    """Constant speed straight on."""
    spec = ScenarioSpec(
        schema="tunefree.scenario/1",
        name="straight",
        speed=ProfileSpec(t_s=[0.0, duration_s], value=[speed_mps, speed_mps]),
        curvature=ProfileSpec(t_s=[0.0, duration_s], value=[0.0, 0.0]),
    )
    return build_course(spec, dt_s)
