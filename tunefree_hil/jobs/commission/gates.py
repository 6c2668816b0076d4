"""When a stage of a commission is not good enough to go on with.

The limits are deliberately wide: they stop what would waste the hours that follow, and leave judgement to the report.
They are options of the command and no part of what a commission is: another limit judges the same result anew.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.jobs.command_text import pasted
from tunefree_hil.jobs.commission.plan import Plan

HORIZON = "10"  # s of free run


class FreeRun(NamedTuple):
    """A plant after 10 s of free run: mean position error in m over `starts`, of which `lost` left finite numbers."""

    error_m: float
    starts: int
    lost: int


def enough(result: Mapping[str, Any], plan: Plan) -> str:
    """Never a reason to stop.

    A calibration says itself what it does not know and keeps the data sheet there; a map that cannot be learned
    raises, and one that was is judged by how the vehicle follows; whether the winner holds is the commission's result.
    """
    return ""


def covered_enough(result: Mapping[str, Any], plan: Plan) -> str:
    """Coverage."""
    full, wanted = int(result.get("cells_full", 0)), int(result.get("cells_wanted", 0))
    least = plan.asked.least_covered
    if wanted and full >= least * wanted:
        return ""
    lacking = "; ".join(result.get("missing", [])[:3])
    return f"only {full} of {wanted} cells are full, {least:.0%} are needed (--least-covered); missing: {lacking}"


def free_run_good_enough(result: Mapping[str, Any], plan: Plan) -> str:
    """Free run on unseen drives."""
    most_m = plan.asked.most_error_m
    found = free_run_of(result)
    if found is None:
        return "no held-out drive is long enough for 10 s of free run, so nothing says how good the plant is"
    if found.lost:
        return f"in {found.lost} of {found.starts} free runs on unseen drives the plant left all finite numbers"
    if found.error_m <= most_m:
        return ""
    words = f"after 10 s of free run the plant is {found.error_m:.1f} m off on unseen drives"
    return f"{words}, at most {most_m:g} m are allowed (--most-error-m)"


def free_run_of(result: Mapping[str, Any]) -> FreeRun | None:
    """What `learn` says of its plant on level ground, on hills where there is no level ground; None where it says none.

    Starts that the fitted physics came through and the plant did not are lost.
    """
    table = result.get("free_run") or {}
    ours, physics = table.get(str(result.get("kind", ""))) or {}, table.get("physics") or {}
    for ground in ("level", "hills"):
        mine, theirs = _at_horizon(ours.get(ground)), _at_horizon(physics.get(ground))
        starts = max(int(mine.get("n", 0)), int(theirs.get("n", 0)))
        if starts:
            error = mine.get("mean")
            return FreeRun(math.inf if error is None else float(error), starts, starts - int(mine.get("n", 0)))
    return None


def _at_horizon(row: Mapping[str, Any] | None) -> Mapping[str, Any]:
    return ((row or {}).get(HORIZON) or {}).get("position_m") or {}


def inside_enough(result: Mapping[str, Any], plan: Plan) -> str:
    """The share of the winner's drives outside the region that the logs covered."""
    outside, most = result.get("outside") or {}, plan.asked.most_outside
    share = outside.get("share")
    if share is None or share <= most:
        return ""
    by = ", ".join(f"{name} {one:.0%}" for name, one in (outside.get("by") or {}).items())
    words = f"{share:.0%} of the winner's drives lie outside the region that the logs covered"
    return f"{words}{f' ({by})' if by else ''}, at most {most:.0%} are allowed (--most-outside)"


def rows(plan: Plan, done: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """(what, limit, reached) of every limit whose stage is done."""
    found = []
    if "collect" in done:
        one = done["collect"]["result"]
        full, wanted = int(one.get("cells_full", 0)), int(one.get("cells_wanted", 0))
        share = f"{full / wanted:.0%}" if wanted else "none"
        found.append(
            ("cells that are full", f"at least {plan.asked.least_covered:.0%}", f"{share} ({full} of {wanted})")
        )
    if "learn" in done:
        run = free_run_of(done["learn"]["result"])
        words = "not known" if run is None else f"{run.error_m:.2f} m over {run.starts} starts"
        found.append(("error after 10 s of free run", f"at most {plan.asked.most_error_m:g} m", words))
    for stage, what in (("tune", "on the plant"), ("verify", "on the vehicle")):
        if stage in done:
            share = (done[stage]["result"].get("outside") or {}).get("share")
            limit = f"at most {plan.asked.most_outside:.0%}" if stage == "tune" else "none"
            words = "not known" if share is None else f"{share:.1%}"
            found.append((f"winner's ticks outside the valid region, {what}", limit, words))
    return found


def advice(stage: str, plan: Plan) -> list[str]:
    """What to type after a stage that was not good enough."""
    if stage == "collect":
        counted = pasted("collect", **{"from": plan.logs}, vehicle=plan.vehicle.folder)  # --from takes one log each
        return [counted, f"{plan.command} --from collect --area-m {2.0 * plan.asked.area_m:g}"]
    return [f"{plan.command} --from {stage}"]
