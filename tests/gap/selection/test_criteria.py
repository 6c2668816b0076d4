"""The rules by which a name is given: on candidates made by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.gap.diagnostics.lack_of_fit import Left
from tunefree_hil.gap.estimation.evidence import stretched
from tunefree_hil.gap.estimation.least_squares import Fitted, Free, Sums
from tunefree_hil.gap.estimation.noise import Colour
from tunefree_hil.gap.selection.criteria import (
    MAY_GROW,
    MOST_WORSE,
    PLAIN_NATS,
    RARE,
    SPARED,
    Weighed,
    felt,
    left_share,
    shrink,
    weigh,
    worked_on,
)
from tunefree_hil.gap.workers.worker import Modelled

BLOCKS = 15
ALL = np.arange(BLOCKS)
ROWS = 100.0


def model(name: str, square: np.ndarray, other: float = ROWS, before: Sequence[str] = ()) -> Modelled:
    """A candidate whose target `a` has these squares by block in units of the noise; `b` has `other` in each. before:
    effects that the model has beside it.
    """
    names = [one for one in (*before, name) if one]
    free = tuple(Free(f"{one}.size", 0.0, 1.0, False, 0.0, -0.3, 1.3) for one in names)
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
    return Modelled(Fitted(name, keys, z, free, values, np.zeros((p, p)), both, {}), squares)


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
    assert found[0].counts and found[0].target == "a" and found[0].shrink[0] == pytest.approx(1.0 - 8.0**-0.5, abs=0.01)
    assert not found[1].counts


def test_what_explains_one_block_only_is_no_name() -> None:
    square = np.full(BLOCKS, 8.0 * ROWS)
    square[3] = 0.0
    (found,) = weighed(lucky=square)
    assert found.evidence > 100.0 and not found.counts


def test_what_two_blocks_hold_clearly_is_a_name() -> None:
    """A limit that is touched in two of them: draws of blocks that have neither say nothing against it."""
    null, square = np.full(BLOCKS, ROWS), np.full(BLOCKS, ROWS)
    null[[3, 8]] = 400.0 * ROWS
    before = model("", null)
    (found,) = weigh({"limit": model("limit", square)}, before, before, SIZES, ALL)
    assert found.shrink[1] < 0.05 < RARE < found.rest
    sure = found.gain._replace(low=1.0)  # a search takes the noise that the limit leaves: all blocks are better told
    assert found._replace(gain=sure).counts and not found._replace(gain=sure, rest=0.5 * RARE).counts
    null[8] = ROWS
    (found,) = weigh({"limit": model("limit", square)}, model("", null), model("", null), SIZES, ALL)
    assert found.shrink[0] > 0.5 and found.rest == pytest.approx(0.0), "one block"
    assert not found._replace(gain=sure).counts


def test_what_a_signal_gains_that_does_not_feel_an_effect_is_not_its_merit() -> None:
    right, deaf = model("right", spread(1.0)), model("deaf", spread(1.0))
    sums = {target: one._replace(curve=1e-4 * one.curve / 1e4) for target, one in deaf.fitted.sums.items()}
    deaf = deaf._replace(fitted=deaf.fitted._replace(sums=sums))
    assert felt(right, ALL) == felt(right, ALL, "right") == ["a", "b"]
    assert felt(deaf, ALL) == felt(right, ALL, "deaf") == []
    judged = ALL[:-3]
    late = {t: s._replace(curve=s.curve * ~np.isin(ALL, judged)[:, None, None]) for t, s in right.fitted.sums.items()}
    proves = right._replace(fitted=right.fitted._replace(sums=late))
    assert felt(proves, judged) == [] != felt(proves, ALL), (
        "what acts where a repair is proved only, no choice has seen"
    )
    found = {one.name: one for one in weigh({"right": right, "deaf": deaf}, NULL, NULL, SIZES, ALL)}
    assert found["right"].counts and not found["deaf"].matters and not found["deaf"].counts


def test_what_spoils_another_signal_is_no_name() -> None:
    some = {"wrong": model("wrong", spread(1.0), other=1.2 * ROWS)}
    (found,) = weigh(some, NULL, NULL, SIZES, ALL)
    assert found.evidence > 100.0 and not found.counts


def test_what_is_a_trifle_of_the_signal_is_no_name() -> None:
    (found,) = weigh({"small": model("small", spread(1.0))}, NULL, NULL, {"a": 3e3, "b": 3.0}, ALL)
    assert found.evidence > 100.0 and not found.matters and not found.counts


def test_shrink_has_an_interval_over_blocks() -> None:
    value, low, high = shrink(NULL, model("x", spread(4.0)), "a", ALL)
    assert low < value < high and value == pytest.approx(1.0 - 0.5**0.5, abs=0.03)


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


def test_who_surely_explains_nearly_all_may_leave_another_target_a_little_worse() -> None:
    (one,) = weighed(one=spread(1.0, 1))
    most, part = one._replace(shrink=(0.96, 0.95, 0.97)), one._replace(shrink=(0.6, 0.5, 0.7))
    for worst, found in ((0.8 * SPARED, (True, False)), (1.2 * SPARED, (False, False))):
        assert tuple(each._replace(worst=worst).counts for each in (most, part)) == found
    assert not most._replace(worst=0.8 * SPARED, worst_missed=0.8 * SPARED).counts, "what is missed is not spared"


def test_a_target_that_is_missed_is_never_spared() -> None:
    """`b` grows by a tenth, `a` is all but gone."""
    null, spoils = model("", spread(8.0), other=1.0 * ROWS), model("x", spread(0.01), other=1.1 * ROWS)
    for broken, counts in ((None, False), ({"a", "b"}, False), ({"a"}, True)):
        (found,) = weigh({"x": spoils}, null, null, SIZES, ALL, broken)
        assert found.worst > MOST_WORSE and found.counts == counts


def test_what_the_model_misses_as_usual_may_be_a_little_worse() -> None:
    """`b` grows by a fifth, or half as much again and more; `a` is all but gone."""
    null = model("", spread(8.0), other=1.0 * ROWS)
    for grown, counts in ((1.2, True), (1.1 * (1.0 + MAY_GROW), False)):
        some = {"x": model("x", spread(0.01), other=grown * ROWS)}
        (strict,), (found,) = (weigh(some, null, null, SIZES, ALL, {"a", "b"}, usually) for usually in ((), {"b"}))
        assert not strict.counts and strict.worst_missed == strict.worst == pytest.approx(grown - 1.0)
        assert found.counts == counts and (found.worst == 0.0) == counts


def test_worse_tick_by_tick_and_no_less_likely_is_not_worse() -> None:
    """What is left of `b` is larger, and as likely as it was: noise that hangs together over so long says nothing."""
    null, found = model("", spread(8.0), other=1.0 * ROWS), model("x", spread(0.01), other=0.99 * ROWS)
    sums, counts_of = found.squares["b"]
    larger = found._replace(squares={**found.squares, "b": (1.2 * sums, counts_of)})
    for broken, counts in ((None, False), ({"a", "b"}, False), ({"a"}, True)):
        (one,) = weigh({"x": larger}, null, null, SIZES, ALL, broken)
        assert one.counts == counts, "of a broken link it is the name's business all the same"


def test_what_is_left_is_counted_target_by_target() -> None:
    assert left_share(Left(10.0, 9.0), Left(1.0, 0.0)) == 0.0
    assert left_share(Left(10.0, 9.0), Left(4.0, 3.0)) == pytest.approx(1.0 / 3.0)
    assert left_share(Left(1.0, 0.0), Left(1.0, 0.5)) == 0.0, "nothing was there to be explained"
    assert worked_on(NULL, model("x", spread(1.0)), SIZES, ALL) == {"a": pytest.approx(7.0**0.5 / 3.0, rel=0.01)}


def test_a_target_that_recalibration_alone_moved_is_not_worked_on() -> None:
    """`b` is missed by 4 % less beside the effect, or by half without feeling it: nobody is answerable for that."""
    null = model("", spread(8.0), other=8.0 * ROWS)
    little = model("x", spread(1.0), other=8.0 * 0.96**2 * ROWS)
    assert set(worked_on(null, little, SIZES, ALL)) == {"a"}
    much = model("x", spread(1.0), other=2.0 * ROWS)
    assert set(worked_on(null, much, SIZES, ALL)) == {"a", "b"}
    assert set(worked_on(null, numb(much), SIZES, ALL)) == {"a"}


def numb(one: Modelled) -> Modelled:
    """The same candidate, of which `b` feels nothing."""
    sums = dict(one.fitted.sums)
    sums["b"] = sums["b"]._replace(columns=np.arange(0), slope=np.zeros((BLOCKS, 0)), curve=np.zeros((BLOCKS, 0, 0)))
    return one._replace(fitted=one.fitted._replace(sums=sums))


def test_what_an_effect_cannot_touch_it_does_not_spoil() -> None:
    """`b` grows by a fifth of its square, as recalibration comes to rest elsewhere."""
    spoils = model("x", spread(1.0), other=1.2 * ROWS)
    for one, counts in ((spoils, False), (numb(spoils), True)):
        (found,) = weigh({"x": one}, NULL, NULL, SIZES, ALL)
        assert found.counts == counts and (found.worst > MOST_WORSE) != counts


def test_what_is_lost_in_a_sensors_noise_shows_in_means_over_a_second() -> None:
    """Of every tick's error 97 % is noise; of the means over a second next to nothing."""
    counts = np.full(BLOCKS, ROWS)
    noisy = [model(name, np.full(BLOCKS, ROWS * (30.0 + bias))) for name, bias in (("", 1.0), ("right", 0.0))]
    before, after = (
        one._replace(slow={"a": (ROWS * (bias + 0.05) * np.ones(BLOCKS), counts), "b": one.squares["b"]})
        for one, bias in zip(noisy, (1.0, 0.0), strict=True)
    )
    assert shrink(noisy[0], noisy[1], "a", ALL)[0] == pytest.approx(1.0 - (30.0 / 31.0) ** 0.5)
    assert shrink(before, after, "a", ALL)[0] == pytest.approx(1.0 - (0.05 / 1.05) ** 0.5)


def test_a_further_effect_is_held_against_the_error_that_there_was_at_first() -> None:
    """It counts where it takes a tenth of that: less is what the first one's form misses of its own cause."""
    for left, counts in ((0.05, False), (1.0, True)):  # of 8 at first, by the first effect alone
        first = model("first", spread(left + 0.3))
        beside = model("beside", spread(0.3, 2))
        beside = beside._replace(fitted=beside.fitted._replace(free=(*first.fitted.free, *beside.fitted.free)))
        (found,) = weigh({"beside": beside}, first, NULL, SIZES, ALL)
        takes = (0.3 + left) ** 0.5 - 0.3**0.5
        assert found.further and found.shrink[0] == pytest.approx(takes / 8.0**0.5, abs=0.01)
        assert found.counts == counts and not found._replace(evidence=PLAIN_NATS - 1.0).counts
        (unbroken,) = weigh({"beside": beside}, first, NULL, SIZES, ALL, frozenset({"b"}))
        assert not unbroken.counts, "it takes a third of what is missed where nothing is broken: a mismatch does that"


@pytest.mark.parametrize(("broken", "left", "faint"), [({"a"}, 6.0, False), (set(), 6.0, True), (set(), 1.0, False)])
def test_a_name_is_faint_that_explains_a_part_of_what_no_link_is_broken_by(
    broken: set[str], left: float, faint: bool
) -> None:
    (found,) = weigh({"right": model("right", spread(left))}, NULL, NULL, SIZES, ALL, broken)
    assert found.counts and found._replace(evidence=PLAIN_NATS - 1.0).faint == faint
    assert not found._replace(evidence=PLAIN_NATS).faint, "no mismatch has so much evidence for anybody"


@pytest.mark.parametrize(("left", "broken", "counts"), [(1.0, {"a"}, True), (1.0, set(), False), (60.0, {"a"}, False)])
def test_one_block_is_enough_for_who_explains_all_that_is_missed_of_a_broken_link(
    left: float, broken: set[str], counts: bool
) -> None:
    """A stop that one manoeuvre reaches; half explained it may be anybody's."""
    before, after = spread(1.0), spread(1.0)
    before[3], after[3] = 9e3 * ROWS, left * ROWS
    null = model("", before)
    (found,) = weigh({"limit": model("limit", after)}, null, null, SIZES, ALL, broken)
    sure = found.gain._replace(low=1.0)  # a search takes the noise that the limit leaves
    assert found.shrink[1] < 0.05 and found.rest < 0.05 and found._replace(gain=sure).counts == counts, found.shrink
    beside = found._replace(gain=sure._replace(noise=0.5 * sure.total), further=True)  # all of its gain is one block's
    assert beside.counts == counts


@given(
    rest=st.floats(0.0, 1.0), low=st.floats(-0.5, 0.5), shrinks=st.floats(0.0, 1.0), worst=st.floats(0.0, 0.3),
    nats=st.floats(0.0, 200.0), further=st.booleans(), unbroken=st.booleans(),
)  # fmt: skip
def test_a_name_is_never_further_off_than_a_hair(
    rest: float, low: float, shrinks: float, worst: float, nats: float, further: bool, unbroken: bool
) -> None:
    (one,) = weighed(a=np.full(BLOCKS, ROWS))
    gain = one.gain._replace(total=nats, low=nats - 1.0)
    one = one._replace(
        evidence=nats, gain=gain, shrink=(shrinks, low, 1.0), rest=rest, worst=worst, further=further, unbroken=unbroken
    )
    assert one.nearly or not one.counts
    held = one._replace(evidence=200.0, gain=one.gain._replace(total=200.0, low=150.0), worst=0.0, further=False)
    rare = held._replace(shrink=(0.5, 0.0, 1.0), rest=1.05 * RARE, unbroken=True)
    assert rare.counts and rare.nearly, "what two blocks hold"


def test_a_target_is_weighed_by_the_noise_of_who_explains_it_not_of_who_is_best_elsewhere() -> None:
    """A wheel that is a scale off says the same in every row: where that is not explained all of them count as one."""
    as_one = {"a": 1.0, "b": 1000.0}
    start, best = (
        one._replace(fitted=stretched(one.fitted, as_one))
        for one in (model("", np.full(BLOCKS, 8.0 * ROWS), 8.0 * ROWS), model("best", spread(0.5), 8.0 * ROWS))
    )
    other = model("other", np.full(BLOCKS, 8.0 * ROWS), ROWS)
    by_name = {one.name: one for one in weigh({"best": best, "other": other}, start, start, SIZES, ALL)}
    assert by_name["best"].counts and by_name["other"].counts and by_name["other"].evidence > PLAIN_NATS
    assert by_name["other"].shrinks["b"] == by_name["other"].shrink[0] > by_name["other"].shrinks["a"]
    little = model("other", np.full(BLOCKS, 8.0 * ROWS), 6.0 * ROWS)
    idle = next(one for one in weigh({"best": best, "other": little}, start, start, SIZES, ALL) if one.name == "other")
    assert idle.evidence < 0.1 * by_name["other"].evidence
