"""The search again, without what is no news: on searches made by hand."""

from __future__ import annotations

from collections.abc import Generator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests.gap.selection.test_criteria import ALL, NULL, spread, weighed
from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.diagnostics.residual_tests import Looked
from tunefree_hil.gap.selection import search
from tunefree_hil.gap.selection.baseline_misfit import NOTHING
from tunefree_hil.gap.selection.criteria import Weighed
from tunefree_hil.gap.selection.search import Seen, Sifted, marked, searched
from tunefree_hil.gap.workers.worker import Question

NAMES = ("steer_backlash", "payload", "grade")


def question() -> Question:
    return Question(NULL, cast(Any, None), {}, {}, cast(Any, tuple(SimpleNamespace(name=name) for name in NAMES)), {})


def one_by_one(team: Any, asked: Question, first: list[Weighed], *_: Any) -> Generator[str, None, list[Weighed]]:
    """The best of those that are asked, and nobody else."""
    yield "searching"
    assert [one.name for one in first] == [one.name for one in asked.suspects]
    return first[:1]


def found(monkeypatch: pytest.MonkeyPatch, old: set[str]) -> tuple[list[str], list[str], Sifted]:
    """(what was told, names still asked at the end, what was found) where the steps in `old` are no news."""

    def sifted(team: Any, asked: Question, steps: list[Weighed], *_: Any) -> Sifted:
        gone = tuple(one.name for one in steps if one.name in old)
        news = [one for one in steps if one.name not in old]
        return Sifted(news, NULL, Seen({}, []), [], "", (), tuple(f"{name} is no news" for name in gone), gone)

    def settled(
        team: Any, asked: Question, first: list[Weighed], steps: list[Weighed], *_: Any, fresh: bool
    ) -> Generator[str, None, tuple[list[Weighed], list[Weighed]]]:
        yield "settling"
        return steps, first

    def kept(team: Any, asked: Question, steps: list[Weighed], *_: Any) -> Generator[str, None, list[Weighed]]:
        yield "each without the others"
        return steps

    for name, made in {"forward": one_by_one, "backward": kept, "settled": settled, "_sifted": sifted}.items():
        monkeypatch.setattr(search, name, made)
    monkeypatch.setattr(search, "judged", lambda _: ALL)
    every = [weighed(**{name: spread(1.0)})[0] for name in NAMES]
    stages, told = searched(cast(Any, None), question(), every, Seen({}, []), NOTHING), list[str]()
    while True:
        try:
            told.append(next(stages))
        except StopIteration as end:
            first, result = end.value
            return told, [one.name for one in first], result


def test_what_is_news_is_asked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    told, asked, result = found(monkeypatch, set())
    assert [one.name for one in result.news] == ["steer_backlash"] and asked == list(NAMES) and not result.no_news
    assert told.count("what is left") == 1


def test_what_is_no_news_hides_nobody_and_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    told, asked, result = found(monkeypatch, {"steer_backlash", "payload"})
    assert [one.name for one in result.news] == ["grade"] and asked == ["grade"]
    assert result.no_news == ("steer_backlash is no news", "payload is no news") and told.count("what is left") == 3


def test_a_search_ends_where_nothing_is_news(monkeypatch: pytest.MonkeyPatch) -> None:
    _, asked, result = found(monkeypatch, set(NAMES))
    assert not result.news and not asked and len(result.no_news) == len(NAMES)


def test_a_question_knows_what_is_broken_and_what_of_that_is_as_usual() -> None:
    looked = [Looked(name, Link.REPORT_TO_MOTION, "1", 0.2, 0.1, 0.2, 0.2, name != "c") for name in ("a", "b", "c")]
    one = marked(question(), looked, NOTHING._replace(missed={"a": 0.15, "b": 0.05, "c": 0.2}))
    assert one.broken == {"a", "b"} and one.usually == {"a"}
