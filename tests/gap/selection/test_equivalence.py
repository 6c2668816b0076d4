"""Who else may be meant: on candidates made by hand."""

from __future__ import annotations

from tests.gap.selection.test_criteria import ALL, NULL, ROWS, SIZES, model, spread, weighed
from tunefree_hil.gap.selection.criteria import MOST_WORSE, PLAIN_NATS, weigh
from tunefree_hil.gap.selection.equivalence import SAME, outdone, rivals


def test_who_explains_nothing_is_no_rival() -> None:
    assert rivals(weighed(right=spread(1.0), idle=spread(8.0)), ALL) == []


def test_what_explains_as_much_is_a_rival_whatever_the_order() -> None:
    found = weighed(one=spread(1.0, 1), other=spread(1.0, 2), worse=spread(4.0))
    assert {found[0].name, *rivals(found, ALL)} == {"one", "other"}


def test_nobody_is_named_beside_one_that_explains_more_and_may_not_be_named() -> None:
    some = {"fair": model("fair", spread(4.0)), "foul": model("foul", spread(1.0), other=1.5 * ROWS)}
    found = weigh(some, NULL, NULL, SIZES, ALL)
    assert found[0].name == "fair" and found[0].counts and outdone(found) == "foul" and not outdone(found[:1])
    unsure = found[1]._replace(gain=found[1].gain._replace(low=-1.0))
    assert outdone([found[0], unsure]) == "foul", "it explains more of what was held out, too"
    assert not outdone([found[0], unsure._replace(gain=unsure.gain._replace(total=found[0].gain.total))])


def test_a_rival_that_misses_a_bar_by_a_hair_is_still_one() -> None:
    best, other = weighed(one=spread(1.0, 1), other=spread(1.0, 2))
    for worst, rival in ((0.9 * MOST_WORSE, True), (1.2 * MOST_WORSE, True), (1.5 * MOST_WORSE, False)):
        close = other._replace(worst=worst)
        assert close.counts == (worst < MOST_WORSE)
        assert (rivals([best, close], ALL) == [other.name]) == rival


def test_where_no_link_is_broken_a_small_lead_over_who_explains_the_same_is_none() -> None:
    best, other = weighed(one=spread(1.0, 1), other=spread(1.5, 2))
    assert best.evidence - other.evidence > PLAIN_NATS and not rivals([best, other], ALL)
    near = other._replace(shrink=best.shrink, evidence=best.evidence - 0.5 * PLAIN_NATS)
    for first, second, told in (
        (best._replace(unbroken=True), near, False),
        (best._replace(unbroken=True), near._replace(shrink=(0.99, 0.98, 0.995)), False),
        (best, near, True),
        (best._replace(unbroken=True), near._replace(evidence=best.evidence - 2.0 * PLAIN_NATS), True),
        (best._replace(unbroken=True), near._replace(shrink=(0.5, 0.4, 0.6)), True),
        (best._replace(unbroken=True), near._replace(target="b"), True),
    ):
        assert bool(rivals([first, second], ALL)) != told


def test_who_explains_more_on_no_less_evidence_is_a_rival_though_a_rule_forbids_its_name() -> None:
    best, other = weighed(one=spread(1.0, 1), other=spread(1.5, 2))
    more = other._replace(worst=1.0, evidence=best.evidence, shrink=(best.shrink[0] + 0.01, 0.6, 0.7))
    assert not more.nearly and rivals([best, more], ALL) == ["other"]
    less = (more._replace(evidence=0.0), more._replace(shrink=best.shrink), more._replace(target="b"))
    assert not any(rivals([best, one], ALL) for one in less) and not rivals([best._replace(further=True), more], ALL)


def test_who_is_about_another_signal_is_nobodys_rival_and_outdoes_nobody() -> None:
    best, other = weighed(one=spread(1.0, 1), other=spread(1.0, 2))
    assert rivals([best, other], ALL) == [other.name]
    elsewhere = other._replace(target="b", shrinks={"a": 0.5 * SAME * best.shrink[0], "b": 0.9})
    assert rivals([best, elsewhere], ALL) == []
    more = other._replace(worst=1.0, evidence=10.0 * best.evidence)
    assert outdone([best, more]) == other.name and not outdone([best, more._replace(shrinks=elsewhere.shrinks)])
    both = elsewhere._replace(shrinks={"a": 1.5 * SAME * best.shrink[0], "b": 0.9})
    assert rivals([best, both], ALL) == [other.name], "what it does elsewhere may be the rest of what it did here"
