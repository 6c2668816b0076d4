"""The suggested `gap` command where the gains are worse on the vehicle than on the learned plant."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum, auto
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.jobs.command_text import shell_command
from tunefree_hil.jobs.commission.plan import CommissionPlan
from tunefree_hil.jobs.commission.stages import find_finished_tune

GAP_FOLDER = "gap"  # in the folder of the commission


class ShortfallKind(Enum):
    """What is worse on the vehicle than on the learned plant."""

    NOT_BETTER = auto()  # the winner fails the verification
    REPLANS = auto()  # it re-plans on the vehicle only


class Shortfall(NamedTuple):
    """Why a verification falls short. replans: of the winner on the vehicle."""

    kind: ShortfallKind
    replans: int = 0

    @property
    def text(self) -> str:
        """The middle of a sentence."""
        if self.kind is ShortfallKind.NOT_BETTER:
            return "the gains fail the verification on the vehicle"
        return f"the winner re-plans {times_text(self.replans)} on the vehicle and never on the learned plant"


def times_text(number: int) -> str:
    """'once', '2 times'."""
    return "once" if number == 1 else f"{number} times"


def find_shortfall(done: Mapping[str, Any]) -> Shortfall | None:
    """Why a verification falls short, None where it does not. done: stages by name, each with its "result"."""
    verified = done.get("verify", {}).get("result")
    if not verified:
        return None
    if not verified.get("holds", True):
        return Shortfall(ShortfallKind.NOT_BETTER)
    tuned = done.get("tune", {}).get("result", {})
    is_clean = ((tuned.get("held") or {}).get("winner") or {}).get("calm")  # on the plant; None: unknown
    replans = int(verified.get("replans") or 0)
    return Shortfall(ShortfallKind.REPLANS, replans) if is_clean and replans else None


def make_gap_command(plan: CommissionPlan) -> str:
    """The command that finds what the learned plant lacks, from drives of the winner on the vehicle; '' without any.

    Its --bench is the bench file that was verified with: the verify_model is the vehicle of these logs.
    """
    logs = find_verify_logs(plan)
    if not logs:
        return ""
    out = plan.folder / GAP_FOLDER
    return shell_command(
        "gap", *logs, vehicle=plan.vehicle.folder, model=plan.model, out=out, drive=True, bench=plan.bench
    )


def find_verify_logs(plan: CommissionPlan) -> list[Path]:
    """Logs of the winner in the verification: the first episodes (jobs/tune/verify.py), one for each scenario."""
    run = find_finished_tune(plan)
    if run is None:
        return []
    folders = [run / "verify" / "episodes" / str(k) for k in range(len(plan.template.verify_scenarios))]
    return [folder / "vehicle.log" for folder in folders if (folder / "vehicle.log").is_file()]
