"""Several objectives: every sampler that says so covers the front, and a requirement stays one."""

from __future__ import annotations

import math

import pytest

from tests.tune.drive_study import Parameter
from tests.tune.sampler_cases import CASES
from tunefree_hil.base.errors import InputError
from tunefree_hil.tune.sampling import RECORDS, ScoredPoint, suggest_points
from tunefree_hil.tune.sampling.optuna_samplers import NSGA_CRITERIA
from tunefree_hil.tune.space import Space, make_space

BOX, WIDE = (make_space([Parameter(f"p{i}", 0.01, 1.0) for i in range(count)]) for count in (3, 8))
CAPABLE = {record.name for record in RECORDS if record.objectives}
BOTH = [case for case in CASES if case.values[0] in CAPABLE]


def two_bowls(values: dict[str, float], limit: float = 1.0) -> ScoredPoint:
    """Bottoms at p0 = 0.03 and 0.3, both at 0.1 in the others; a requirement limits p0."""
    logs = [math.log10(value) for value in values.values()]
    others = sum((value + 1.0) ** 2 for value in logs[1:])
    pair = (0.01 + (logs[0] + 1.5) ** 2 + others, 0.01 + (logs[0] + 0.5) ** 2 + others)
    return ScoredPoint(values, sum(pair), max(0.0, values["p0"] / limit - 1.0), pair)


def search(sampler: str, trials: int, limit: float = 1.0, space: Space = BOX) -> list[ScoredPoint]:
    points: list[ScoredPoint] = []
    while len(points) < trials:
        slots = range(len(points), len(points) + 8)
        asked = suggest_points(space, points, sampler=sampler, seed=3, slots=slots)
        points += [two_bowls(values, limit) for values in asked]
    return points


def dominated_area(points: list[ScoredPoint], corner: float = 2.0) -> float:
    """Hypervolume of two objectives up to a corner."""
    area, least = 0.0, corner
    for first, second in sorted(point.objectives for point in points):
        if first < corner and second < least:
            area += (corner - first) * (least - second)
            least = second
    return area


@pytest.mark.parametrize("sampler", BOTH)
def test_suggestions_learn_from_every_objective(sampler: str) -> None:
    points = search(sampler, 16 if sampler.startswith("gp") else NSGA_CRITERIA.population + 8)
    one_sided = [point._replace(objectives=(point.objectives[0],) * 2) for point in points]
    asked = [suggest_points(BOX, history, sampler=sampler, seed=1, slots=[100]) for history in (points, one_sided)]
    assert all(BOX.clip(values[0]) == values[0] for values in asked)
    assert (asked[0] != asked[1]) is (sampler not in ("qmc", "random"))


@pytest.mark.slow
@pytest.mark.parametrize("sampler", ["tpe_independent", "tpe_relative", "nsga"])
def test_a_search_covers_the_front_better_than_chance(sampler: str) -> None:
    tuned, chance = (dominated_area(search(name, 160, space=WIDE)) for name in (sampler, "random"))
    assert tuned > 1.2 * chance


@pytest.mark.parametrize("sampler", ["tpe_independent", "nsga"])
def test_a_requirement_stays_one(sampler: str) -> None:
    """The limit cuts the front in the middle: most late points keep it."""
    late = search(sampler, 160, limit=0.1)[120:]
    free = search(sampler, 160)[120:]
    share, share_free = (sum(point.parameters["p0"] <= 0.1 for point in points) / 40 for points in (late, free))
    assert share > 0.7 > share_free


@pytest.mark.parametrize("sampler", ["cma", "tpe_cma"])
def test_others_refuse_them(sampler: str) -> None:
    with pytest.raises(InputError, match="one objective, not 2"):
        suggest_points(
            BOX, [two_bowls(BOX.clip({"p0": 0.1, "p1": 0.1, "p2": 0.1}))], sampler=sampler, seed=1, slots=[1]
        )


def test_a_generation_is_a_population_of_finished_trials() -> None:
    """Below it NSGA-II draws at random; the next trial has parents."""
    size = NSGA_CRITERIA.population
    points = search("random", size + 8)[:size]
    for known, is_random in ((size - 1, True), (size, False)):
        asked = suggest_points(BOX, points[:known], sampler="nsga", seed=3, slots=[500])
        assert (asked == suggest_points(BOX, [], sampler="random", seed=3, slots=[500])) is is_random
