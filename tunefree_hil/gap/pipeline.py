"""Who did it: recalibration, every suspect with the same freedom, more than one if need be, and the doubt about it all.

    opened = list of drives (chain.py)
    found = yield from name(model, vehicle, opened)

Processes share the suspects (team.py, search.py). The verdict is one of VERDICTS; whatever it is, the numbers
behind it come with it.

Where simulation and measurement part, and no more: recalibration, every link by itself, a card; nobody is named.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Link, Port, links_of
from tunefree_hil.config.schema import ModelSpec, VehicleSpec
from tunefree_hil.gap.diagnostics.lack_of_fit import Left
from tunefree_hil.gap.diagnostics.residual_tests import Card, Looked, card, echo_words
from tunefree_hil.gap.estimation.evidence import judged
from tunefree_hil.gap.estimation.intervals import Value, apart, unsteady, values_of
from tunefree_hil.gap.estimation.residuals import Setting
from tunefree_hil.gap.measured.chain import Opened
from tunefree_hil.gap.measured.clock import Echo, echoes
from tunefree_hil.gap.measured.excitation import Excited, excitation, held_by, refuse_untold
from tunefree_hil.gap.measured.observability import lost_links, silent_ports
from tunefree_hil.gap.model.graph import effects
from tunefree_hil.gap.selection.baseline_misfit import NOTHING, Usual, usual_of, usual_words
from tunefree_hil.gap.selection.criteria import MATTERS, Weighed, worked_on
from tunefree_hil.gap.selection.search import Sifted, looked_at, marked, searched, weighed
from tunefree_hil.gap.selection.verdict import (
    alike_words,
    daily_words,
    small_words,
    still_words,
    verdict_of,
    with_others,
)
from tunefree_hil.gap.validation.holdout_effect import NOT_LOOKED, Own, own
from tunefree_hil.gap.workers.pool import Team
from tunefree_hil.gap.workers.worker import Modelled, Question

Array = np.ndarray

NO_PORT: Mapping[Port, str] = {}
NOBODY: Mapping[str, str] = {}
UNMOVED = f"no value of it that a car has moves anything that is compared here by {MATTERS:.1%} of its signal"
VERDICTS = ("one", "several", "set", "none_missing", "none_of_these", "cannot_test")


class Effect(NamedTuple):
    """An effect that is said to be missing. evidence: nats over the model without it. faint: only if proved. own: what
    it does to the target that shows it best; on the blocks that prove that is nobody's business before the proof.
    """

    name: str
    params: dict[str, Value]
    evidence: float
    faint: bool = False
    own: Own = NOT_LOOKED


class Named(NamedTuple):
    """The answer. candidates: all first-round suspects weighed, best first; repaired: the model with the effects in it
    (the question's null where there are none). before, after: what either leaves to be explained.

    looked, still: every target with recalibration done, and with all that was found besides; card: of the one that
    shows it best (None: nothing is broken and nobody was found), with the link that is to blame. set: names where it is
    one of them, and not known which. lost, silent: links and ports that the logs cannot show, in words; unmoved: the
    same of effects of which no value moves anything that is compared. usual: what the model misses of its own logs.
    """

    verdict: str
    effects: tuple[Effect, ...]
    set: tuple[str, ...]
    separate_by: str
    link: Link | None
    card: Card | None
    looked: tuple[Looked, ...]
    excitation: dict[str, Excited]
    candidates: tuple[Weighed, ...]
    question: Question
    repaired: Modelled
    before: dict[str, Left]
    after: dict[str, Left]
    lost: dict[Link, str]
    words: tuple[str, ...]
    still: tuple[Looked, ...] = ()
    usual: Usual = NOTHING
    silent: Mapping[Port, str] = NO_PORT
    unmoved: Mapping[str, str] = NOBODY


def name(
    model: ModelSpec, vehicle: VehicleSpec, drives: Sequence[Opened], workers: int = 2
) -> Generator[str, None, Named]:
    """Find who it was; yields what is being done. Raises InputError for logs in which nothing can be compared."""
    refuse_untold(drives)
    usual_of(model)  # a card that is none is said before anybody waits for a search
    team = Team(Setting(model, vehicle, tuple(drives)), workers)
    try:
        yield "recalibration alone"
        question = team.open()
        return (yield from _named(team, question, vehicle, drives))
    finally:
        team.close()


def _named(
    team: Team, question: Question, vehicle: VehicleSpec, drives: Sequence[Opened]
) -> Generator[str, None, Named]:
    blocks, usual = judged(question.blocks), usual_of(team.setting.model)
    before = looked_at(team, question, question.null, blocks)
    question = marked(question, before.looked, usual)
    yield f"{len(question.suspects)} suspects"
    every = weighed(team, question, [one.name for one in question.suspects], None, blocks)
    question = question._replace(cannot={**question.cannot, **team.dropped})
    first, found = yield from searched(team, question, every, before, usual)
    held = excitation(effects(), held_by(drives, vehicle))
    steps = [with_others(step, found.news, held, drives) for step in found.news]
    said, days = tuple(one for opened in drives for one in echoes(opened)), question.blocks.drives[blocks]
    restless = usual.more_restless(restless_of(question))
    verdict, others, words = verdict_of(
        first, steps, before.looked, found.amiss, held, echo_words(said), restless, usual
    )  # fmt: skip
    link, shown = _where(team, question, steps, before.looked, said)
    known: tuple[Effect, ...] = ()
    if verdict in ("one", "several"):
        known = _effects(team, question, steps, found.repaired)
        words = (*words, *_beside_words(question, known, found, usual))
    words = (*words, *alike_words([one.name for one in known] or others, drives), *found.words, *found.no_news)
    words = (*words, *usual_words(usual), *daily_words(apart(found.repaired.fitted, blocks, days)))
    said_of = {*(one.name for one in known), *others}
    return Named(
        verdict, known, others, _manoeuvre(others), link, shown, tuple(before.looked), held, tuple(every), question,
        found.repaired, before.left, found.after.left, lost_links(drives), words, tuple(found.still), usual,
        silent_ports(drives),
        {name: UNMOVED for name, by in team.moves.items() if by < MATTERS and name not in said_of},
    )  # fmt: skip


def _beside_words(question: Question, known: Sequence[Effect], found: Sifted, usual: Usual) -> tuple[str, ...]:
    """Of effects that are named: how small they are, and what is missed beside them."""
    sizes = {one.name: {key: value.value for key, value in one.params.items()} for one in known}
    worked = worked_on(question.null, found.repaired, question.sizes, judged(question.blocks))
    return (*small_words(sizes), *still_words(found.after.looked, worked, usual))


def restless_of(question: Question) -> dict[str, float]:
    """What recalibration alone would have to move otherwise in each block (interval.unsteady)."""
    blocks = judged(question.blocks)
    sigmas = {free.key: free.doubt for one in question.suspects for free in one.free if free.doubt}
    return unsteady(question.null.fitted, blocks, question.blocks.drives[blocks], sigmas)


def _effects(team: Team, question: Question, steps: Sequence[Weighed], repaired: Modelled) -> tuple[Effect, ...]:
    """What was found, each effect held against the model without it."""
    blocks, null = judged(question.blocks), question.null
    proof = np.setdiff1d(np.arange(question.blocks.count), blocks)
    is_one = len({free.key.partition(".")[0] for free in repaired.fitted.free}) == 1  # some may not be said
    without = {steps[0].name: null} if is_one else team.fit_without(repaired, [one.name for one in steps])
    return tuple(
        Effect(
            one.name, values_of(one.name, repaired.fitted, blocks), one.evidence, one.faint,
            own(without[one.name], repaired, null, one.target, blocks, proof),
        )
        for one in steps
    )  # fmt: skip


def _where(
    team: Team, question: Question, steps: list[Weighed], looked: Sequence[Looked], said: Sequence[Echo]
) -> tuple[Link | None, Card | None]:
    """(the link to blame, the card of the target that shows it best), of the model without any effect."""
    lost = any(one.broken for one in said)
    if not steps and not looked[0].broken:
        return (Link.COMMAND_ECHO if lost else None), None
    target = steps[0].target if steps else looked[0].signal
    found, shape = team.ask("seen_of", question.null.fitted, target)
    here = next(one for one in looked if one.signal == target)
    link = links_of(effects()[steps[0].name])[0] if steps else here.link
    return (Link.COMMAND_ECHO if lost else link), card(here, shape, found, question.sizes[target])


def _manoeuvre(names: Iterable[str]) -> str:
    """What would tell the names of a set apart: the first one's own manoeuvre."""
    catalogue = effects()
    some = [catalogue[one].manoeuvre for one in names if one in catalogue and catalogue[one].manoeuvre]
    return some[0] if some else ""


NOBODY_ASKED = ""  # the verdict where links are broken and no name was looked for


def look_first(model: ModelSpec, vehicle: VehicleSpec, drives: Sequence[Opened]) -> Generator[str, None, Named]:
    """The part of `name` before any suspect is asked; `repaired` is the null. Raises as `name` does."""
    refuse_untold(drives)
    team = Team(Setting(model, vehicle, tuple(drives)), workers=1)
    try:
        yield "recalibration alone"
        question = team.open()
        yield "every link by itself"
        left, looked = looked_at(team, question, question.null, judged(question.blocks))
        said = tuple(one for opened in drives for one in echoes(opened))
        strange = echo_words(said)
        shown: Card | None = None
        if looked[0].broken:
            regions, shape = team.ask("seen_of", question.null.fitted, looked[0].signal)
            shown = card(looked[0], shape, regions, question.sizes[looked[0].signal])
    finally:
        team.close()
    link = Link.COMMAND_ECHO if strange else looked[0].link if shown else None
    held = excitation(effects(), held_by(drives, vehicle))
    words = tuple(strange) or (() if shown else ("nothing beyond noise and recalibration",))
    return Named(
        _verdict(looked, strange), (), (), "", link, shown, tuple(looked), held, (), question, question.null,
        left, left, lost_links(drives), words, silent=silent_ports(drives),
    )  # fmt: skip


def _verdict(looked: Sequence[Looked], strange: Sequence[str]) -> str:
    if strange:
        return "none_of_these"
    return NOBODY_ASKED if looked[0].broken else "none_missing"
