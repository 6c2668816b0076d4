"""The search over effects, on models made by hand: what is no merit of an effect does not count for it."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from tests.gap.selection.test_criteria import ALL, NULL, ROWS, SIZES, model, spread
from tunefree_hil.gap.estimation.candidates import Candidate
from tunefree_hil.gap.estimation.evidence import MIN_EVIDENCE_NATS, with_correlation_rows
from tunefree_hil.gap.selection.criteria import CRITERIA, SEARCH, CandidateScore
from tunefree_hil.gap.selection.model_misfit import SearchContext
from tunefree_hil.gap.selection.reasons import Criterion, Reason, RejectionStage
from tunefree_hil.gap.selection.search import fit_and_score, search_backward, search_forward, settle_steps
from tunefree_hil.gap.workers.worker import FitSummary, OpenProblem

SUSPECTS = tuple(Candidate(name, (), ()) for name in ("delay", "friction", "limit", "lag"))
SOME = {
    "recalibrated": NULL,
    "signal_scales": SIZES,
    "candidates": SUSPECTS,
    "broken_targets": None,
    "targets_within_baseline": (),
}
QUESTION = cast(OpenProblem, type("Asked", (), SOME)())


def beside(first: FitSummary, name: str, square: np.ndarray, other: float = ROWS) -> FitSummary:
    """A model with the effects of `first` and one more."""
    return model(name, square, other, [one.key.partition(".")[0] for one in first.fit.free])


FIRST = model("delay", spread(2.0))


class Made:
    """A team whose fits are known beforehand. rest: what a model comes to without an effect, by its name."""

    def __init__(
        self, alone: dict[str, FitSummary], further: dict[str, FitSummary], rest: dict[str, FitSummary]
    ) -> None:
        self.alone, self.further, self.rest = alone, further, rest
        self.asked: list[tuple[str, ...]] = []
        self.again: dict[str, FitSummary] = {}  # by the noise of the best: what grids under the start's did not see
        self.screened: dict[str, tuple[Reason, ...]] = {}  # by the last effect of the model that was added to

    def fit_candidates(
        self, names: list[str], start: FitSummary | None, noise: FitSummary | None = None
    ) -> dict[str, FitSummary]:
        if noise is not None:
            return {name: self.again[name] for name in names if name in self.again}
        self.asked.append(tuple(names))
        some = self.alone if start is None else self.further
        return {name: some[name] for name in names if name in some}

    def refine_fits(self, models: list[FitSummary]) -> list[FitSummary]:
        return models

    def unfitted_beside(self, model: FitSummary) -> tuple[Reason, ...]:
        return self.screened.get(model.fit.name, ())

    def fit_without_effects(self, model: FitSummary, names: list[str]) -> dict[str, FitSummary]:
        return {name: self.rest[name] for name in names}


def run(steps: Any) -> Any:
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def search_all(team: Made) -> tuple[list[CandidateScore], list[Reason]]:
    """The steps of a whole search, and what it rejects on the way."""
    context = SearchContext(cast(Any, team), QUESTION, ALL)
    alone = fit_and_score(context, list(team.alone))
    added = run(search_forward(context, alone))
    stay = run(search_backward(context, added.steps))
    settled = run(settle_steps(context, alone, stay.steps, len(stay.steps) < len(added.steps)))
    return settled.steps, [*added.rejected, *stay.rejected, *settled.rejected]


def found_by(team: Made) -> list[CandidateScore]:
    return search_all(team)[0]


def rejections_of(team: Made, name: str, stage: RejectionStage) -> list[Reason]:
    return [reason for reason in search_all(team)[1] if (reason.name, reason.stage) == (name, stage)]


def searched(team: Made) -> list[str]:
    return [step.name for step in found_by(team)]


def test_a_further_effect_that_explains_much_of_the_gap_is_added() -> None:
    both = beside(FIRST, "friction", spread(0.5, 3))
    team = Made({"delay": FIRST, "friction": model("friction", spread(6.0))}, {"friction": both},
                {"friction": FIRST, "delay": model("friction", spread(6.0))})  # fmt: skip
    assert searched(team) == ["delay", "friction"]
    # whoever was hidden by the first, too; and at last who else might stand in the first one's place
    assert team.asked[1:] == [("friction", "limit", "lag"), ("limit", "lag"), ("limit", "lag")]


def test_what_the_rest_comes_to_by_itself_is_no_merit_of_a_limit_that_nothing_touches() -> None:
    better = beside(FIRST, "limit", spread(0.5, 3))
    team = Made({"delay": FIRST, "limit": model("limit", spread(7.9))}, {"limit": better},
                {"limit": model("delay", spread(0.5, 3))})  # fmt: skip
    assert searched(team) == ["delay"]


def test_the_first_is_taken_out_again_where_the_second_explains_all_of_it() -> None:
    both = beside(FIRST, "lag", spread(0.5, 3))
    alone = model("lag", spread(0.5, 3))
    team = Made({"delay": FIRST}, {"lag": both}, {"lag": FIRST, "delay": alone})
    team.alone["lag"] = model("lag", spread(7.0))  # its search alone had stuck
    assert searched(team) == ["lag"]


def test_an_effect_that_is_taken_out_has_the_criteria_that_it_fails_beside_the_later_one() -> None:
    both, lag = beside(FIRST, "lag", spread(0.5, 3)), model("lag", spread(0.5, 3))
    team = Made({"delay": FIRST, "lag": model("lag", spread(7.0))}, {"lag": both}, {"lag": FIRST, "delay": lag})
    reasons = rejections_of(team, "delay", RejectionStage.BACKWARD)
    assert {Criterion.EVIDENCE, Criterion.ERROR_REDUCTION} <= {reason.criterion for reason in reasons}
    assert all(reason.beside == ("lag",) for reason in reasons)
    (evidence,) = [reason for reason in reasons if reason.criterion is Criterion.EVIDENCE]
    assert (evidence.value or 0.0) < CRITERIA.plain_evidence_nats == evidence.limit
    kept = Made({"delay": FIRST, "lag": lag}, {"lag": both}, {"lag": FIRST, "delay": model("lag", spread(6.0))})
    assert not rejections_of(kept, "delay", RejectionStage.BACKWARD)


def test_a_further_candidate_has_the_criteria_that_it_fails_beside_those_before() -> None:
    both = beside(FIRST, "friction", spread(0.5, 3))
    further = {"friction": both, "limit": beside(FIRST, "limit", spread(1.95, 4))}
    rest = {"friction": FIRST, "delay": model("friction", spread(6.0))}
    team = Made({"delay": FIRST, "friction": model("friction", spread(6.0))}, further, rest)
    team.screened = {"delay": (Reason(Criterion.SCREENED, "lag", 1.5, 4.0, stage=RejectionStage.SCREENING),)}
    reasons = rejections_of(team, "limit", RejectionStage.FORWARD)
    assert {reason.beside for reason in reasons} == {("delay",), ("delay", "friction")}
    assert Criterion.ERROR_REDUCTION in {reason.criterion for reason in reasons}
    assert not [reason for reason in rejections_of(team, "friction", RejectionStage.FORWARD) if len(reason.beside) == 1]
    assert rejections_of(team, "lag", RejectionStage.SCREENING) == list(team.screened["delay"])


def test_a_further_candidate_that_gains_only_what_the_rest_comes_to_alone_has_a_reason() -> None:
    better = beside(FIRST, "limit", spread(0.5, 3))
    rest = {"limit": model("delay", spread(0.5, 3))}
    team = Made({"delay": FIRST, "limit": model("limit", spread(7.9))}, {"limit": better}, rest)
    reasons = rejections_of(team, "limit", RejectionStage.FORWARD)
    assert Criterion.EVIDENCE in {reason.criterion for reason in reasons}


def test_a_further_candidate_that_one_outdoes_which_fails_a_criterion_has_that_reason() -> None:
    further = {
        "friction": beside(FIRST, "friction", spread(1.0, 3)),
        "lag": beside(FIRST, "lag", spread(0.3, 4), other=1.5 * ROWS),
    }
    team = Made({"delay": FIRST}, further, {"friction": FIRST, "lag": FIRST})
    (reason,) = [
        reason
        for reason in rejections_of(team, "friction", RejectionStage.FORWARD)
        if reason.criterion is Criterion.BETTER_REJECTED
    ]
    assert reason.value is not None and reason.limit is not None and reason.value < reason.limit
    assert reason.others == ("lag",) and searched(team) == ["delay"]


def test_a_candidate_that_does_not_fit_in_the_place_of_an_effect_has_a_reason() -> None:
    both = beside(FIRST, "friction", spread(0.5, 3))
    rest = {"friction": FIRST, "delay": model("friction", spread(6.0)), "limit": FIRST}
    places = {"limit": beside(model("friction", spread(6.0)), "limit", spread(5.9, 4))}

    class InPlace(Made):
        def fit_candidates(
            self, names: list[str], start: FitSummary | None, noise: FitSummary | None = None
        ) -> dict[str, FitSummary]:
            if noise is None and start is not None and start.fit.name == "friction":
                return places
            return super().fit_candidates(names, start, noise)

    team = InPlace({"delay": FIRST}, {"friction": both}, rest)
    reasons = rejections_of(team, "limit", RejectionStage.SETTLING)
    assert reasons and all(reason.beside == ("friction",) for reason in reasons)


def test_a_single_effect_that_the_best_candidate_replaces_has_a_reason() -> None:
    context = SearchContext(cast(Any, Made({}, {}, {})), QUESTION, ALL)
    alone = fit_and_score(
        SearchContext(cast(Any, Made({"limit": model("limit", spread(0.5, 3))}, {}, {})), QUESTION, ALL), ["limit"]
    )
    (lost,) = fit_and_score(
        SearchContext(cast(Any, Made({"lag": model("lag", spread(3.0))}, {}, {})), QUESTION, ALL), ["lag"]
    )
    settled = run(settle_steps(context, alone, [lost]))
    assert [step.name for step in settled.steps] == ["limit"]
    (reason,) = settled.rejected
    assert (reason.criterion, reason.name, reason.others) == (Criterion.OUTSCORED, "lag", ("limit",))
    assert reason.value is not None and reason.limit is not None and reason.value < reason.limit


def test_who_stays_alone_is_weighed_against_everybody_alone() -> None:
    both, lag = beside(FIRST, "lag", spread(0.5, 3)), model("lag", spread(0.5, 3))
    alone = {"delay": FIRST, "lag": model("lag", spread(7.0)), "limit": model("limit", spread(0.5, 4))}
    alone["limit"] = alone["limit"]._replace(fit=alone["limit"].fit)
    team = Made({"delay": FIRST, "lag": alone["lag"]}, {"lag": both}, {"lag": FIRST, "delay": lag})
    (step,) = found_by(team)
    assert step.name == "lag" and step.equivalents == ()
    one = cast(Any, team)
    first = fit_and_score(SearchContext(one, QUESTION, ALL), list(team.alone))
    limit = fit_and_score(SearchContext(cast(Any, Made({"limit": alone["limit"]}, {}, {})), QUESTION, ALL), ["limit"])
    (again,), _, _ = run(settle_steps(SearchContext(one, QUESTION, ALL), [*first, *limit], [step]))
    assert {again.name, *again.equivalents} == {"lag", "limit"}


def test_of_two_effects_each_has_its_rivals_in_its_own_place() -> None:
    both = beside(FIRST, "friction", spread(0.5, 3))
    equal = beside(model("friction", spread(6.0)), "lag", spread(0.5, 4))  # in the place of the delay
    worse = beside(FIRST, "limit", spread(1.9, 5))
    rest = {"friction": FIRST, "delay": model("friction", spread(6.0)), "limit": FIRST}

    class Placed(Made):
        def fit_candidates(
            self, names: list[str], start: FitSummary | None, noise: FitSummary | None = None
        ) -> dict[str, FitSummary]:
            if start is not None and start.fit.name == "friction":
                return {"lag": equal}
            return super().fit_candidates(names, start, noise)

    team = Placed({"delay": FIRST}, {"friction": both, "limit": worse}, rest)
    delay, friction = found_by(team)
    assert (delay.name, delay.equivalents) == ("delay", ("lag",)) and (friction.name, friction.equivalents) == (
        "friction",
        (),
    )
    assert set(delay.evidence_in_place) == {"delay", "lag"} and set(friction.evidence_in_place) == {"friction", "limit"}
    assert (
        delay.evidence_in_place["lag"] == pytest.approx(delay.evidence_in_place["delay"], rel=0.1)
        and friction.evidence_in_place["limit"] < 100.0
    )


def test_whoever_is_near_the_best_is_fitted_on_before_it_is_judged() -> None:
    asked: list[str] = []

    class Counting(Made):
        def refine_fits(self, models: list[FitSummary]) -> list[FitSummary]:
            asked.extend(one.fit.name for one in models)
            return models

    names = [f"e{i}" for i in range(SEARCH.refined_at_once + 3)]
    team = Counting({name: model(name, spread(1.0 + 0.02 * i, i)) for i, name in enumerate(names)}, {}, {})
    team.alone["far"] = model("far", spread(6.0))
    fit_and_score(SearchContext(cast(Any, team), QUESTION, ALL), [*names, "far"])
    assert sorted(asked) == sorted(names)


def test_the_best_is_fitted_on_however_little_it_has_after_one_step() -> None:
    """A bias that one step leaves passes for noise: fitted to its end it has all the evidence there is."""
    near, there = model("delay", spread(4.0)), model("delay", spread(1.0))
    near = near._replace(fit=with_correlation_rows(near.fit, {"a": 4000.0}))

    class Finishing(Made):
        def refine_fits(self, models: list[FitSummary]) -> list[FitSummary]:
            return [there if one is near else one for one in models]

    (alone,) = fit_and_score(SearchContext(cast(Any, Made({"delay": near}, {}, {})), QUESTION, ALL), ["delay"])
    assert not alone.is_accepted and alone.evidence < MIN_EVIDENCE_NATS
    (found,) = fit_and_score(SearchContext(cast(Any, Finishing({"delay": near}, {}, {})), QUESTION, ALL), ["delay"])
    assert found.is_accepted and found.evidence > CRITERIA.plain_evidence_nats


def test_whom_the_grid_did_not_see_by_the_starts_noise_is_found_by_the_best_ones() -> None:
    """A constant force: by the noise of a start that lacks it nobody gains anything from its truth (test_scan.py)."""
    team = Made(
        {"delay": FIRST, "friction": model("friction", spread(7.9)), "lag": model("lag", spread(2.5, 3))}, {}, {}
    )
    assert fit_and_score(SearchContext(cast(Any, team), QUESTION, ALL), list(team.alone))[0].name == "delay"
    team.again = {"friction": model("friction", spread(0.5, 4)), "lag": model("lag", spread(7.0))}
    found = fit_and_score(SearchContext(cast(Any, team), QUESTION, ALL), list(team.alone))
    assert found[0].name == "friction" and found[0].is_accepted
    (lag,) = [one for one in found if one.name == "lag"]
    assert (
        lag.model.fit.equations["a"].squared_residuals.sum()
        == team.alone["lag"].fit.equations["a"].squared_residuals.sum()
    )  # not the worse


def test_where_the_best_has_little_evidence_nobody_is_asked_again() -> None:
    team = Made({"delay": model("delay", spread(7.9))}, {}, {})
    team.again = {"delay": FIRST}
    (found,) = fit_and_score(SearchContext(cast(Any, team), QUESTION, ALL), ["delay"])
    assert found.evidence < CRITERIA.plain_evidence_nats


def test_two_that_hide_each_other_are_found_together() -> None:
    """A late INS and a filtered gyro: whichever is repaired alone spoils what compares the two."""
    late, worse = model("delay", spread(0.5), 5.0 * ROWS), model("lag", spread(7.9), 5.0 * ROWS)
    both = beside(late, "lag", spread(0.5, 3), 0.5 * ROWS)
    small = model("friction", spread(6.5))
    team = Made({"delay": late, "lag": worse, "friction": small}, {"lag": both}, {"delay": worse, "lag": late})
    assert searched(team) == ["delay", "lag"]
    first = fit_and_score(SearchContext(cast(Any, team), QUESTION, ALL), list(team.alone))
    assert first[0].name == "friction" and [one.name for one in first if one.degrades_others] == ["delay"]


def test_who_spoils_a_signal_is_nobody_alone() -> None:
    late = model("delay", spread(0.5), 5.0 * ROWS)
    team = Made({"delay": late, "friction": model("friction", spread(6.5))}, {}, {})
    assert searched(team) == []
    beside_it = Made(team.alone, {"lag": beside(late, "lag", spread(0.4, 3), 5.0 * ROWS)}, {"lag": late, "delay": late})
    assert searched(beside_it) == [], "what comes beside it mends nothing of what it spoils"


@pytest.mark.parametrize("gain", [0.0, 0.3])
def test_nothing_is_named_where_nothing_counts(gain: float) -> None:
    assert searched(Made({"delay": model("delay", spread(8.0 - gain))}, {}, {})) == []
