"""Who else may be meant: on candidates made by hand."""

from __future__ import annotations

from tests.gap.selection.test_criteria import ALL, NULL, ROWS, SIZES, model, spread, weighed
from tunefree_hil.gap.selection.criteria import CRITERIA, EQUIVALENCE, CandidateScore, Reduction
from tunefree_hil.gap.selection.equivalence import find_better_rejected, find_equivalents
from tunefree_hil.gap.selection.scoring import Comparison, score_candidates


def test_who_explains_nothing_is_no_rival() -> None:
    assert find_equivalents(weighed(right=spread(1.0), idle=spread(8.0)), ALL) == []


def test_what_explains_as_much_is_a_rival_whatever_the_order() -> None:
    found = weighed(one=spread(1.0, 1), other=spread(1.0, 2), worse=spread(4.0))
    assert {found[0].name, *find_equivalents(found, ALL)} == {"one", "other"}


def test_nobody_is_named_beside_one_that_explains_more_and_may_not_be_named() -> None:
    some = {"fair": model("fair", spread(4.0)), "foul": model("foul", spread(1.0), other=1.5 * ROWS)}
    found = score_candidates(some, Comparison(NULL, NULL, SIZES, ALL))
    assert (
        found[0].name == "fair"
        and found[0].is_accepted
        and _outdone_by(found) == "foul"
        and not find_better_rejected(found[:1])
    )
    unsure = found[1]._replace(gain=found[1].gain._replace(low=-1.0))
    assert _outdone_by([found[0], unsure]) == "foul", "it explains more of what was held out, too"
    assert not find_better_rejected([found[0], unsure._replace(gain=unsure.gain._replace(total=found[0].gain.total))])


def test_a_rival_that_misses_a_bar_by_a_hair_is_still_one() -> None:
    best, other = weighed(one=spread(1.0, 1), other=spread(1.0, 2))
    for worst, rival in (
        (0.9 * CRITERIA.max_degradation, True),
        (1.2 * CRITERIA.max_degradation, True),
        (1.5 * CRITERIA.max_degradation, False),
    ):
        close = other._replace(degradation=worst)
        assert close.is_accepted == (worst < CRITERIA.max_degradation)
        assert (find_equivalents([best, close], ALL) == [other.name]) == rival


def test_where_no_link_is_broken_a_small_lead_over_who_explains_the_same_is_none() -> None:
    best, other = weighed(one=spread(1.0, 1), other=spread(1.5, 2))
    assert best.evidence - other.evidence > CRITERIA.plain_evidence_nats and not find_equivalents([best, other], ALL)
    near = other._replace(
        error_reduction=best.error_reduction, evidence=best.evidence - 0.5 * CRITERIA.plain_evidence_nats
    )
    for first, second, told in (
        (best._replace(is_unbroken=True), near, False),
        (best._replace(is_unbroken=True), near._replace(error_reduction=Reduction(0.99, 0.98, 0.995)), False),
        (best, near, True),
        (
            best._replace(is_unbroken=True),
            near._replace(evidence=best.evidence - 2.0 * CRITERIA.plain_evidence_nats),
            True,
        ),
        (best._replace(is_unbroken=True), near._replace(error_reduction=Reduction(0.5, 0.4, 0.6)), True),
        (best._replace(is_unbroken=True), near._replace(target="b"), True),
    ):
        assert bool(find_equivalents([first, second], ALL)) != told


def test_who_explains_more_on_no_less_evidence_is_a_rival_though_a_rule_forbids_its_name() -> None:
    best, other = weighed(one=spread(1.0, 1), other=spread(1.5, 2))
    more = other._replace(
        degradation=1.0, evidence=best.evidence, error_reduction=Reduction(best.error_reduction[0] + 0.01, 0.6, 0.7)
    )
    assert not more.is_borderline and find_equivalents([best, more], ALL) == ["other"]
    less = (more._replace(evidence=0.0), more._replace(error_reduction=best.error_reduction), more._replace(target="b"))
    assert not any(find_equivalents([best, one], ALL) for one in less) and not find_equivalents(
        [best._replace(is_further=True), more], ALL
    )


def test_who_is_about_another_signal_is_nobodys_rival_and_outdoes_nobody() -> None:
    best, other = weighed(one=spread(1.0, 1), other=spread(1.0, 2))
    assert find_equivalents([best, other], ALL) == [other.name]
    elsewhere = other._replace(
        target="b", error_reductions={"a": 0.5 * EQUIVALENCE.min_shared_reduction * best.error_reduction[0], "b": 0.9}
    )
    assert find_equivalents([best, elsewhere], ALL) == []
    more = other._replace(degradation=1.0, evidence=10.0 * best.evidence)
    assert _outdone_by([best, more]) == other.name and not find_better_rejected(
        [best, more._replace(error_reductions=elsewhere.error_reductions)]
    )
    both = elsewhere._replace(
        error_reductions={"a": 1.5 * EQUIVALENCE.min_shared_reduction * best.error_reduction[0], "b": 0.9}
    )
    assert find_equivalents([best, both], ALL) == [other.name], (
        "what it does elsewhere may be the rest of what it did here"
    )


def _outdone_by(scores: list[CandidateScore]) -> str:
    better = find_better_rejected(scores)
    return "" if better is None else better.name
