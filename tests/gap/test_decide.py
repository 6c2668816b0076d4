"""The rules by which a name is given: on candidates made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.gap.ask import Modelled
from tunefree_hil.gap.decide import MOST_WORSE, Weighed, left_share, outdone, rivals, shrink, weigh
from tunefree_hil.gap.leftover import Left
from tunefree_hil.gap.noise import Colour
from tunefree_hil.gap.problem import Fitted, Free, Sums

BLOCKS = 15
ALL = np.arange(BLOCKS)
ROWS = 100.0


def model(name: str, square: np.ndarray, other: float = ROWS) -> Modelled:
    """A candidate whose target `a` has these squares by block in units of the noise; `b` has `other` in each."""
    free = (Free(f"{name}.size", 0.0, 1.0, False, 0.0, -0.3, 1.3),) if name else ()
    p = len(free)
    colour = Colour(np.array([1.0]), 1.0, 1.0)
    count = np.full(BLOCKS, ROWS)

    def sums(values: np.ndarray) -> Sums:
        curve = np.tile(1e4 * np.eye(p), (BLOCKS, 1, 1))
        return Sums(np.arange(p), values, np.zeros((BLOCKS, p)), curve, count, colour)

    both = {"a": sums(square), "b": sums(np.full(BLOCKS, other))}
    keys, z = tuple(one.key for one in free), np.full(p, 0.4)
    values = {one.key: 0.4 for one in free}
    squares = {target: (one.square, count) for target, one in both.items()}
    return Modelled(Fitted(name, keys, z, free, values, both, {}), squares)


SIZES = {"a": 3.0, "b": 3.0}
NULL = model("", np.full(BLOCKS, 8.0 * ROWS))


def weighed(**squares: np.ndarray) -> list[Weighed]:
    some = {name: model(name, square) for name, square in squares.items()}
    return weigh(some, NULL, NULL, SIZES, ALL)


def spread(level: float, seed: int = 1) -> np.ndarray:
    return ROWS * level * np.random.default_rng(seed).uniform(0.9, 1.1, BLOCKS)


def test_what_explains_all_blocks_is_a_name_and_what_explains_nothing_is_none() -> None:
    found = weighed(right=spread(1.0), idle=spread(8.0))
    assert [one.name for one in found] == ["right", "idle"]
    assert found[0].counts and found[0].target == "a" and found[0].shrink[0] == pytest.approx(0.875, abs=0.02)
    assert not found[1].counts
    assert rivals(found, ALL) == []


def test_what_explains_one_block_only_is_no_name() -> None:
    square = np.full(BLOCKS, 8.0 * ROWS)
    square[3] = 0.0
    (found,) = weighed(lucky=square)
    assert found.evidence > 100.0 and not found.counts


def test_what_explains_as_much_is_a_rival_whatever_the_order() -> None:
    found = weighed(one=spread(1.0, 1), other=spread(1.0, 2), worse=spread(4.0))
    assert {found[0].name, *rivals(found, ALL)} == {"one", "other"}


def test_what_spoils_another_signal_is_no_name() -> None:
    some = {"wrong": model("wrong", spread(1.0), other=1.2 * ROWS)}
    (found,) = weigh(some, NULL, NULL, SIZES, ALL)
    assert found.evidence > 100.0 and not found.counts


def test_nobody_is_named_beside_one_that_explains_more_and_may_not_be_named() -> None:
    some = {"fair": model("fair", spread(4.0)), "foul": model("foul", spread(1.0), other=1.5 * ROWS)}
    found = weigh(some, NULL, NULL, {"a": 3.0, "b": 3.0}, ALL)
    assert found[0].name == "fair" and found[0].counts and outdone(found) == "foul"
    assert outdone(weigh({"fair": some["fair"]}, NULL, NULL, SIZES, ALL)) == ""


def test_what_is_a_trifle_of_the_signal_is_no_name() -> None:
    (found,) = weigh({"small": model("small", spread(1.0))}, NULL, NULL, {"a": 3e3, "b": 3.0}, ALL)
    assert found.evidence > 100.0 and not found.matters and not found.counts


def test_shrink_has_an_interval_over_blocks() -> None:
    value, low, high = shrink(NULL, model("x", spread(4.0)), "a", ALL)
    assert low < value < high and value == pytest.approx(0.5, abs=0.03)


def test_who_is_best_does_not_depend_on_the_unit_of_a_signal() -> None:
    def in_unit(one: Modelled, unit: float, stretch: float) -> Modelled:
        """Its squares are in units of the noise and stay; the noise itself is another number in another unit."""
        sums = {
            name: some._replace(colour=Colour(some.colour.filter, unit, stretch))
            for name, some in one.fitted.sums.items()
        }
        return one._replace(fitted=one.fitted._replace(sums=sums))

    orders = []
    for unit in (1e-6, 1.0, 1e6):
        some = {
            "near": in_unit(model("near", spread(1.0)), unit, 1.0),
            "far": in_unit(model("far", spread(2.0, 2)), unit, 3.0),
        }
        found = weigh(some, in_unit(NULL, unit, 2.0), NULL, SIZES, ALL)
        orders.append([(one.name, round(one.evidence, 3), one.model.fitted.sums["a"].colour.stretch) for one in found])
    assert orders[0] == orders[1] == orders[2] and orders[0][0][0] == "near"


def test_a_rival_that_misses_a_bar_by_a_hair_is_still_one() -> None:
    best, other = weighed(one=spread(1.0, 1), other=spread(1.0, 2))
    for worst, rival in ((0.9 * MOST_WORSE, True), (1.2 * MOST_WORSE, True), (1.5 * MOST_WORSE, False)):
        close = other._replace(worst=worst)
        assert close.counts == (worst < MOST_WORSE)
        assert (rivals([best, close], ALL) == [other.name]) == rival


def test_what_is_left_is_counted_by_what_was_there() -> None:
    before = {"a": Left(10.0, 9.0), "b": Left(1.0, 0.0)}
    assert left_share(before, {"a": Left(1.0, 0.0), "b": Left(1.0, 0.0)}) == 0.0
    assert left_share(before, before) == pytest.approx(1.0)


def test_a_further_effect_is_held_against_the_gap_that_there_was_at_first() -> None:
    first = model("first", spread(0.5))
    beside = model("beside", spread(0.3, 2))
    beside = beside._replace(fitted=beside.fitted._replace(free=(*first.fitted.free, *beside.fitted.free)))
    (found,) = weigh({"beside": beside}, first, NULL, SIZES, ALL)
    assert found.further and found.shrink[0] == pytest.approx(0.2 / 8.0, abs=0.005) and not found.counts
    assert shrink(first, beside, "a", ALL)[0] == pytest.approx(0.4, abs=0.05)
