"""Margins as verify.json has them, made up: a winner with less delay margin than the manual vector beside it."""

from __future__ import annotations

from typing import Any

from tunefree_hil.grade.margins import GAIN_DOWN, GAIN_UP, NOMINAL, POINTS, SWEEPS, CarVariant, DriveOutcome, Margin
from tunefree_hil.jobs.tune.margins import MarginDrives, margin_data

CALM, LEFT = DriveOutcome("finished", 0), DriveOutcome("left_lane", 1)
SCENARIOS = ("left_turn", "u_turn")
HARD = {"tuned": CarVariant(mass=1.3), "manual": CarVariant(steer_gain=0.6), "shipped": CarVariant(friction=0.8)}


def made_margins(delays_s: dict[str, float] | None = None) -> dict[str, Any]:
    """delays_s: delay margins by vector; each vector fails in 'u_turn' with the car that HARD says."""
    delays_s = delays_s or {"tuned": 0.06, "manual": 0.11, "shipped": 0.0}
    walked, driven = {}, {}
    for name, delay_s in delays_s.items():
        up, down = Margin(SWEEPS[GAIN_UP][-1].steer_gain, True), Margin(0.7, False, "u_turn", "re-plan")
        walked[name] = {"delay": Margin(delay_s, False, "u_turn", "re-plan"), GAIN_UP: up, GAIN_DOWN: down}
        driven[name] = {car: {one: LEFT if one == "u_turn" and car == HARD.get(name) else CALM for one in SCENARIOS}
                        for cars in ((NOMINAL,), *POINTS.values()) for car in cars}  # fmt: skip
    scores = {name: {one: 0.1 * i for one in SCENARIOS} for i, name in enumerate(delays_s, 1)}
    found = MarginDrives(driven, walked, scores, {}, 400)
    steering = {"rate_rms_radps": 0.25, "reversals_per_s": 1.5}
    whole = {name: 0.1 * i for i, name in enumerate(delays_s, 1)}
    return margin_data(found, dict.fromkeys(delays_s, steering), whole, scores)
