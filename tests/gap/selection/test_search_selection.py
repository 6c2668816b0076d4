"""The search again, without what is no news: on searches made by hand."""

from __future__ import annotations

from collections.abc import Callable, Generator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests.gap.selection.test_criteria import ALL, NULL, spread, weighed
from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.diagnostics.residual_tests import LinkResidual
from tunefree_hil.gap.progress import SearchProgress, SearchStage
from tunefree_hil.gap.selection import search
from tunefree_hil.gap.selection.baseline_misfit import NO_BASELINE
from tunefree_hil.gap.selection.criteria import CandidateScore
from tunefree_hil.gap.selection.model_misfit import ModelMisfit, SearchContext, mark_broken_targets
from tunefree_hil.gap.selection.reasons import Criterion, Reason, RejectionStage
from tunefree_hil.gap.selection.rejection import SelectionOutcome
from tunefree_hil.gap.selection.search import SelectedSteps, SettledSteps, select_effects
from tunefree_hil.gap.workers.worker import OpenProblem

NAMES = ("steer_backlash", "payload", "grade")


def question() -> OpenProblem:
    return OpenProblem(
        NULL, cast(Any, None), {}, {}, cast(Any, tuple(SimpleNamespace(name=name) for name in NAMES)), {}
    )


def one_by_one(context: SearchContext, first: list[CandidateScore]) -> Generator[SearchProgress, None, SelectedSteps]:
    """The best of those that are asked, and nobody else."""
    yield SearchProgress(SearchStage.ELIMINATION, "searching")
    assert [one.name for one in first] == [one.name for one in context.problem.candidates]
    return SelectedSteps(first[:1], tuple(rejection(RejectionStage.FORWARD, one.name) for one in first[1:]))


def rejection(stage: RejectionStage, name: str = "") -> Reason:
    return Reason(Criterion.EVIDENCE, name, 1.0, 6.0, stage=stage)


def known(name: str) -> Reason:
    return Reason(Criterion.KNOWN_TO_CALIBRATION, name)


def found(monkeypatch: pytest.MonkeyPatch, old: set[str]) -> tuple[list[SearchStage], list[str], SelectionOutcome]:
    """(stages, names still asked at the end, what was found) where the steps in `old` are not new."""

    def rejected(context: SearchContext, steps: list[CandidateScore], *_: Any) -> SelectionOutcome:
        gone = tuple(step.name for step in steps if step.name in old)
        new = [step for step in steps if step.name not in old]
        reasons = tuple(known(name) for name in gone)
        return SelectionOutcome(new, NULL, ModelMisfit({}, []), [], None, (), reasons, gone)

    def settled(
        context: SearchContext, first: list[CandidateScore], steps: list[CandidateScore], shortened: bool
    ) -> Generator[SearchProgress, None, SettledSteps]:
        yield SearchProgress(SearchStage.ELIMINATION, "settling")
        return SettledSteps(steps, first, (rejection(RejectionStage.SETTLING),))

    def unchanged(
        context: SearchContext, steps: list[CandidateScore]
    ) -> Generator[SearchProgress, None, SelectedSteps]:
        yield SearchProgress(SearchStage.ELIMINATION, "each effect without the others")
        return SelectedSteps(steps, (rejection(RejectionStage.BACKWARD),))

    replacements: dict[str, Callable[..., Any]] = {
        "search_forward": one_by_one,
        "search_backward": unchanged,
        "settle_steps": settled,
        "reject_effects": rejected,
    }
    for name, made in replacements.items():
        monkeypatch.setattr(search, name, made)
    every = [weighed(**{name: spread(1.0)})[0] for name in NAMES]
    context = SearchContext(cast(Any, None), question(), ALL)
    steps = select_effects(context, every, ModelMisfit({}, []), NO_BASELINE)
    stages = list[SearchStage]()
    while True:
        try:
            stages.append(next(steps).stage)
        except StopIteration as end:
            first, result = end.value
            return stages, [one.name for one in first], result


def test_what_is_news_is_asked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    told, asked, result = found(monkeypatch, set())
    assert [one.name for one in result.new_effects] == ["steer_backlash"] and asked == list(NAMES) and not result.known
    assert told.count(SearchStage.REMAINDER) == 1


def test_what_is_no_news_hides_nobody_and_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    told, asked, result = found(monkeypatch, {"steer_backlash", "payload"})
    assert [one.name for one in result.new_effects] == ["grade"] and asked == ["grade"]
    assert result.known == (known("steer_backlash"), known("payload")) and told.count(SearchStage.REMAINDER) == 3


def test_the_rejections_of_the_last_round_come_with_the_outcome(monkeypatch: pytest.MonkeyPatch) -> None:
    _, _, result = found(monkeypatch, {"steer_backlash"})
    stages = [(reason.name, reason.stage) for reason in result.rejected_candidates]
    assert stages == [
        ("grade", RejectionStage.FORWARD), ("", RejectionStage.BACKWARD), ("", RejectionStage.SETTLING),
    ], "the first round had rejected payload and grade, and the last round searched both again"  # fmt: skip


def test_a_search_ends_where_nothing_is_news(monkeypatch: pytest.MonkeyPatch) -> None:
    _, asked, result = found(monkeypatch, set(NAMES))
    assert not result.new_effects and not asked and len(result.known) == len(NAMES)


def test_a_question_knows_what_is_broken_and_what_of_that_is_as_usual() -> None:
    looked = [
        LinkResidual(name, Link.REPORT_TO_MOTION, "1", 0.2, 0.1, 0.2, 0.2, name != "c") for name in ("a", "b", "c")
    ]
    one = mark_broken_targets(question(), looked, NO_BASELINE._replace(misfit={"a": 0.15, "b": 0.05, "c": 0.2}))
    assert one.broken_targets == {"a", "b"} and one.targets_within_baseline == {"a"}
