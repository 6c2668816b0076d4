"""Reasons of the candidates that are not named: none is without one, and each has the numbers that were compared."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.gap.selection.test_criteria import ALL, NULL, ROWS, SIZES, model, spread, weighed
from tunefree_hil.gap.measured.excitation import Excitation, Shortage
from tunefree_hil.gap.result_text import SCORE_TEXTS, STAGE_TEXTS, TEXTS, candidate_text, reason_text
from tunefree_hil.gap.selection.candidate_reasons import (
    excitation_reasons,
    rejected_reasons,
    remaining_reasons,
    score_reasons,
    step_reasons,
)
from tunefree_hil.gap.selection.criteria import CandidateScore, failed_reasons
from tunefree_hil.gap.selection.equivalence import find_equivalents
from tunefree_hil.gap.selection.reasons import Criterion, Reason, RejectionStage, reason_entry, reason_from_entry
from tunefree_hil.gap.selection.scoring import Comparison, score_candidates

NAMES = ("steer_lag", "steer_dead_time", "brake_gain", "brake_drag", "rolling_resistance", "payload")
# Level of the squares with the candidate (8 without any), and of another signal (1 without any)
LEVELS = st.dictionaries(st.sampled_from(NAMES), st.tuples(st.floats(0.5, 9.0), st.floats(0.9, 1.3)), min_size=1)


def scores_of(levels: Mapping[str, tuple[float, float]]) -> list[CandidateScore]:
    fits = {
        name: model(name, spread(level, i), other * ROWS) for i, (name, (level, other)) in enumerate(levels.items())
    }
    return score_candidates(fits, Comparison(NULL, NULL, SIZES, ALL))


@given(LEVELS, st.booleans())
def test_every_candidate_is_selected_or_has_a_reason(levels: dict[str, tuple[float, float]], is_named: bool) -> None:
    scores = scores_of(levels)
    equivalents = find_equivalents(scores, ALL)
    steps = [scores[0]._replace(equivalents=tuple(equivalents))] if scores[0].is_accepted else []
    names = {step.name for step in steps} if is_named else set[str]()
    failed = score_reasons(scores, RejectionStage.SCAN)
    rest = remaining_reasons(scores, steps, {*names, *(reason.name for reason in failed)}, has_lateral=True)
    assert names | {reason.name for reason in (*failed, *rest)} == set(levels)
    assert not {reason.name for reason in failed} & {reason.name for reason in rest}, "one reason is enough"
    for reason in rest:
        assert reason.stage is RejectionStage.SELECTION and reason.others
        if reason.criterion is Criterion.OUTSCORED:
            best = max(scores, key=lambda score: score.evidence)
            assert (reason.others, reason.limit) == ((best.name,), best.evidence)
            assert reason.value is not None and reason.value <= best.evidence
        else:
            assert reason.criterion is Criterion.INDISTINGUISHABLE and reason.others == (scores[0].name,)


@given(LEVELS, st.sampled_from(RejectionStage))
def test_a_candidate_has_each_criterion_that_its_score_fails(
    levels: dict[str, tuple[float, float]], stage: RejectionStage
) -> None:
    scores = scores_of(levels)
    standing = {score.name for score in scores[:1] if score.is_accepted}
    reasons = rejected_reasons(scores, standing, stage, ("grade",))
    for score in scores:
        own = [reason for reason in reasons if reason.name == score.name]
        assert all((reason.stage, reason.beside) == (stage, ("grade",)) for reason in own)
        if score.is_accepted:
            assert [reason.criterion for reason in own] == [Criterion.OUTSCORED] * (score.name not in standing)
        else:
            assert [reason._replace(stage=None, beside=()) for reason in own] == list(failed_reasons(score))


def test_what_the_logs_lack_is_a_reason_by_quantity() -> None:
    lacking = Excitation(0.1, False, (Shortage("brakings", 1.0, 6.0), Shortage("brake_moves", 2.0, 9.0)))
    reasons = excitation_reasons({"brake_fade": lacking, "grade": Excitation(2.0, True, ())})
    assert [(one.name, one.key, one.value, one.limit) for one in reasons] == [
        ("brake_fade", "brakings", 1.0, 6.0),
        ("brake_fade", "brake_moves", 2.0, 9.0),
    ]
    assert [reason_text(reason) for reason in reasons] == [shortage.text for shortage in lacking.shortages]
    assert "1 brakings" in reason_text(reasons[0]) and "6 are needed" in reason_text(reasons[0])


def test_all_effects_of_a_verdict_against_them_have_its_reason() -> None:
    steps = [weighed(**{name: spread(1.0)})[0] for name in ("steer_lag", "brake_gain")]
    left = Reason(Criterion.RESIDUAL_LEFT, "steer_lag", 0.4, 0.25, others=("brake_gain",), key="steer")
    (other,) = step_reasons(steps, (left,))
    assert other == left._replace(name="brake_gain", others=(), stage=RejectionStage.SELECTION)
    frames = Reason(Criterion.FRAMES_CHANGED, value=0.05, key="steer")
    assert [reason.name for reason in step_reasons(steps, (frames,))] == ["steer_lag", "brake_gain"]
    unexplained = Reason(Criterion.UNEXPLAINED, value=0.2, key="steer")
    assert step_reasons(steps, (unexplained,)) == (), "it says nothing of an effect"


NUMBERS = st.none() | st.floats(allow_nan=False, allow_infinity=False)
REASONS = st.builds(
    Reason,
    st.sampled_from(Criterion),
    st.sampled_from(NAMES),
    NUMBERS,
    NUMBERS,
    st.lists(st.sampled_from(NAMES)).map(tuple),
    st.sampled_from(("", "steer", "brakings")),
    stage=st.sampled_from(RejectionStage),
    beside=st.lists(st.sampled_from(NAMES)).map(tuple),
)


@given(REASONS)
def test_a_rejection_comes_back_from_its_entry(reason: Reason) -> None:
    entry = reason_entry(reason)
    assert reason_from_entry(entry) == reason
    assert {"name", "criterion", "stage"} <= set(entry) <= {
        "name", "criterion", "stage", "signal", "value", "limit", "beside", "others",
    }  # fmt: skip
    verdict = reason._replace(stage=None, beside=(), others=())
    assert "stage" not in reason_entry(verdict) and reason_from_entry(reason_entry(verdict)) == verdict


OF_CANDIDATES = tuple(criterion for criterion in Criterion if criterion in SCORE_TEXTS)


@pytest.mark.parametrize("criterion", OF_CANDIDATES)
@pytest.mark.parametrize("stage", RejectionStage)
def test_a_rejection_has_a_text_with_its_numbers_and_what_is_beside(
    criterion: Criterion, stage: RejectionStage
) -> None:
    reason = Reason(
        criterion, "steer_lag", 1.25, 6.5, ("payload",), "yaw_rate", stage=stage, beside=("grade", "friction")
    )
    text = candidate_text(reason)
    assert text.startswith(f"steer_lag {STAGE_TEXTS[stage]} beside grade and friction: ")
    assert "payload" in text if criterion is Criterion.INDISTINGUISHABLE else "1.25" in text and "6.5" in text
    assert "?" in candidate_text(reason._replace(value=None)) or criterion is Criterion.INDISTINGUISHABLE


def test_no_criterion_of_a_score_has_a_text_in_words() -> None:
    """`words` has the reasons of the verdict that have a text in TEXTS: a score's would come in."""
    of_scores = {reason.criterion for score in scores_of({"grade": (8.0, 1.3)}) for reason in failed_reasons(score)}
    assert of_scores and not of_scores & set(TEXTS) and of_scores <= set(SCORE_TEXTS)
    assert set(STAGE_TEXTS) == set(RejectionStage)
