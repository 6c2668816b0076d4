"""When the gains do not do on the vehicle what they did on the plant: the `gap` command that says what it lacks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tunefree_hil.jobs.command_text import pasted
from tunefree_hil.jobs.commission.plan import Plan
from tunefree_hil.jobs.commission.stages import finished_tune

OUT = "gap"  # in the commission's folder


def disappointed(done: Mapping[str, Any]) -> str:
    """Why a verification disappoints, '' where it does not. done: stages by name, each with its "result"."""
    verified = done.get("verify", {}).get("result")
    if not verified:
        return ""
    if not verified.get("holds", True):
        return "the gains do not hold on the vehicle"
    tuned = done.get("tune", {}).get("result", {})
    calm = ((tuned.get("held") or {}).get("winner") or {}).get("calm")  # on the plant; None: not known
    replans = int(verified.get("replans") or 0)
    if calm and replans:
        times = "once" if replans == 1 else f"{replans} times"
        return f"the winner re-plans {times} on the vehicle and never on the learned plant"
    return ""


def gap_command(plan: Plan) -> str:
    """The command that names what the learned plant lacks, from the winner's drives on the vehicle; '' without any.

    --bench: the one that was verified on; its verify_model is the vehicle that these logs are of.
    """
    logs = verify_logs(plan)
    if not logs:
        return ""
    out = plan.folder / OUT
    return pasted("gap", *logs, vehicle=plan.vehicle.folder, model=plan.model, out=out, drive=True, bench=plan.bench)


def verify_logs(plan: Plan) -> list[Path]:
    """The winner's drives of the verification: the first ones (jobs/tune/verify.py), as many as there are roads."""
    run = finished_tune(plan)
    if run is None:
        return []
    folders = [run / "verify" / "episodes" / str(k) for k in range(len(plan.template.verify_scenarios))]
    return [folder / "vehicle.log" for folder in folders if (folder / "vehicle.log").is_file()]
