"""The search over effects: one, then further ones beside it, then each without the others.

Forward: the best effect that counts (decide.py) is added and all are asked again. Backward: one that does not count
beside the others is taken out again. A model that others are compared with is fitted on until nothing is gained: what a
search finds of the rest on its way would else be counted as the merit of whoever is asked next.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence

import numpy as np

from tunefree_hil.gap.ask import Modelled, Question
from tunefree_hil.gap.decide import Weighed, outdone, weigh
from tunefree_hil.gap.evidence import LEAST_NATS
from tunefree_hil.gap.team import Team

Array = np.ndarray

MOST_EFFECTS = 3
CONTENDERS = 4  # fitted on before they are compared: those whose evidence is nearest to the best
NEAR = 0.5  # of the best one's evidence


def weighed(
    team: Team, question: Question, names: Sequence[str], start: Modelled | None, blocks: Array
) -> list[Weighed]:
    """Suspects beside `start` (None: the null), fitted and weighed; those that matter fitted on first."""
    begin = question.null if start is None else start
    found = team.fit(names, start)
    some = weigh(found, begin, question.null, question.sizes, blocks)
    worth = [one for one in some if one.matters]
    best = max((one.evidence for one in worth), default=0.0)
    near = sorted((one for one in worth if one.evidence > NEAR * best), key=lambda one: -one.evidence)[:CONTENDERS]
    if best <= LEAST_NATS:
        return some
    found |= dict(zip([one.name for one in near], team.fit_on([found[one.name] for one in near]), strict=True))
    return weigh(found, begin, question.null, question.sizes, blocks)


def forward(team: Team, question: Question, first: list[Weighed], blocks: Array) -> Generator[str, None, list[Weighed]]:
    """Effects one after the other, each beside those before it, refitted with them."""
    if not first or not first[0].counts or outdone(first):
        return []
    steps = [first[0]]
    while len(steps) < MOST_EFFECTS:
        names = [one.name for one in question.suspects if one.name not in {step.name for step in steps}]
        yield f"beside {', '.join(step.name for step in steps)}"
        more = weighed(team, question, names, steps[-1].model, blocks)
        if not more or not more[0].counts or outdone(more):
            break
        again = _against_the_rest(team, question, more[0], more[0].name, blocks)
        if not again.counts:
            break
        steps.append(again)
    return steps


def _against_the_rest(team: Team, question: Question, step: Weighed, name: str, blocks: Array) -> Weighed:
    """A step, weighed against its own model without one of its effects, the rest fitted on from there.

    What a search finds of the rest on its way is no merit of the effect: a limit that no drive touches stays without.
    """
    rest = team.fit_without(step.model, [name])[name]
    return weigh({step.name: step.model}, rest, question.null, question.sizes, blocks)[0]


def backward(
    team: Team, question: Question, steps: list[Weighed], blocks: Array
) -> Generator[str, None, list[Weighed]]:
    """Take out effects that no longer count beside those found later."""
    if len(steps) < 2:
        return steps
    yield "each without the others"
    last = steps[-1].model
    for name in [step.name for step in steps[:-1]]:
        rest = team.fit_without(last, [name])[name]
        if not weigh({name: last}, rest, question.null, question.sizes, blocks)[0].counts:
            last, steps = rest, [step for step in steps if step.name != name]
    return [*steps[:-1], steps[-1]._replace(model=last)]
