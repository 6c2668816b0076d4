"""Gates of a commission: whether the result of a stage is good enough to continue.

The limits are wide: they prevent hours of useless work; the report leaves the judgement to the user. They are options
of the command and not part of the identity of a commission, so another limit judges the same result again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.jobs.command_text import shell_command
from tunefree_hil.jobs.commission.plan import CommissionPlan

HORIZON = "10"  # s of free run


class GateResult(NamedTuple):
    """Whether a result is good enough; reason: why not."""

    is_passed: bool
    reason: str = ""


PASSED = GateResult(True)


class FreeRunResult(NamedTuple):
    """A plant after 10 s of free run.

    error_m: Mean position error, m.
    starts: Number of free runs.
    lost: Free runs that ended in numbers that are not finite.
    """

    error_m: float
    starts: int
    lost: int


def accept(result: Mapping[str, Any], plan: CommissionPlan) -> GateResult:
    """Accept every result.

    A calibration reports unknown constants itself and keeps those of the data sheet; a map that cannot be learned
    raises an error; a failed verification is the result of the commission.
    """
    return PASSED


def check_coverage(result: Mapping[str, Any], plan: CommissionPlan) -> GateResult:
    """Check the share of full cells of a collection."""
    full, wanted = int(result.get("cells_full", 0)), int(result.get("cells_wanted", 0))
    min_share = plan.options.least_covered
    if wanted and full >= min_share * wanted:
        return PASSED
    missing = "; ".join(result.get("missing", [])[:3])
    counts = f"only {full} of {wanted} cells are full, {min_share:.0%} are needed (--least-covered)"
    return GateResult(False, f"{counts}; missing: {missing}")


def check_free_run(result: Mapping[str, Any], plan: CommissionPlan) -> GateResult:
    """Check the error of the learned plant after 10 s of free run on held-out drives."""
    max_m = plan.options.most_error_m
    free_run = read_free_run(result)
    if free_run is None:
        return GateResult(False, "no held-out drive is long enough for 10 s of free run: the plant cannot be judged")
    if free_run.lost:
        reason = f"in {free_run.lost} of {free_run.starts} free runs on held-out drives the plant diverged"
        return GateResult(False, reason)
    if free_run.error_m <= max_m:
        return PASSED
    error = f"after 10 s of free run on held-out drives the error of the plant is {free_run.error_m:.1f} m"
    return GateResult(False, f"{error}, at most {max_m:g} m are allowed (--most-error-m)")


def read_free_run(result: Mapping[str, Any]) -> FreeRunResult | None:
    """The free run of a learned plant on level ground, or on hills where no drive was level; None without any.

    Starts of the calibrated physics that the plant did not complete are lost.
    """
    table = result.get("free_run") or {}
    learned, physics = table.get(str(result.get("kind", ""))) or {}, table.get("physics") or {}
    for ground in ("level", "hills"):
        learned_row, physics_row = _row_at_horizon(learned.get(ground)), _row_at_horizon(physics.get(ground))
        completed = int(learned_row.get("n", 0))
        starts = max(completed, int(physics_row.get("n", 0)))
        if starts:
            error = learned_row.get("mean")
            return FreeRunResult(math.inf if error is None else float(error), starts, starts - completed)
    return None


def _row_at_horizon(row: Mapping[str, Any] | None) -> Mapping[str, Any]:
    return ((row or {}).get(HORIZON) or {}).get("position_m") or {}


def check_outside_share(result: Mapping[str, Any], plan: CommissionPlan) -> GateResult:
    """Check the share of the drives of the winner outside the region that the logs cover."""
    outside, max_share = result.get("outside") or {}, plan.options.most_outside
    share = outside.get("share")
    if share is None or share <= max_share:
        return PASSED
    shares = ", ".join(f"{name} {part:.0%}" for name, part in (outside.get("by") or {}).items())
    text = f"{share:.0%} of the winner's drives lie outside the region that the logs cover"
    text += f" ({shares})" if shares else ""
    return GateResult(False, f"{text}, at most {max_share:.0%} are allowed (--most-outside)")


class LimitRow(NamedTuple):
    """A row of the table of limits in the report."""

    quantity: str
    limit: str
    reached: str


def list_limits(plan: CommissionPlan, done: Mapping[str, Any]) -> list[LimitRow]:
    """A row for every limit whose stage is done."""
    rows = []
    if "collect" in done:
        result = done["collect"]["result"]
        full, wanted = int(result.get("cells_full", 0)), int(result.get("cells_wanted", 0))
        share = f"{full / wanted:.0%}" if wanted else "none"
        rows.append(
            LimitRow("full cells", f"at least {plan.options.least_covered:.0%}", f"{share} ({full} of {wanted})")
        )
    if "learn" in done:
        free_run = read_free_run(done["learn"]["result"])
        text = "unknown" if free_run is None else f"{free_run.error_m:.2f} m over {free_run.starts} starts"
        rows.append(LimitRow("error after 10 s of free run", f"at most {plan.options.most_error_m:g} m", text))
    for stage, place in (("tune", "on the plant"), ("verify", "on the vehicle")):
        if stage in done:
            share = (done[stage]["result"].get("outside") or {}).get("share")
            limit = f"at most {plan.options.most_outside:.0%}" if stage == "tune" else "none"
            text = "unknown" if share is None else f"{share:.1%}"
            rows.append(LimitRow(f"winner's ticks outside the valid region, {place}", limit, text))
    return rows


def suggest_commands(stage: str, plan: CommissionPlan) -> list[str]:
    """Commands to run after a stage whose result is not good enough."""
    if stage == "collect":
        count = shell_command(
            "collect", **{"from": plan.logs}, vehicle=plan.vehicle.folder
        )  # --from takes one log each
        return [count, f"{plan.command} --from collect --area-m {2.0 * plan.options.area_m:g}"]
    return [f"{plan.command} --from {stage}"]
