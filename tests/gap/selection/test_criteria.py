"""The rules by which a name is given: on candidates made by hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.gap.diagnostics.lack_of_fit import LackOfFit
from tunefree_hil.gap.estimation.evidence import with_correlation_rows
from tunefree_hil.gap.estimation.least_squares import Fit, FreeParameter, NormalEquations
from tunefree_hil.gap.estimation.noise import NoiseModel
from tunefree_hil.gap.selection.criteria import CRITERIA, CandidateScore, Reduction, failed_criteria, failed_reasons
from tunefree_hil.gap.selection.reasons import Criterion
from tunefree_hil.gap.selection.scoring import (
    Comparison,
    affected_targets,
    error_reduction,
    explained_targets,
    score_candidates,
    unexplained_share,
)
from tunefree_hil.gap.workers.worker import FitSummary

BLOCKS = 15
ALL = np.arange(BLOCKS)
ROWS = 100.0


def model(name: str, square: np.ndarray, other: float = ROWS, before: Sequence[str] = ()) -> FitSummary:
    """A candidate whose target `a` has these squares by block in units of the noise; `b` has `other` in each. before:
    effects that the model has beside it.
    """
    names = [one for one in (*before, name) if one]
    free = tuple(FreeParameter(f"{one}.size", 0.0, 1.0, False, 0.0, -0.3, 1.3) for one in names)
    p = len(free)
    colour = NoiseModel(np.array([1.0]), 1.0, 1.0)
    count = np.full(BLOCKS, ROWS)

    def sums(values: np.ndarray) -> NormalEquations:
        curve = np.tile(1e4 * np.eye(p), (BLOCKS, 1, 1))
        return NormalEquations(np.arange(p), values, np.zeros((BLOCKS, p)), curve, count, colour)

    both = {"a": sums(square), "b": sums(np.full(BLOCKS, other))}
    keys, z = tuple(one.key for one in free), np.full(p, 0.4)
    values = {one.key: 0.4 for one in free}
    squares = {target: (one.squared_residuals, count) for target, one in both.items()}
    return FitSummary(Fit(name, keys, z, free, values, np.zeros((p, p)), both, {}), squares)


SIZES = {"a": 3.0, "b": 3.0}
NULL = model("", np.full(BLOCKS, 8.0 * ROWS))


def weighed(**squares: np.ndarray) -> list[CandidateScore]:
    some = {name: model(name, square) for name, square in squares.items()}
    return score_candidates(some, Comparison(NULL, NULL, SIZES, ALL))


def spread(level: float, seed: int = 1) -> np.ndarray:
    return ROWS * level * np.random.default_rng(seed).uniform(0.9, 1.1, BLOCKS)


def test_what_explains_all_blocks_is_a_name_and_what_explains_nothing_is_none() -> None:
    found = weighed(right=spread(1.0), idle=spread(8.0))
    assert [one.name for one in found] == ["right", "idle"]
    assert (
        found[0].is_accepted
        and found[0].target == "a"
        and found[0].error_reduction[0] == pytest.approx(1.0 - 8.0**-0.5, abs=0.01)
    )
    assert not found[1].is_accepted


def test_what_explains_one_block_only_is_no_name() -> None:
    square = np.full(BLOCKS, 8.0 * ROWS)
    square[3] = 0.0
    (found,) = weighed(lucky=square)
    assert found.evidence > 100.0 and not found.is_accepted


def test_what_two_blocks_hold_clearly_is_a_name() -> None:
    """A limit that is touched in two of them: draws of blocks that have neither say nothing against it."""
    null, square = np.full(BLOCKS, ROWS), np.full(BLOCKS, ROWS)
    null[[3, 8]] = 400.0 * ROWS
    before = model("", null)
    (found,) = score_candidates({"limit": model("limit", square)}, Comparison(before, before, SIZES, ALL))
    assert found.error_reduction[1] < 0.05 < CRITERIA.min_other_blocks_reduction < found.other_blocks_reduction
    sure = found.gain._replace(low=1.0)  # a search takes the noise that the limit leaves: all blocks are better told
    assert (
        found._replace(gain=sure).is_accepted
        and not found._replace(gain=sure, other_blocks_reduction=0.5 * CRITERIA.min_other_blocks_reduction).is_accepted
    )
    null[8] = ROWS
    (found,) = score_candidates(
        {"limit": model("limit", square)}, Comparison(model("", null), model("", null), SIZES, ALL)
    )
    assert found.error_reduction[0] > 0.5 and found.other_blocks_reduction == pytest.approx(0.0), "one block"
    assert not found._replace(gain=sure).is_accepted


def test_what_a_signal_gains_that_does_not_feel_an_effect_is_not_its_merit() -> None:
    right, deaf = model("right", spread(1.0)), model("deaf", spread(1.0))
    sums = {target: one._replace(curvature=1e-4 * one.curvature / 1e4) for target, one in deaf.fit.equations.items()}
    deaf = deaf._replace(fit=deaf.fit._replace(equations=sums))
    assert affected_targets(right, ALL) == affected_targets(right, ALL, "right") == ["a", "b"]
    assert affected_targets(deaf, ALL) == affected_targets(right, ALL, "deaf") == []
    judged = ALL[:-3]
    late = {
        t: s._replace(curvature=s.curvature * ~np.isin(ALL, judged)[:, None, None])
        for t, s in right.fit.equations.items()
    }
    proves = right._replace(fit=right.fit._replace(equations=late))
    assert affected_targets(proves, judged) == [] != affected_targets(proves, ALL), (
        "what acts where a repair is proved only, no choice has seen"
    )
    found = {
        one.name: one for one in score_candidates({"right": right, "deaf": deaf}, Comparison(NULL, NULL, SIZES, ALL))
    }
    assert found["right"].is_accepted and not found["deaf"].is_relevant and not found["deaf"].is_accepted


def test_what_spoils_another_signal_is_no_name() -> None:
    some = {"wrong": model("wrong", spread(1.0), other=1.2 * ROWS)}
    (found,) = score_candidates(some, Comparison(NULL, NULL, SIZES, ALL))
    assert found.evidence > 100.0 and not found.is_accepted


def test_what_is_a_trifle_of_the_signal_is_no_name() -> None:
    (found,) = score_candidates(
        {"small": model("small", spread(1.0))}, Comparison(NULL, NULL, {"a": 3e3, "b": 3.0}, ALL)
    )
    assert found.evidence > 100.0 and not found.is_relevant and not found.is_accepted


def test_shrink_has_an_interval_over_blocks() -> None:
    value, low, high = error_reduction(NULL, model("x", spread(4.0)), "a", ALL)
    assert low < value < high and value == pytest.approx(1.0 - 0.5**0.5, abs=0.03)


def test_who_is_best_does_not_depend_on_the_unit_of_a_signal() -> None:
    def in_unit(one: FitSummary, unit: float, stretch: float) -> FitSummary:
        """Its squares are in units of the noise and stay; the noise itself is another number in another unit."""
        sums = {
            name: some._replace(noise=NoiseModel(some.noise.whitening_filter, unit, stretch))
            for name, some in one.fit.equations.items()
        }
        return one._replace(fit=one.fit._replace(equations=sums))

    orders = []
    for unit in (1e-6, 1.0, 1e6):
        some = {
            "near": in_unit(model("near", spread(1.0)), unit, 1.0),
            "far": in_unit(model("far", spread(2.0, 2)), unit, 3.0),
        }
        found = score_candidates(some, Comparison(in_unit(NULL, unit, 2.0), NULL, SIZES, ALL))
        orders.append(
            [(one.name, round(one.evidence, 3), one.model.fit.equations["a"].noise.correlation_rows) for one in found]
        )
    assert orders[0] == orders[1] == orders[2] and orders[0][0][0] == "near"


def test_who_surely_explains_nearly_all_may_leave_another_target_a_little_worse() -> None:
    (one,) = weighed(one=spread(1.0, 1))
    most, part = (
        one._replace(error_reduction=Reduction(0.96, 0.95, 0.97)),
        one._replace(error_reduction=Reduction(0.6, 0.5, 0.7)),
    )
    for worst, found in (
        (0.8 * CRITERIA.max_degradation_if_nearly_full, (True, False)),
        (1.2 * CRITERIA.max_degradation_if_nearly_full, (False, False)),
    ):
        assert tuple(each._replace(degradation=worst).is_accepted for each in (most, part)) == found
    assert not most._replace(
        degradation=0.8 * CRITERIA.max_degradation_if_nearly_full,
        broken_degradation=0.8 * CRITERIA.max_degradation_if_nearly_full,
    ).is_accepted, "what is missed is not spared"


def test_a_target_that_is_missed_is_never_spared() -> None:
    """`b` grows by a tenth, `a` is all but gone."""
    null, spoils = model("", spread(8.0), other=1.0 * ROWS), model("x", spread(0.01), other=1.1 * ROWS)
    for broken, counts in ((None, False), ({"a", "b"}, False), ({"a"}, True)):
        (found,) = score_candidates({"x": spoils}, Comparison(null, null, SIZES, ALL, broken))
        assert found.degradation > CRITERIA.max_degradation and found.is_accepted == counts


def test_what_the_model_misses_as_usual_may_be_a_little_worse() -> None:
    """`b` grows by a fifth, or half as much again and more; `a` is all but gone."""
    null = model("", spread(8.0), other=1.0 * ROWS)
    for grown, counts in ((1.2, True), (1.1 * (1.0 + CRITERIA.max_baseline_degradation), False)):
        some = {"x": model("x", spread(0.01), other=grown * ROWS)}
        (strict,), (found,) = (
            score_candidates(some, Comparison(null, null, SIZES, ALL, {"a", "b"}, usually)) for usually in ((), {"b"})
        )
        assert not strict.is_accepted and strict.broken_degradation == strict.degradation == pytest.approx(grown - 1.0)
        assert found.is_accepted == counts and (found.degradation == 0.0) == counts


def test_worse_tick_by_tick_and_no_less_likely_is_not_worse() -> None:
    """What is left of `b` is larger, and as likely as it was: noise that hangs together over so long says nothing."""
    null, found = model("", spread(8.0), other=1.0 * ROWS), model("x", spread(0.01), other=0.99 * ROWS)
    sums, counts_of = found.squared_residuals["b"]
    larger = found._replace(squared_residuals={**found.squared_residuals, "b": (1.2 * sums, counts_of)})
    for broken, counts in ((None, False), ({"a", "b"}, False), ({"a"}, True)):
        (one,) = score_candidates({"x": larger}, Comparison(null, null, SIZES, ALL, broken))
        assert one.is_accepted == counts, "of a broken link it is the name's business all the same"


def test_what_is_left_is_counted_target_by_target() -> None:
    assert unexplained_share(LackOfFit(10.0, 9.0), LackOfFit(1.0, 0.0)) == 0.0
    assert unexplained_share(LackOfFit(10.0, 9.0), LackOfFit(4.0, 3.0)) == pytest.approx(1.0 / 3.0)
    assert unexplained_share(LackOfFit(1.0, 0.0), LackOfFit(1.0, 0.5)) == 0.0, "nothing was there to be explained"
    assert explained_targets(NULL, model("x", spread(1.0)), SIZES, ALL) == {
        "a": pytest.approx(7.0**0.5 / 3.0, rel=0.01)
    }


def test_a_target_that_recalibration_alone_moved_is_not_worked_on() -> None:
    """`b` is missed by 4 % less beside the effect, or by half without feeling it: nobody is answerable for that."""
    null = model("", spread(8.0), other=8.0 * ROWS)
    little = model("x", spread(1.0), other=8.0 * 0.96**2 * ROWS)
    assert set(explained_targets(null, little, SIZES, ALL)) == {"a"}
    much = model("x", spread(1.0), other=2.0 * ROWS)
    assert set(explained_targets(null, much, SIZES, ALL)) == {"a", "b"}
    assert set(explained_targets(null, numb(much), SIZES, ALL)) == {"a"}


def numb(one: FitSummary) -> FitSummary:
    """The same candidate, of which `b` feels nothing."""
    sums = dict(one.fit.equations)
    sums["b"] = sums["b"]._replace(
        columns=np.arange(0), gradient=np.zeros((BLOCKS, 0)), curvature=np.zeros((BLOCKS, 0, 0))
    )
    return one._replace(fit=one.fit._replace(equations=sums))


def test_what_an_effect_cannot_touch_it_does_not_spoil() -> None:
    """`b` grows by a fifth of its square, as recalibration comes to rest elsewhere."""
    spoils = model("x", spread(1.0), other=1.2 * ROWS)
    for one, counts in ((spoils, False), (numb(spoils), True)):
        (found,) = score_candidates({"x": one}, Comparison(NULL, NULL, SIZES, ALL))
        assert found.is_accepted == counts and (found.degradation > CRITERIA.max_degradation) != counts


def test_what_is_lost_in_a_sensors_noise_shows_in_means_over_a_second() -> None:
    """Of every tick's error 97 % is noise; of the means over a second next to nothing."""
    counts = np.full(BLOCKS, ROWS)
    noisy = [model(name, np.full(BLOCKS, ROWS * (30.0 + bias))) for name, bias in (("", 1.0), ("right", 0.0))]
    before, after = (
        one._replace(
            averaged_squared_residuals={
                "a": (ROWS * (bias + 0.05) * np.ones(BLOCKS), counts),
                "b": one.squared_residuals["b"],
            }
        )
        for one, bias in zip(noisy, (1.0, 0.0), strict=True)
    )
    assert error_reduction(noisy[0], noisy[1], "a", ALL)[0] == pytest.approx(1.0 - (30.0 / 31.0) ** 0.5)
    assert error_reduction(before, after, "a", ALL)[0] == pytest.approx(1.0 - (0.05 / 1.05) ** 0.5)


def test_a_further_effect_is_held_against_the_error_that_there_was_at_first() -> None:
    """It counts where it takes a tenth of that: less is what the first one's form misses of its own cause."""
    for left, counts in ((0.05, False), (1.0, True)):  # of 8 at first, by the first effect alone
        first = model("first", spread(left + 0.3))
        beside = model("beside", spread(0.3, 2))
        beside = beside._replace(fit=beside.fit._replace(free=(*first.fit.free, *beside.fit.free)))
        (found,) = score_candidates({"beside": beside}, Comparison(first, NULL, SIZES, ALL))
        takes = (0.3 + left) ** 0.5 - 0.3**0.5
        assert found.is_further and found.error_reduction[0] == pytest.approx(takes / 8.0**0.5, abs=0.01)
        assert (
            found.is_accepted == counts and not found._replace(evidence=CRITERIA.plain_evidence_nats - 1.0).is_accepted
        )
        (unbroken,) = score_candidates({"beside": beside}, Comparison(first, NULL, SIZES, ALL, frozenset({"b"})))
        assert not unbroken.is_accepted, (
            "it takes a third of what is missed where nothing is broken: a mismatch does that"
        )


@pytest.mark.parametrize(("broken", "left", "faint"), [({"a"}, 6.0, False), (set(), 6.0, True), (set(), 1.0, False)])
def test_a_name_is_faint_that_explains_a_part_of_what_no_link_is_broken_by(
    broken: set[str], left: float, faint: bool
) -> None:
    (found,) = score_candidates({"right": model("right", spread(left))}, Comparison(NULL, NULL, SIZES, ALL, broken))
    assert found.is_accepted and found._replace(evidence=CRITERIA.plain_evidence_nats - 1.0).is_weak == faint
    assert not found._replace(evidence=CRITERIA.plain_evidence_nats).is_weak, (
        "no mismatch has so much evidence for anybody"
    )


@pytest.mark.parametrize(("left", "broken", "counts"), [(1.0, {"a"}, True), (1.0, set(), False), (60.0, {"a"}, False)])
def test_one_block_is_enough_for_who_explains_all_that_is_missed_of_a_broken_link(
    left: float, broken: set[str], counts: bool
) -> None:
    """A stop that one manoeuvre reaches; half explained it may be anybody's."""
    before, after = spread(1.0), spread(1.0)
    before[3], after[3] = 9e3 * ROWS, left * ROWS
    null = model("", before)
    (found,) = score_candidates({"limit": model("limit", after)}, Comparison(null, null, SIZES, ALL, broken))
    sure = found.gain._replace(low=1.0)  # a search takes the noise that the limit leaves
    assert (
        found.error_reduction[1] < 0.05
        and found.other_blocks_reduction < 0.05
        and found._replace(gain=sure).is_accepted == counts
    ), found.error_reduction
    beside = found._replace(gain=sure._replace(std=0.5 * sure.total), is_further=True)  # all of its gain is one block's
    assert beside.is_accepted == counts


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
        evidence=nats,
        gain=gain,
        error_reduction=Reduction(shrinks, low, 1.0),
        other_blocks_reduction=rest,
        degradation=worst,
        is_further=further,
        is_unbroken=unbroken,
    )
    assert one.is_borderline or not one.is_accepted
    held = one._replace(
        evidence=200.0, gain=one.gain._replace(total=200.0, low=150.0), degradation=0.0, is_further=False
    )
    rare = held._replace(
        error_reduction=Reduction(0.5, 0.0, 1.0),
        other_blocks_reduction=1.05 * CRITERIA.min_other_blocks_reduction,
        is_unbroken=True,
    )
    assert rare.is_accepted and rare.is_borderline, "what two blocks hold"


def test_a_target_is_weighed_by_the_noise_of_who_explains_it_not_of_who_is_best_elsewhere() -> None:
    """A wheel that is a scale off says the same in every row: where that is not explained all of them count as one."""
    as_one = {"a": 1.0, "b": 1000.0}
    start, best = (
        one._replace(fit=with_correlation_rows(one.fit, as_one))
        for one in (model("", np.full(BLOCKS, 8.0 * ROWS), 8.0 * ROWS), model("best", spread(0.5), 8.0 * ROWS))
    )
    other = model("other", np.full(BLOCKS, 8.0 * ROWS), ROWS)
    by_name = {
        one.name: one for one in score_candidates({"best": best, "other": other}, Comparison(start, start, SIZES, ALL))
    }
    assert (
        by_name["best"].is_accepted
        and by_name["other"].is_accepted
        and by_name["other"].evidence > CRITERIA.plain_evidence_nats
    )
    assert (
        by_name["other"].error_reductions["b"]
        == by_name["other"].error_reduction[0]
        > by_name["other"].error_reductions["a"]
    )
    little = model("other", np.full(BLOCKS, 8.0 * ROWS), 6.0 * ROWS)
    idle = next(
        one
        for one in score_candidates({"best": best, "other": little}, Comparison(start, start, SIZES, ALL))
        if one.name == "other"
    )
    assert idle.evidence < 0.1 * by_name["other"].evidence


@pytest.mark.parametrize(
    ("change", "criterion"),
    [
        ({"evidence": 5.0}, Criterion.EVIDENCE),
        ({"is_relevant": False}, Criterion.EXPLAINED_SHARE),
        ({"error_reduction": Reduction(0.04, 0.03, 0.05)}, Criterion.ERROR_REDUCTION),
        ({"error_reduction": Reduction(0.5, 0.01, 0.6), "other_blocks_reduction": 0.1}, Criterion.SINGLE_BLOCK),
        ({"degradation": 0.06}, Criterion.DEGRADATION),
        ({"broken_degradation": 0.06}, Criterion.BROKEN_DEGRADATION),
    ],
)
def test_the_criterion_that_failed_is_named_with_its_numbers(change: dict[str, Any], criterion: Criterion) -> None:
    (score,) = weighed(right=spread(1.0))
    score = score._replace(error_reduction=Reduction(0.6, 0.5, 0.7))
    assert failed_criteria(score) == ()
    (reason,) = failed_reasons(score._replace(**change))
    assert reason.criterion is criterion and reason.name == "right" and failed_criteria(score._replace(**change))
    if criterion is Criterion.EVIDENCE:
        assert (reason.value, reason.limit) == (5.0, CRITERIA.min_evidence_nats)


@pytest.mark.parametrize("number", ["total", "low", "std"])
def test_a_gain_that_is_no_number_fails(number: str) -> None:
    (score,) = weighed(right=spread(1.0))
    score = score._replace(gain=score.gain._replace(**{number: np.nan}), is_further=True)
    failed = {"total": Criterion.PREDICTIVE_GAIN, "low": Criterion.PREDICTIVE_GAIN_BOUND, "std": Criterion.GAIN_NOISE}
    assert failed[number] in failed_criteria(score)


numbers = st.floats(-0.2, 1.0)


@given(
    nats=st.floats(0.0, 200.0), gain=st.tuples(st.floats(0.0, 90.0), st.floats(-5.0, 5.0), st.floats(0.0, 30.0)),
    reduction=st.tuples(numbers, numbers, numbers), growth=st.tuples(st.floats(0.0, 0.3), st.floats(0.0, 0.1)),
    flags=st.tuples(st.booleans(), st.booleans(), st.booleans()), rest=numbers, scale=st.sampled_from([1.0, 0.8]),
)  # fmt: skip
def test_the_criteria_are_the_rule_as_one_expression(
    nats: float, gain: tuple[float, ...], reduction: tuple[float, float, float], growth: tuple[float, ...],
    flags: tuple[bool, ...], rest: float, scale: float,
) -> None:  # fmt: skip
    (score,) = weighed(right=spread(1.0))
    relevant, further, unbroken = flags
    total, low, noise = gain
    score = score._replace(
        evidence=nats, gain=score.gain._replace(total=total, low=low, std=noise), error_reduction=Reduction(*reduction),
        degradation=growth[0], broken_degradation=growth[1], is_relevant=relevant, is_further=further,
        is_unbroken=unbroken, other_blocks_reduction=rest,
    )  # fmt: skip
    least, shrink = scale * 6.0, (0.4 if unbroken else 0.1) if further else 0.05
    all_of_it = not unbroken and reduction[0] > 0.95
    sure = nats > (scale * 60.0 if further else least) and total > least and low > 0.0
    if further and not all_of_it:
        sure = sure and total > scale * 3.0 * noise
    passes = (
        sure and relevant and reduction[0] > scale * shrink
        and (reduction[1] > scale * 0.5 * shrink or rest > scale * 0.3 or all_of_it)
        and growth[0] < (0.2 if reduction[1] > 0.9 else 0.05) / scale and growth[1] < 0.05 / scale
    )  # fmt: skip
    assert (not failed_criteria(score, scale=scale)) == passes
