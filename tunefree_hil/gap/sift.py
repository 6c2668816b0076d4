"""What of a search's steps is news, and whether that is what is missing; the search again, without what is none."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.ask import Modelled, Question
from tunefree_hil.gap.decide import Weighed, left_share, worked_on
from tunefree_hil.gap.evidence import judged
from tunefree_hil.gap.hill import with_hill
from tunefree_hil.gap.leftover import Left
from tunefree_hil.gap.locate import Looked, look
from tunefree_hil.gap.search import backward, forward, settled
from tunefree_hil.gap.taken_back import taken_back
from tunefree_hil.gap.team import Team
from tunefree_hil.gap.usual import Usual, parted, seen_alone
from tunefree_hil.gap.verdict import not_it, wavers

Array = np.ndarray


class Seen(NamedTuple):
    """Of a model: what it leaves to be explained, by target; every target, the most broken first."""

    left: dict[str, Left]
    looked: list[Looked]


class Sifted(NamedTuple):
    """A search's steps that are news, in the model `repaired`, which leaves `after`; still: every target with all the
    steps in the model. amiss: why the news is not what is missing; words: why other steps are not named; old: which of
    them are no news; no_news: that, in words.
    """

    news: list[Weighed]
    repaired: Modelled
    after: Seen
    still: list[Looked]
    amiss: str
    words: tuple[str, ...]
    no_news: tuple[str, ...] = ()
    old: tuple[str, ...] = ()


def looked_at(team: Team, question: Question, model: Modelled, blocks: Array) -> Seen:
    """What a model leaves, and what is broken with it in place."""
    (left,), (bursts,) = (team.ask(what, [model.fitted], blocks) for what in ("left_by", "bursts_of"))
    return Seen(left, look(left, question.kinds, question.sizes, bursts))


def marked(question: Question, looked: Sequence[Looked], usual: Usual) -> Question:
    """The question with what recalibration alone leaves broken, and which of that is missed as usual."""
    broken = [one for one in looked if one.broken]
    as_usual = frozenset(one.signal for one in broken if usual.as_usual(one))
    return question._replace(broken=frozenset(one.signal for one in broken), usually=as_usual)


def searched(
    team: Team, question: Question, every: list[Weighed], before: Seen, usual: Usual
) -> Generator[str, None, tuple[list[Weighed], Sifted]]:
    """(suspects alone, what was found of them). every: all suspects alone; before: of the null. Who is no news is asked
    no more, and the others once again, without it: what the own logs had as well is to hide nobody who came later.
    """
    old, words, blocks = set[str](), tuple[str, ...](), judged(question.blocks)
    while True:
        asked = question._replace(suspects=tuple(one for one in question.suspects if one.name not in old))
        first = [one for one in every if one.name not in old]
        steps = yield from forward(team, asked, first, blocks)
        stay = yield from backward(team, asked, steps, blocks)
        stay, first = yield from settled(team, asked, first, stay, blocks, fresh=len(stay) < len(steps))
        yield "what is left"
        found = _sifted(team, asked, stay, first, before, usual)
        words += found.no_news
        if not found.old:
            return first, found._replace(no_news=words)
        old |= set(found.old)


def _sifted(
    team: Team, question: Question, steps: Sequence[Weighed], first: Sequence[Weighed], before: Seen, usual: Usual
) -> Sifted:
    """What of a search's steps is news, and whether that is it. before: of the null."""
    model, blocks = team.setting.model, judged(question.blocks)
    repaired = steps[-1].model if steps else question.null
    after = looked_at(team, question, repaired, blocks) if steps else before
    still = after.looked
    explained = any(one.broken for one in before.looked) and not any(one.broken for one in still)
    news, no_news = parted(steps, repaired.fitted, usual, blocks, explained=explained)
    old = tuple(one.name for one in steps if one not in news)
    news, hidden = seen_alone(news, steps, first)
    news = with_hill(news, repaired.fitted, usual, model)
    amiss = _amiss(team, question, repaired, news, before, after, usual) if news else ""
    if len(news) < len(steps):
        repaired = _without(team, question, repaired, steps, news)
        after = looked_at(team, question, repaired, blocks)
    news, undone = taken_back(news, first, repaired.fitted, model, blocks)
    return Sifted(news, repaired, after, still, amiss, (*undone, *hidden), no_news, old)


def _amiss(
    team: Team, question: Question, repaired: Modelled, steps: Sequence[Weighed], before: Seen, after: Seen,
    usual: Usual,
) -> str:  # fmt: skip
    """Why what was found is not what is missing, in words; '' where nothing speaks against it. before: of the null;
    after: of the model with all that was found, of which `steps` are to be named.
    """
    blocks = judged(question.blocks)
    worked = worked_on(question.null, repaired, question.sizes, blocks)
    left = {name: left_share(before.left[name], one) for name, one in after.left.items()}

    def moved(key: str, by: float) -> dict[str, float]:
        found = team.ask("moved_by", repaired.fitted, key, by)
        return {target: rms / question.sizes[target] for target, rms in found.items()}

    days = question.blocks.drives[blocks]
    return not_it(before.looked, after.looked, left, worked, usual) or wavers(
        steps, repaired, blocks, days, after.looked, worked, moved
    )


def _without(
    team: Team, question: Question, model: Modelled, steps: Sequence[Weighed], stay: Sequence[Weighed]
) -> Modelled:
    """A model without those of its steps that do not stay, the rest fitted on."""
    if not stay:
        return question.null
    stays = {step.name for step in stay}
    for step in steps:
        if step.name not in stays:
            model = team.fit_without(model, [step.name])[step.name]
    return model
