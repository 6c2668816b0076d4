"""The hub alone: round trips, a burst with three members, the bus work of a lockstep tick."""

from __future__ import annotations

from typing import Any

import numpy as np

from tools.measures._hub_members import measure_hub
from tools.measures._summary import machine, rounded, summary

VALUE = "us for one frame there and one back between two processes over the hub (p50, median of runs)"


def measure(runs: int = 5, rounds: int = 5000) -> dict[str, Any]:
    """`runs` hubs one after the other, `rounds` round trips each, while the hub writes its logs; TCP beside it."""
    before = machine()
    found = [measure_hub(rounds) for _ in range(runs)]
    detail = {"machine": before, "rounds": rounds, "unix": _medians(found), "tcp": measure_hub(rounds, "tcp")}
    return summary([one["round_trip_p50_us"] for one in found], "us", rounded(detail))


def _medians(found: list[dict[str, float]]) -> dict[str, Any]:
    """Median, least and most over the runs, by quantity."""
    return {
        name: {"median": float(np.median([one[name] for one in found])),
               "low": min(one[name] for one in found), "high": max(one[name] for one in found)}
        for name in found[0] if name != "rounds"
    }  # fmt: skip
