"""A search's result that nobody had to search for: a car whose steering answers 0.07 s later than its model says."""

from __future__ import annotations

from functools import cache
from typing import Any

from msgspec.structs import replace

from tests.learn.made_drives import CHANNELS, made_drive
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.config.schema import ActuatorSpec, ModelSpec
from tunefree_hil.gap.diagnostics.regions import Region
from tunefree_hil.gap.diagnostics.residual_tests import Shape
from tunefree_hil.gap.result import SearchResult
from tunefree_hil.learn.drives.drive import Drive

VEHICLE = load_vehicle("mkz_bywire")
LATE_S = 0.07
SECONDS = 84.0  # two blocks that prove


def made_model() -> ModelSpec:
    """The made car as it is without anything hidden."""
    own = {
        channel: ActuatorSpec(dead_time_s=one.dead_time_s, lag_s=one.lag_s, rate_limit=one.rate_limit)
        for channel, one in CHANNELS.items()
    }
    nominal = load_model("mkz_nominal")
    return replace(nominal, actuators=own, plant=replace(nominal.plant, kind="physics", params={}, card=""), effects=[])


@cache
def late_drive(seconds: float = SECONDS, seed: int = 5) -> Drive:
    """The made car with a steering that answers LATE_S later."""
    late = CHANNELS["steer"]._replace(dead_time_s=CHANNELS["steer"].dead_time_s + LATE_S)
    return made_drive(seconds, seed=seed, channels={**CHANNELS, "steer": late}, name="late.log")


def candidate(name: str, evidence: float, counts: bool) -> dict[str, Any]:
    """A suspect as gap.json has it."""
    return {
        "name": name, "evidence": evidence, "held_out": [0.9 * evidence, 0.5 * evidence], "shrink": [0.9, 0.8, 0.95],
        "signal": "steer", "counts": counts,
    }  # fmt: skip


def answer(verdict: str = "one", **more: Any) -> dict[str, Any]:
    """The part of gap.json that a search gives."""
    value = {"value": LATE_S, "low": LATE_S - 0.001, "high": LATE_S + 0.001, "unit": "s"}
    found = [
        {
            "name": "steer_dead_time",
            "params": {"delay_s": value},
            "evidence": 900.0,
            "shrink": 0.97,
            "unseen_shrink": 0.95,
            "unseen_stirs": 0.99,
        }
    ]
    named = verdict in ("one", "several")
    link = {
        "link": "command_to_report", "signal": "steer", "unit": "rad", "rms": 0.1, "noise": 0.001, "explicable": 0.1,
        "share": 0.3, "broken": True,
    }  # fmt: skip
    card = {"link": "command_to_report", "signal": "steer", "regime": [], "card": "steer, 0.07 s late"}
    return {
        "verdict": verdict, "forced": "steer_dead_time", "absorbed": False, "effects": found if named else [],
        "set": [], "separate_by": "", "where": card,
        "excitation": {
            "steer_dead_time": {"score": 3.0, "enough": True, "lacks": []},
            "brake_fade": {"score": 0.2, "enough": False, "lacks": ["2 brakings by 3 m/s or more, 12 are needed"]},
        },
        "links": [link], "untold": {}, "lost": {}, "not_suspected": {},
        "candidates": [candidate("steer_dead_time", 900.0, True), candidate("aero_drag", -1.0, False)], "words": [],
        **more,
    }  # fmt: skip


def made_kept(verdict: str = "one", **more: Any) -> SearchResult:
    """What the search would have come to."""
    null = {"steer_gain.gain_frac": 1.001, "grade.grade_rad": 0.0001, "actuator.steer.dead_time_s": 0.003}
    repaired = {"steer_gain.gain_frac": 1.0, "steer_dead_time.delay_s": LATE_S}
    regions = (
        Region("speed (m/s)", 0.0, 8.0, 0.1, 0.0, 3.0, 1.5, 6.0, True),
        Region("steer side", 0.0, 0.4, 0.05, 0.0, 0.9, 0.4, 2.0, False),
    )
    named = verdict in ("one", "several")
    return SearchResult(
        answer(verdict, **more), null, repaired if named else null, ("steer_dead_time.delay_s",) if named else (),
        "steer", regions, Shape(0.07, 1.0, 0.0), 12.5,
    )  # fmt: skip
