"""The search over effects: one, then further ones beside it, then each without the others, then others in its place.

Forward: the best effect that counts (decide.py) is added and all are asked again. Backward: one that does not count
beside the others is taken out again. Settled: each that stays is held against everybody else in its place, the others
staying; who explains as much there is its rival. A model that others are compared with is fitted on until nothing is
gained: what a search finds of the rest on its way would else be counted as the merit of whoever is asked next.

What of a search's steps is news, and whether that is what is missing; the search again, without what is none.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.diagnostics.lack_of_fit import Left
from tunefree_hil.gap.diagnostics.residual_tests import Looked, look
from tunefree_hil.gap.estimation.evidence import LEAST_NATS, judged, log_evidence, stretched, stretches
from tunefree_hil.gap.selection.baseline_misfit import Usual, parted, seen_alone
from tunefree_hil.gap.selection.confounding import taken_back, with_hill
from tunefree_hil.gap.selection.criteria import PLAIN_NATS, Weighed, left_share, weigh, worked_on
from tunefree_hil.gap.selection.equivalence import outdone, rivals
from tunefree_hil.gap.selection.verdict import not_it, wavers
from tunefree_hil.gap.workers.pool import Team
from tunefree_hil.gap.workers.worker import Modelled, Question

Array = np.ndarray

MOST_EFFECTS = 3
CONTENDERS = 4  # fitted on before they are compared: those whose evidence is nearest to the best
NEAR = 0.5  # of the best one's evidence
WITHIN = 0.8  # of it, once the best are fitted on: whoever is as near as that is fitted on too


def weighed(
    team: Team, question: Question, names: Sequence[str], start: Modelled | None, blocks: Array,
    known: Mapping[str, Modelled] | None = None,
) -> list[Weighed]:  # fmt: skip
    """Suspects beside `start` (None: the null), fitted and weighed; those that matter fitted on first. known: models
    that are weighed with them, fitted on already.
    """
    begin, known = question.null if start is None else start, known or {}
    found, done = {**team.fit(names, start), **known}, set(known)
    some = _fitted_on(team, question, found, begin, blocks, done)
    if some and some[0].evidence > PLAIN_NATS:
        left = [name for name in names if name in found and name not in done]
        found |= _fuller(found, team.fit(left, start, some[0].model), some[0].model, blocks)
        some = _fitted_on(team, question, found, begin, blocks, done)
    return some


def _fitted_on(
    team: Team, question: Question, found: dict[str, Modelled], begin: Modelled, blocks: Array, done: set[str]
) -> list[Weighed]:
    """All that were found, weighed, those that matter fitted on first: in `found`, and added to `done`."""
    some, share = _weigh(question, found, begin, blocks), WITHIN if done else NEAR
    while near := _near(some, share, done):
        found |= dict(zip(near, team.fit_on([found[name] for name in near]), strict=True))
        some = _weigh(question, found, begin, blocks)
        share = WITHIN
        done |= set(near)
    return some


def _fuller(
    found: Mapping[str, Modelled], again: Mapping[str, Modelled], best: Modelled, blocks: Array
) -> dict[str, Modelled]:
    """Of those asked again the ones that explain more than they did, by the noise that the best leaves. By that of a
    start that lacks a constant force no grid tells who takes it away: its rows all say the same, as one, and a coarse
    grid's first point is as good as any.
    """
    by = stretches(best.fitted)
    worth = {
        name: [log_evidence(stretched(one.fitted, by), blocks) for one in (found[name], other)]
        for name, other in again.items()
    }
    return {name: again[name] for name, (was, now) in worth.items() if now > was}


def _weigh(question: Question, models: Mapping[str, Modelled], start: Modelled, blocks: Array) -> list[Weighed]:
    return weigh(models, start, question.null, question.sizes, blocks, question.broken, question.usually)


def _near(some: Sequence[Weighed], share: float, done: set[str]) -> list[str]:
    """The next ones that are to be fitted on: who matters and has so much of the best one's evidence; the best one in
    any case: whose search took one step only (team.py) is a little off still, and what that leaves in every row alike
    passes for noise, in which nothing has evidence.
    """
    worth = sorted((one for one in some if one.matters), key=lambda one: -one.evidence)
    if not worth:
        return []
    least = max(share * worth[0].evidence, LEAST_NATS)
    left = [one.name for one in worth if (one is worth[0] or one.evidence > least) and one.name not in done]
    return left[:CONTENDERS]


def forward(team: Team, question: Question, first: list[Weighed], blocks: Array) -> Generator[str, None, list[Weighed]]:
    """Effects one after the other, each beside those before it, refitted with them."""
    lead = _lead(first)
    if lead is None:
        return []
    steps = [lead]
    while len(steps) < MOST_EFFECTS:
        names = [one.name for one in question.suspects if one.name not in {step.name for step in steps}]
        yield f"beside {', '.join(step.name for step in steps)}"
        more = weighed(team, question, names, steps[-1].model, blocks)
        if not more or not more[0].counts or outdone(more):
            break
        again = _against_the_rest(team, question, more[0], more[0].name, blocks)
        if not again.counts:
            break
        steps.append(again._replace(others=tuple(rivals(more, blocks)), placed=_evidences(more)))
    return steps if lead.counts or len(steps) > 1 else []


def _lead(first: Sequence[Weighed]) -> Weighed | None:
    """Who is asked for others beside it: the best that counts. Where somebody has more evidence, or nobody counts, the
    one with the most, if nothing but what it spoils speaks against it: a late INS and a gyro that is filtered hide each
    other, and are found together or not at all (backward: each has to count beside the other).
    """
    if not first:
        return None
    if first[0].counts and not outdone(first):
        return first[0]
    most = max(first, key=lambda one: one.evidence)
    return most if most.spoils else None


def _against_the_rest(team: Team, question: Question, step: Weighed, name: str, blocks: Array) -> Weighed:
    """A step, weighed against its own model without one of its effects, the rest fitted on from there.

    What a search finds of the rest on its way is no merit of the effect: a limit that no drive touches stays without.
    """
    rest = team.fit_without(step.model, [name])[name]
    return _weigh(question, {step.name: step.model}, rest, blocks)[0]


def backward(
    team: Team, question: Question, steps: list[Weighed], blocks: Array
) -> Generator[str, None, list[Weighed]]:
    """Take out effects that no longer count beside those found later. Where one was, what is known of rivals is not
    known any more.
    """
    if len(steps) < 2:
        return steps
    yield "each without the others"
    last, stay = steps[-1].model, steps
    for name in [step.name for step in steps]:
        if len(stay) == 1 or (name == steps[-1].name and len(stay) == len(steps)):  # the newest counts beside all
            break
        rest = team.fit_without(last, [name])[name]
        if not _weigh(question, {name: last}, rest, blocks)[0].counts:
            last, stay = rest, [step for step in stay if step.name != name]
    return [*stay[:-1], stay[-1]._replace(model=last)]


def settled(
    team: Team, question: Question, first: list[Weighed], steps: list[Weighed], blocks: Array, fresh: bool = False
) -> Generator[str, None, tuple[list[Weighed], list[Weighed]]]:
    """(steps, each with the names that explain as much in its place; all suspects alone, weighed with the one step).

    fresh: whether one was taken out, so that the newest has to be asked for its rivals again. A single effect that was
    found beside another is weighed among all suspects alone, with the values that it has now; who is best there is it.
    """
    if not steps:
        return [], first
    if len(steps) == 1:
        if first[0].name != steps[0].name:
            models = {one.name: one.model for one in first} | {steps[0].name: steps[0].model}
            first = _weigh(question, models, question.null, blocks)
        if not first[0].counts or outdone(first):
            return [], first
        return [first[0]._replace(others=tuple(rivals(first, blocks)), placed=_evidences(first))], first
    found, last = [], steps[-1].model
    for step in steps if fresh else steps[:-1]:
        yield f"each without the others, and any in the place of {step.name}"
        found.append(_in_its_place(team, question, steps, step, blocks))
    found += steps[len(found) :]
    return [*found[:-1], found[-1]._replace(model=last)], first


def _in_its_place(team: Team, question: Question, steps: list[Weighed], step: Weighed, blocks: Array) -> Weighed:
    """A step of several weighed against all suspects that are not among them, beside the rest of the steps."""
    last = steps[-1].model
    rest = team.fit_without(last, [step.name])[step.name]
    names = [one.name for one in question.suspects if one.name not in {one.name for one in steps}]
    some = weighed(team, question, names, rest, blocks, {step.name: last})
    own = next(one for one in some if one.name == step.name)
    equal = [some[0].name, *rivals(some, blocks)] if some[0].counts else []
    return own._replace(others=tuple(name for name in equal if name != step.name), placed=_evidences(some))


def _evidences(some: Sequence[Weighed]) -> dict[str, float]:
    return {one.name: one.evidence for one in some}


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
