"""The result of a road sweep from its drives: failed roads by set of gains, by car and by family.

A road counts once, with its worst drive: roads are drawn independently, two drives on one road are not. A drive that
every set fails, on a road beyond what the car can do, is undrivable and counts for none of them.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from typing import Any, NamedTuple

from tunefree_hil.grade.requirements.limits import RequirementLimits
from tunefree_hil.jobs.robustness.driving.chunk import DriveRow
from tunefree_hil.jobs.robustness.judgement import DriveJudgement, DriveState, judge_row
from tunefree_hil.jobs.robustness.physical_limits import PhysicalExcess, ability_of, find_physical_excesses
from tunefree_hil.jobs.robustness.plan import SweepDrive, SweepPlan
from tunefree_hil.tune.failure_share import FailureShare, compute_failure_share


class SweepVerdict(StrEnum):
    """What a sweep says of the winner; first word of its sentence, and "verdict" of its result."""

    PASSED = "PASSED"
    FAILED = "FAILED"


class CarOnRoad(NamedTuple):
    """A road and a car, by their numbers in the plan."""

    road: int
    car: int


class SetResult(NamedTuple):
    """What a set of gains came to.

    Attributes:
        states: The worst drive of each road, by its number; roads that no car can drive are left out.
        causes: Number of failed drives by cause.
        nominal: Of the drives with the nominal car.
        other_cars: Of the drives with the other car of a road.
    """

    states: Mapping[int, DriveState]
    causes: Mapping[str, int]
    nominal: FailureShare
    other_cars: FailureShare

    @property
    def roads(self) -> FailureShare:
        """Of the roads."""
        return share_of_states(self.states.values())

    def count(self, state: DriveState) -> int:
        """Roads whose worst drive came to this."""
        return sum(reached is state for reached in self.states.values())


class SweepResult(NamedTuple):
    """The judged sweep.

    Attributes:
        sets: By name of the set of gains, the winner first.
        judgements: By drive.
        undrivable: Why, by car on a road.
        hopeless: Cars on roads where every set fails without a physical reason; they count.
    """

    sets: Mapping[str, SetResult]
    judgements: Mapping[SweepDrive, DriveJudgement]
    undrivable: Mapping[CarOnRoad, list[PhysicalExcess]]
    hopeless: tuple[CarOnRoad, ...]

    @property
    def winner(self) -> SetResult:
        """The tuned set."""
        return next(iter(self.sets.values()))

    @property
    def manuals(self) -> dict[str, SetResult]:
        """The other sets."""
        return dict(list(self.sets.items())[1:])

    @property
    def best_manual(self) -> str:
        """The manual set that fails on the fewest roads, then with the fewest drives; '' without one."""
        return min(
            self.manuals,
            key=lambda name: (self.sets[name].roads.failed, sum(self.sets[name].causes.values())),
            default="",
        )


def judge_sweep(plan: SweepPlan, rows: Iterable[DriveRow], limits: RequirementLimits) -> SweepResult:
    """Judge the drives of a whole plan."""
    judgements = {SweepDrive(*row[:3]): judge_row(row, limits, plan.roads[row.road].spec.name) for row in rows}
    by_pair: dict[CarOnRoad, list[DriveJudgement]] = defaultdict(list)
    for drive, judgement in judgements.items():
        by_pair[CarOnRoad(drive.road, drive.car)].append(judgement)
    all_fail = [pair for pair, judged in by_pair.items() if all(one.state is not DriveState.PASSED for one in judged)]
    ability = ability_of(plan.bench, plan.order.model)
    reasons = {
        pair: find_physical_excesses(plan.roads[pair.road].spec, plan.cars[pair.car], ability) for pair in all_fail
    }
    undrivable = {pair: reason for pair, reason in reasons.items() if reason}
    counted = {drive: one for drive, one in judgements.items() if CarOnRoad(drive.road, drive.car) not in undrivable}
    sets = {name: _sum_up(counted, vector) for vector, name in enumerate(plan.names)}
    return SweepResult(sets, judgements, undrivable, tuple(pair for pair, reason in reasons.items() if not reason))


def decide_verdict(result: SweepResult, allowed: int) -> SweepVerdict:
    """PASSED where the winner drives roads, and fails on no more of them than are allowed."""
    roads = result.winner.roads
    return SweepVerdict.PASSED if roads.n > 0 and roads.failed <= allowed else SweepVerdict.FAILED


def share_of_states(states: Iterable[DriveState]) -> FailureShare:
    """The share of those that are not PASSED."""
    failed = [state is not DriveState.PASSED for state in states]
    return compute_failure_share(sum(failed), len(failed))


def family_shares(plan: SweepPlan, states: Mapping[int, DriveState]) -> dict[str, FailureShare]:
    """Failed roads by family, in the order of the names."""
    families: dict[str, list[DriveState]] = defaultdict(list)
    for road, state in states.items():
        families[plan.roads[road].family].append(state)
    return {family: share_of_states(families[family]) for family in sorted(families)}


def find_worst_drives(plan: SweepPlan, result: SweepResult, count: int) -> list[SweepDrive]:
    """The worst drives of the winner, one a road: the worst of each family first, then the others.

    Where none failed, the drive that came nearest to a limit.
    """
    counted = [
        drive
        for drive in result.judgements
        if drive.vector == 0 and CarOnRoad(drive.road, drive.car) not in result.undrivable
    ]
    counted.sort(key=lambda drive: (-result.judgements[drive].state, -result.judgements[drive].ratio, drive))
    failed = [drive for drive in counted if result.judgements[drive].state is not DriveState.PASSED]
    by_road: dict[int, SweepDrive] = {}
    for drive in failed or counted[:1]:
        by_road.setdefault(drive.road, drive)
    by_family = {plan.roads[drive.road].family: drive for drive in reversed(by_road.values())}
    return sorted(by_road.values(), key=lambda drive: drive not in by_family.values())[:count]


def sweep_data(plan: SweepPlan, result: SweepResult) -> dict[str, Any]:
    """The sweep as plain data; it follows from the drives alone."""
    undrivable_roads = [road for road in range(len(plan.roads)) if road not in result.winner.states]
    return {
        "model": plan.order.model,
        "roads": len(plan.roads),
        "road_sets": [one._asdict() for one in plan.order.road_sets],
        "cars": len(plan.cars),
        "drives": plan.drives,
        "sets": {name: _set_data(plan, one) for name, one in result.sets.items()},
        "undrivable_roads": [plan.roads[road].spec.name for road in undrivable_roads],
        "undrivable": _pair_data(plan, result.undrivable),
        "every_set_fails": _pair_data(plan, dict.fromkeys(result.hopeless, ())),
    }


def drive_data(plan: SweepPlan, result: SweepResult, drive: SweepDrive) -> dict[str, Any]:
    """One drive as plain data."""
    judgement, car = result.judgements[drive], plan.cars[drive.car]
    binding = judgement.binding
    return {
        "road": plan.roads[drive.road].spec.name,
        "family": plan.roads[drive.road].family,
        "car": {"number": car.number, "factors": {**car.variant._asdict(), **car.numbers}},
        "state": judgement.state.name.lower(),
        "cause": judgement.cause,
        "binding": None if binding is None else binding._asdict(),
    }


def _sum_up(counted: Mapping[SweepDrive, DriveJudgement], vector: int) -> SetResult:
    judged = {drive: one for drive, one in counted.items() if drive.vector == vector}
    states: dict[int, DriveState] = {}
    for drive, one in judged.items():
        states[drive.road] = max(one.state, states.get(drive.road, DriveState.PASSED))
    causes = Counter(one.cause for one in judged.values() if one.cause)
    return SetResult(
        states,
        dict(sorted(causes.items())),
        share_of_states(one.state for drive, one in judged.items() if drive.car == 0),
        share_of_states(one.state for drive, one in judged.items() if drive.car != 0),
    )


def _set_data(plan: SweepPlan, result: SetResult) -> dict[str, Any]:
    return {
        "roads": result.roads.as_data(),
        "nominal_car": result.nominal.as_data(),
        "other_cars": result.other_cars.as_data(),
        "stability_lost": result.count(DriveState.STABILITY_LOST),
        "requirement_missed": result.count(DriveState.REQUIREMENT_MISSED),
        "causes": dict(result.causes),
        "families": {family: one.as_data() for family, one in family_shares(plan, result.states).items()},
    }


def _pair_data(plan: SweepPlan, pairs: Mapping[CarOnRoad, Sequence[PhysicalExcess]]) -> list[dict[str, Any]]:
    return [
        {
            "road": plan.roads[pair.road].spec.name,
            "family": plan.roads[pair.road].family,
            "car": pair.car,
            "limits": [{"limit": one.limit.value, "ratio": one.ratio} for one in excesses],
        }
        for pair, excesses in sorted(pairs.items())
    ]
