"""The stages of a commission: how each job is called, and when its result is not good enough to go on with.

The limits are deliberately wide: they stop what would waste the hours that follow, and leave judgement to the report.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.commission_plan import Plan

LEAST_COVERED = 0.8  # share of the cells that must be full
MOST_ERROR_M = 15.0  # of 10 s of free run, on unseen drives
MOST_OUTSIDE = 0.25  # share of ticks of the winner's drives outside the region that the logs covered
SHOWN = (
    "sentence", "figures", "holds", "scores", "outside", "margins", "minutes", "cells_full", "cells_wanted",
    "simulated_s", "beyond_envelope_s", "missing", "run", "model", "map", "kind", "free_run", "reduction_percent",
    "pedals",
)  # fmt: skip


def kept(result: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a result that the report shows; the rest stands in the stage's own folder."""
    return {key: value for key, value in result.items() if key in SHOWN}


def run_collect(plan: Plan) -> Iterator[Event]:
    """Guided collection on the vehicle."""
    from tunefree_hil.jobs.collect import collect
    from tunefree_hil.jobs.collect_plan import Asked

    asked = plan.asked
    wish = Asked(
        bench=Path(plan.template.path), vehicle=None, model=None, bus=asked.bus, bench_bus=asked.bench_bus, session="",
        realtime=False, out=plan.collected, quota_s=asked.quota_s, area_m=asked.area_m, top_mps=None, seed=asked.seed,
    )  # fmt: skip
    return collect(wish)


def covered_enough(result: Mapping[str, Any], plan: Plan) -> str:
    """Coverage."""
    full, wanted = int(result.get("cells_full", 0)), int(result.get("cells_wanted", 0))
    if wanted and full >= LEAST_COVERED * wanted:
        return ""
    lacking = "; ".join(result.get("missing", [])[:3])
    return f"only {full} of {wanted} cells are full ({LEAST_COVERED:.0%} are needed); missing: {lacking}"


def run_calibrate(plan: Plan) -> Iterator[Event]:
    """Actuators and physical constants."""
    from tunefree_hil.jobs.calibrate import calibrate

    return calibrate(plan.logs, plan.vehicle.folder, plan.physics, plan.asked.seed)


def known_enough(result: Mapping[str, Any], plan: Plan) -> str:
    """A calibration says itself what it does not know and keeps the data sheet there: never a reason to stop."""
    return ""


def run_learn(plan: Plan) -> Iterator[Event]:
    """The plant, on the calibrated physics."""
    from tunefree_hil.jobs.learn import Asked, learn

    asked = plan.asked
    return learn(Asked(plan.logs, plan.vehicle.folder, plan.model, asked.kind, asked.seed, asked.minutes, plan.physics))


def free_run_good_enough(result: Mapping[str, Any], plan: Plan) -> str:
    """Free run on unseen drives."""
    error_m = error_of(result)
    if error_m is None or error_m <= MOST_ERROR_M:
        return ""
    return f"after 10 s of free run the plant is {error_m:.1f} m off on unseen drives (at most {MOST_ERROR_M:g} m)"


def error_of(result: Mapping[str, Any]) -> float | None:
    """Mean position error after 10 s of free run, m; None where the drives were too short to say."""
    found: Any = result.get("free_run")
    for key in (str(result.get("kind", "")), "level", "10", "position_m", "mean"):
        found = found.get(key) if isinstance(found, Mapping) else None
    return float(found) if isinstance(found, int | float) else None


def run_map(plan: Plan) -> Iterator[Event]:
    """The open-loop map that the controller drives by."""
    from tunefree_hil.jobs.map import map_logs

    plan.map.mkdir(parents=True, exist_ok=True)
    return map_logs(plan.logs, plan.vehicle.folder, plan.map, plan.asked.seed)


def map_good_enough(result: Mapping[str, Any], plan: Plan) -> str:
    """A map that cannot be learned raises; one that was is judged by how the vehicle follows, in verify."""
    return ""


def run_tune(plan: Plan) -> Iterator[Event]:
    """The search on the learned plant; verification is a stage of its own."""
    from tunefree_hil.jobs.tune import tune
    from tunefree_hil.jobs.tune_wish import Asked

    asked = plan.asked
    wish = Asked(
        bench=plan.write_bench(), trials=asked.trials, set_name=asked.set_name, bus=asked.bus,
        bench_bus=asked.bench_bus, out=plan.folder / "tune", verify=False, backend=asked.backend,
    )  # fmt: skip
    return tune(wish)


def inside_enough(result: Mapping[str, Any], plan: Plan) -> str:
    """The share of the winner's drives outside the region that the logs covered."""
    outside = result.get("outside") or {}
    share = float(outside.get("share", 0.0) or 0.0)
    if share <= MOST_OUTSIDE:
        return ""
    return (
        f"{share:.0%} of the winner's drives lie outside the region that the logs covered (at most {MOST_OUTSIDE:.0%})"
    )


def run_verify(plan: Plan) -> Iterator[Event]:
    """Winner and baselines on the vehicle."""
    from tunefree_hil.jobs.drive import own_session
    from tunefree_hil.jobs.verify import verify

    return verify(tune_run(plan), bus=plan.asked.bus, bench_bus=plan.asked.bench_bus, join=False, session=own_session())


def always(result: Mapping[str, Any], plan: Plan) -> str:
    """The last stage: whether the winner holds is the commission's own result."""
    return ""


def tune_run(plan: Plan) -> Path:
    """The newest run of the tune. Raises InputError where there is none."""
    runs = sorted(path.parent for path in (plan.folder / "tune").glob("*/best.toml"))
    if not runs:
        raise InputError(
            "holds no finished tune", code="stage_missing", file=str(plan.folder / "tune"), hint="run stage tune first"
        )
    return runs[-1]


def advice(stage: str, plan: Plan) -> list[str]:
    """What to type after a stage that was not good enough."""
    if stage == "collect":
        return [f"tunefree-hil collect --from {plan.collected}/logs/*.log --vehicle {plan.vehicle.folder}"]
    return [f"tunefree-hil commission {plan.words} --only {stage}"]
