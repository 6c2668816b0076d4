"""Who did it: recalibration, every suspect with the same freedom, more than one if need be, and the doubt about it all.

    opened = list of drives (chain.py)
    found = yield from name(model, vehicle, opened)

Two processes share the suspects (team.py, search.py). The verdict is one of VERDICTS; whatever it is, the numbers
behind it come with it.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Link, links_of
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ModelSpec, VehicleSpec
from tunefree_hil.gap.ask import Modelled, Question
from tunefree_hil.gap.chain import Opened
from tunefree_hil.gap.clock import Echo, echoes
from tunefree_hil.gap.decide import MOST_LEFT, Weighed, left_share, outdone, rivals
from tunefree_hil.gap.evidence import judged
from tunefree_hil.gap.excitation import Excited, excitation, held_by
from tunefree_hil.gap.graph import effects
from tunefree_hil.gap.leftover import Left
from tunefree_hil.gap.locate import Card, Looked, card, echo_words, look
from tunefree_hil.gap.search import backward, forward, weighed
from tunefree_hil.gap.segments import FEWEST, blocks_of
from tunefree_hil.gap.suspects import class_of
from tunefree_hil.gap.targets import LEAST_MPS
from tunefree_hil.gap.team import Team
from tunefree_hil.gap.work import Setting

Array = np.ndarray

VERDICTS = ("one", "several", "set", "none_missing", "none_of_these", "cannot_test")
QUANTILE = 1.96


class Value(NamedTuple):
    """A parameter of an effect with its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str


class Effect(NamedTuple):
    """An effect that is said to be missing. evidence: nats over the model without it."""

    name: str
    params: dict[str, Value]
    evidence: float


class Named(NamedTuple):
    """The answer. candidates: all first-round suspects weighed, best first; null: recalibration alone; repaired: the
    model with the effects in it (the null where there are none). before, after: what each leaves to be explained.

    looked: every target with recalibration done; card: of the one that shows it best (None: no link is broken), with
    the link that is to blame. echoes: of the commands. set: names where it is one of them, and not known which. lost:
    links that the logs cannot show, in words.
    """

    verdict: str
    effects: tuple[Effect, ...]
    set: tuple[str, ...]
    separate_by: str
    link: Link | None
    card: Card | None
    looked: tuple[Looked, ...]
    echoes: tuple[Echo, ...]
    excitation: dict[str, Excited]
    candidates: tuple[Weighed, ...]
    question: Question
    repaired: Modelled
    before: dict[str, Left]
    after: dict[str, Left]
    lost: dict[Link, str]
    words: tuple[str, ...]


def name(
    model: ModelSpec, vehicle: VehicleSpec, drives: Sequence[Opened], workers: int = 2
) -> Generator[str, None, Named]:
    """Find who it was; yields what is being done. Raises InputError for logs in which nothing can be compared."""
    refuse_untold(drives)
    team = Team(Setting(model, vehicle, tuple(drives)), workers)
    try:
        yield "recalibration alone"
        question = team.open()
        return (yield from _named(team, question, vehicle, drives))
    finally:
        team.close()


def refuse_untold(drives: Sequence[Opened]) -> None:
    """Raises InputError for logs that are too short, and for a car that stands: its few moving rows would be all that
    is fitted to.
    """
    count = blocks_of([one.ticks for one in drives], drives[0].dt_s).count
    if count < FEWEST:
        raise InputError(
            f"the logs hold {count} blocks of 8 s; {FEWEST} are needed to fit, to choose and to prove",
            code="too_short",
            key="LOG",
            hint="record a minute and a half or more",
        )
    driven = sum(_driven(one) for one in drives)
    if driven < FEWEST:
        raise InputError(
            f"the car moves above walking pace in {driven} stretches of 8 s; {FEWEST} are needed",
            code="standing",
            key="LOG",
            hint="drive for a minute and a half or more, in gear, with the by-wire unit obeying",
        )


def _driven(one: Opened) -> int:
    """Blocks of a drive in which the car drives most of the time."""
    blocks, moves = blocks_of([one.ticks], one.dt_s), one.moving & (one.inputs.speed_mps > LEAST_MPS)
    return sum(bool(moves[begin:end].mean() > 0.5) for begin, end in zip(blocks.begins, blocks.ends, strict=True))


def _named(
    team: Team, question: Question, vehicle: VehicleSpec, drives: Sequence[Opened]
) -> Generator[str, None, Named]:
    blocks = judged(question.blocks)
    yield f"{len(question.suspects)} suspects"
    first = weighed(team, question, [one.name for one in question.suspects], None, blocks)
    steps = yield from forward(team, question, first, blocks)
    steps = yield from backward(team, question, steps, blocks)
    repaired = steps[-1].model if steps else question.null
    yield "what is left"
    before, after = team.ask("left_by", [question.null.fitted, repaired.fitted], blocks)
    said = tuple(one for opened in drives for one in echoes(opened))
    looked = look(before, question.kinds, question.sizes)
    still = look(after, question.kinds, question.sizes)
    share = left_share(before, after)
    verdict, others, words = _verdict(first, steps, looked, still, share, blocks, drives, echo_words(said))
    link, shown = _where(team, question, steps, looked, said)
    known = tuple(_effect(step, repaired) for step in steps) if verdict in ("one", "several") else ()
    held = excitation(effects(), held_by(drives, vehicle))
    return Named(
        verdict, known, others, _manoeuvre(others), link, shown, tuple(looked), said, held, tuple(first), question,
        repaired, before, after, lost_links(drives), words,
    )  # fmt: skip


def _verdict(
    first: list[Weighed], steps: list[Weighed], looked: Sequence[Looked], still: Sequence[Looked], share: float,
    blocks: Array, drives: Sequence[Opened], lost: Sequence[str],
) -> tuple[str, tuple[str, ...], tuple[str, ...]]:  # fmt: skip
    """(verdict, set, words). looked, still: before and after what was found; share: of what could be explained, what
    still can be.
    """
    if lost:
        return "none_of_these", (), tuple(lost)
    if not steps:
        worst, doubtful = looked[0], first and first[0].counts and outdone(first)
        if doubtful:
            words = f"{first[0].name} would explain it, {doubtful} would explain more, and spoils other signals"
            return "none_of_these", (), (words,)
        if worst.broken:
            return "none_of_these", (), (f"{worst.signal} is missed by {worst.share:.1%}, and no effect explains it",)
        return "none_missing", (), ("nothing beyond noise and recalibration",)
    if share > MOST_LEFT and any(one.broken for one in still):
        best = ", ".join(step.name for step in steps)
        return "none_of_these", (), (f"{best} comes nearest and leaves {share:.0%} of what could be explained",)
    if len(steps) > 1:
        return "several", (), ()
    same = class_of(steps[0].name, all(one.has("report.lateral_accel_mps2") for one in drives))
    others = [one for one in rivals(first, blocks) if one not in same]
    if others:
        return "set", (steps[0].name, *others), ("these explain the logs equally well",)
    return "one", (), ()


def _effect(step: Weighed, repaired: Modelled) -> Effect:
    """An effect with the values that the whole repaired model has for it."""
    model = repaired.fitted
    curve = np.zeros((len(model.keys), len(model.keys)))
    for one in model.sums.values():
        at = one.columns
        curve[np.ix_(at, at)] += one.curve.sum(axis=0) / one.colour.stretch
    prior = np.array([0.0 if key in {f.key for f in model.free} else 1.0 for key in model.keys])
    deviation = np.sqrt(np.maximum(np.diag(np.linalg.pinv(curve + np.diag(prior + 1e-9), hermitian=True)), 0.0))
    catalogue, params = effects(), {}
    for one in model.free:
        owner, _, parameter = one.key.partition(".")
        if owner == step.name:
            i = model.keys.index(one.key)
            ends = [one.value(float(model.z[i] + sign * QUANTILE * deviation[i])) for sign in (-1.0, 1.0)]
            unit = catalogue[owner].units[parameter]
            params[parameter] = Value(model.values[one.key], min(ends), max(ends), unit)
    return Effect(step.name, params, step.evidence)


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


def lost_links(drives: Sequence[Opened]) -> dict[Link, str]:
    """Links that none of the drives shows."""
    shared = set(drives[0].lost)
    for one in drives[1:]:
        shared &= set(one.lost)
    return {link: drives[0].lost[link] for link in shared}
