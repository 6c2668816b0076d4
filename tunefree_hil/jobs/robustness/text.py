"""Text of a road sweep: the sentence with its verdict, and the table of the sets of gains."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from tunefree_hil.grade.requirements.judgement import result_text
from tunefree_hil.jobs.robustness.judgement import OSCILLATION, REPLAN, REQUIREMENT, DriveJudgement, DriveState
from tunefree_hil.jobs.robustness.physical_limits import PhysicalExcess
from tunefree_hil.jobs.robustness.plan import SweepDrive, SweepPlan
from tunefree_hil.jobs.robustness.result import CarOnRoad, SweepResult, decide_verdict, family_shares
from tunefree_hil.tune.failure_share import FailureShare

HEAD = ("", "failed roads", "95 % interval", "stability lost", "requirement missed", "nominal car", "other cars")
MAX_FAMILIES = 3  # named in a sentence


def plan_text(plan: SweepPlan) -> str:
    """What is driven."""
    sets = " and ".join(f"{one.name} ({one.count}, seed {one.seed})" for one in plan.order.road_sets)
    cars = f"each with the nominal car and one of {len(plan.cars) - 1} others"
    return f"roads: {sets}, {cars}; {len(plan.names)} sets of gains, {plan.drives} drives in {plan.order.model}"


def share_text(share: FailureShare) -> str:
    """'3 of 1229 roads (0.24 %, 95 % interval 0.05 to 0.71 %)'; of no failure the upper bound alone."""
    if not share.failed:
        return f"none of {share.n} roads (95 % interval 0 to {100.0 * share.high:.2g} %)"
    low, high = 100.0 * share.low, 100.0 * share.high
    return f"{share.failed} of {share.n} roads ({100.0 * share.share:.2g} %, 95 % interval {low:.2g} to {high:.2g} %)"


def sweep_sentence(plan: SweepPlan, result: SweepResult, worst: Sequence[SweepDrive], allowed: int) -> str:
    """The verdict in one sentence."""
    winner = result.winner
    word = decide_verdict(result, allowed).value
    parts = [f"{word}: the winner fails on {share_text(winner.roads)}"]
    if winner.roads.failed:
        lost, missed = winner.count(DriveState.STABILITY_LOST), winner.count(DriveState.REQUIREMENT_MISSED)
        parts[0] += f": stability lost on {lost}, a requirement missed on {missed}"
        parts.append(f"nominal car {winner.nominal.failed}, other cars {winner.other_cars.failed}")
        parts.append(_family_text(plan, result))
    if result.best_manual:
        manual = result.sets[result.best_manual].roads
        parts.append(f"best manual set {result.best_manual}: {manual.failed} of {manual.n}")
    if worst:
        label = "worst" if winner.roads.failed else "nearest to a limit"
        parts.append(
            f"{label}: {plan.roads[worst[0].road].spec.name}, {drive_text(worst[0], result.judgements[worst[0]])}"
        )
    parts += [text for text in (undrivable_text(plan, result.undrivable), hopeless_text(plan, result.hopeless)) if text]
    return "; ".join(parts)


def drive_text(drive: SweepDrive, judgement: DriveJudgement) -> str:
    """'car 12, re-planned': which car, and why the drive failed or how near to a limit it came."""
    car = "nominal car" if drive.car == 0 else f"car {drive.car}"
    by_value = judgement.cause in ("", OSCILLATION, REQUIREMENT)
    if by_value and judgement.binding is not None:
        return f"{car}, {result_text(judgement.binding)}"
    return f"{car}, {'re-planned' if judgement.cause == REPLAN else judgement.cause.replace('_', ' ')}"


def undrivable_text(plan: SweepPlan, undrivable: Mapping[CarOnRoad, list[PhysicalExcess]]) -> str:
    """Which families have roads beyond a car, and why; '' where none."""
    if not undrivable:
        return ""
    limits = sorted({excess.limit.value for excesses in undrivable.values() for excess in excesses})
    where = _count_families(plan, undrivable)
    return f"undrivable for this vehicle, not counted: {where}, beyond the {' and the '.join(limits)}"


def hopeless_text(plan: SweepPlan, hopeless: Sequence[CarOnRoad]) -> str:
    """Where every set fails although the car could drive it; '' for nowhere."""
    if not hopeless:
        return ""
    return f"every set fails, without a physical reason, on {_count_families(plan, hopeless)} (counted)"


def set_table(result: SweepResult) -> list[str]:
    """Lines: a set of gains each, the winner first."""
    rows: list[Sequence[str]] = [HEAD]
    for name, one in result.sets.items():
        share = one.roads
        interval = f"{100.0 * share.low:.2g} to {100.0 * share.high:.2g} %"
        states = (one.count(DriveState.STABILITY_LOST), one.count(DriveState.REQUIREMENT_MISSED))
        counts = (*states, one.nominal.failed, one.other_cars.failed)
        rows.append((name, f"{share.failed} of {share.n}", interval, *map(str, counts)))
    return _aligned(rows)


def family_table(plan: SweepPlan, result: SweepResult) -> list[str]:
    """Lines: failed roads by family of the winner and the best manual set; families without a failure are left out."""
    names = [plan.names[0], *([result.best_manual] if result.best_manual else [])]
    shares = [family_shares(plan, result.sets[name].states) for name in names]
    failing = [family for family in shares[0] if any(one[family].failed for one in shares)]
    rows: list[Sequence[str]] = [("failed roads by family", *names)]
    rows += [(family, *(f"{one[family].failed} of {one[family].n}" for one in shares)) for family in failing]
    return _aligned(rows) if failing else []


def _family_text(plan: SweepPlan, result: SweepResult) -> str:
    shares = family_shares(plan, result.winner.states)
    most = sorted((family for family in shares if shares[family].failed), key=lambda name: -shares[name].share)
    listed = ", ".join(f"{name} ({shares[name].failed} of {shares[name].n})" for name in most[:MAX_FAMILIES])
    return f"by family: {listed}" + (f" and {len(most) - MAX_FAMILIES} more" if len(most) > MAX_FAMILIES else "")


def _count_families(plan: SweepPlan, pairs: Iterable[CarOnRoad]) -> str:
    """'3 drives a set (hills 2, u_turn 1)'."""
    counts = Counter(plan.roads[pair.road].family for pair in pairs)
    total = sum(counts.values())
    listed = ", ".join(f"{family} {number}" for family, number in counts.most_common())
    return f"{total} drive{'s' if total > 1 else ''} of each set ({listed})"


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Columns side by side, the first to the left, the others to the right."""
    first, *others = ([row[i] for row in rows] for i in range(len(rows[0])))
    columns = [[f"{cell:{max(map(len, first))}}" for cell in first]]
    columns += [[f"{cell:>{max(map(len, column))}}" for cell in column] for column in others]
    return ["  ".join(cells) for cells in zip(*columns, strict=True)]
