"""What margins come to: plain data for verify.json (docs/margins.md), and whether the winner has less of any."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.margins import (
    DELAY,
    GAIN_DOWN,
    GAIN_UP,
    INSIDE,
    POINTS,
    WALKS,
    Came,
    Car,
    Margin,
    Rate,
    is_inside,
    is_less,
    rate_of,
    rates,
    said,
    steering_of,
)
from tunefree_hil.jobs.tune.candidates import TUNED
from tunefree_hil.jobs.tune.margins import Found

LIMITS = {
    "inside_frac": INSIDE,
    "delay_cap_s": WALKS[DELAY][-1].steer_delay_s,
    "gain_up_cap": WALKS[GAIN_UP][-1].steer_gain,
    "gain_down_cap": WALKS[GAIN_DOWN][-1].steer_gain,
}
Steered = Mapping[str, Mapping[str, float] | None]  # vector -> what `steering_data` gives


def steering_data(recordings: Iterable[Recording]) -> dict[str, float] | None:
    """RMS of the steering command's rate and its reversals a second over some drives; None without that column."""
    known: list[NDArray[np.float64]] = []
    dt_s = 0.0
    for recording in recordings:
        command, dt_s = recording.get("cmd_steer_rad"), recording.dt_s
        if command is not None:
            known.append(command)
    steering = steering_of(known, dt_s) if known else None
    return steering._asdict() if steering else None


def margin_data(
    found: Found | str, steering: Steered, scores: Mapping[str, float], over_bus: Mapping[str, Mapping[str, float]]
) -> dict[str, Any]:
    """The value of "margins" in verify.json.

    found: what the drives gave, or why there were none; scores: each vector's on the verify model; over_bus: the score
    of each vector's scenarios there, which the batch must have hit.
    """
    if isinstance(found, str):
        vectors = {name: {**dict.fromkeys([*WALKS, "inside", "beyond"]), "points": []} for name in steering}
        data: dict[str, Any] = {"reason": found, "against": None, "less": [], "missing": {}, "drives": 0}
        data["same_as_bus"] = None
    else:
        vectors = {name: _vector(found, name) for name in steering}
        against = standing(scores, found)
        data = {"reason": "", "against": against, "less": less_than(vectors[TUNED], vectors.get(against or ""))}
        data |= {"missing": found.missing, "drives": found.drives, "same_as_bus": _same(found, over_bus)}
    data["vectors"] = {name: {**vectors[name], "steering": steering[name]} for name in steering}
    return {**data, "limits": LIMITS}


def standing(scores: Mapping[str, float], found: Found) -> str | None:
    """The manual vector to hold a winner's margins against: the best that drives the car as it is without a re-plan.

    None where all manual vectors re-plan or fail. A vector that re-plans as it is has no delay margin to speak of.
    """
    manual = sorted((name for name in scores if name != TUNED), key=lambda name: scores[name])
    return next((name for name in manual if found.walked[name][DELAY].value > 0.0), None)


def less_than(tuned: Mapping[str, Any], manual: Mapping[str, Any] | None) -> list[dict[str, Any]]:
    """What the winner has less of: [{"what", "tuned", "manual"}]; "inside": it fails more often within +/-20 %."""
    if manual is None:
        return []
    found = []
    for what in (DELAY, GAIN_UP, GAIN_DOWN):
        mine, other = Margin(**tuned[what]), Margin(**manual[what])
        if is_less(mine, other, down=what == GAIN_DOWN):
            found.append({"what": what, "tuned": tuned[what], "manual": manual[what]})
    if tuned["inside"]["failed"] > manual["inside"]["failed"]:
        found.append({"what": "inside", "tuned": tuned["inside"], "manual": manual["inside"]})
    return found


def _vector(found: Found, name: str) -> dict[str, Any]:
    driven = found.driven[name]
    data: dict[str, Any] = {what: margin._asdict() for what, margin in found.walked[name].items()}
    data["inside"] = _rate(rates(driven, inside=True))
    data["beyond"] = _rate(rates(driven, inside=False))
    data["points"] = [
        _point(group, car, driven[car])
        for group, cars in POINTS.items() if group not in found.missing for car in cars
    ]  # fmt: skip
    return data


def _point(group: str, car: Car, drives: Mapping[str, Came]) -> dict[str, Any]:
    rate = rate_of(drives.values())
    return {
        "group": group,
        "what": said(car),
        "factors": {field: value for field, value in car._asdict().items() if field != "steer_delay_s"},
        "inside": is_inside(car),
        **_rate(rate),
        "replanned": sum(not came.failed and not came.calm for came in drives.values()),
        "failures": {scenario: came.outcome for scenario, came in drives.items() if came.failed},
    }


def _rate(rate: Rate) -> dict[str, Any]:
    return {"failed": rate.failed, "drives": rate.drives, "share": rate.share if rate.drives else None}


def _same(found: Found, over_bus: Mapping[str, Mapping[str, float]]) -> dict[str, int]:
    """Of the drives of the cars as they are: how many scores of the batch are those of the bus, bit for bit."""
    pairs = [(found.scores[name].get(scenario), score) for name, some in over_bus.items()
             for scenario, score in some.items()]  # fmt: skip
    return {"equal": sum(mine == score for mine, score in pairs), "of": len(pairs)}
