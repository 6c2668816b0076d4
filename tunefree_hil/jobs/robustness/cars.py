"""The cars of a road sweep: the nominal one, corners of the ensemble in opposite pairs, and cars within.

In a corner every factor is at an end of its range. A corner is followed by its opposite, so that already two cars have
both ends of every factor. Single numbers of the model are at ends that chance chooses, also opposite in the opposite
corner.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from random import Random

from tunefree_hil.grade.margins import NOMINAL
from tunefree_hil.tune.ensemble import CarRanges, EnsembleCar, FactorRange, draw_cars


def make_cars(ranges: CarRanges, count: int, seed: int) -> list[EnsembleCar]:
    """Make `count` cars: the nominal one, then corners until there are no more, then cars of a Latin hypercube."""
    corners = _list_corners(ranges, Random(f"corners {seed}"))[: count - 1]
    cars = [EnsembleCar(0), *(_corner_car(ranges, i + 1, is_high) for i, is_high in enumerate(corners))]
    drawn = draw_cars(ranges, 1 + count - len(cars), seed)[1:]
    return cars + [car._replace(number=len(cars) + i) for i, car in enumerate(drawn)]


def _list_corners(ranges: CarRanges, chance: Random) -> list[tuple[bool, ...]]:
    """Whether each factor, then each single number, is at its high end; by corner, opposite ones side by side."""
    halves = [(False, *rest) for rest in product((False, True), repeat=max(len(ranges.variant) - 1, 0))]
    chance.shuffle(halves)
    corners: list[tuple[bool, ...]] = []
    for half in halves:
        factors = half[: len(ranges.variant)]
        is_high = (*factors, *(chance.random() < 0.5 for _ in ranges.numbers))
        corners += [is_high, tuple(not end for end in is_high)]
    return corners


def _corner_car(ranges: CarRanges, number: int, is_high: Sequence[bool]) -> EnsembleCar:
    spans = [*ranges.variant.values(), *ranges.numbers.values()]
    ends = [_end(span, high) for span, high in zip(spans, is_high, strict=True)]
    variant = NOMINAL._replace(**dict(zip(ranges.variant, ends, strict=False)))
    return EnsembleCar(number, variant, dict(zip(ranges.numbers, ends[len(ranges.variant) :], strict=True)))


def _end(span: FactorRange, high: bool) -> float:
    return span.high if high else span.low
