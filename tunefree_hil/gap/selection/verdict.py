"""From what a search found to what is said: a name, several, a set, nothing, or something that the catalogue lacks.

A name is answerable for the signals that it works on: where one of them is missed much as before, by moments or by what
anything could explain, where more is missed elsewhere than it explains, or where it would be another one in each block,
it was not that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from tunefree_hil.gap.diagnostics.residual_tests import Looked
from tunefree_hil.gap.estimation.candidates import class_of
from tunefree_hil.gap.estimation.evidence import LEAST_NATS
from tunefree_hil.gap.estimation.intervals import WAVERS, wavering
from tunefree_hil.gap.estimation.nuisance import DRIFT
from tunefree_hil.gap.measured.chain import Opened
from tunefree_hil.gap.measured.excitation import Excited
from tunefree_hil.gap.model.graph import effects
from tunefree_hil.gap.selection.baseline_misfit import NOTHING, Usual
from tunefree_hil.gap.selection.criteria import MOST_LEFT, Weighed
from tunefree_hil.gap.selection.equivalence import outdone
from tunefree_hil.gap.workers.worker import Modelled

Array = np.ndarray

# (key, by how much it is moved, in u) -> by target, what that moves of its signal, root mean square, as a share
Moved = Callable[[str, float], Mapping[str, float]]

SET_NATS = 3.0 * LEAST_NATS  # of a set of faint names, which no proof can bear out, as nobody is to be repaired
HARDLY = 0.5  # of what an effect needs to be seen: from a drive that holds less than that it is not named alone,
NEARLY = 0.7  # where another comes so near to its evidence: what stands on little is not told by a lead of a third

MOST_WAVERING = 0.25  # of what effects explain of a signal: what a parameter that is another one in each block moves


def verdict_of(
    first: list[Weighed], steps: list[Weighed], looked: Sequence[Looked], amiss: str, held: Mapping[str, Excited],
    lost: Sequence[str], unsteady: Mapping[str, float], usual: Usual = NOTHING,
) -> tuple[str, tuple[str, ...], tuple[str, ...]]:  # fmt: skip
    """(verdict, set, words). looked: before anything was found; amiss: why what was found is not it, in words;
    unsteady: gains that recalibration would have to move from block to block, by how many deviations. Of several
    effects one that has rivals makes a set of all of them.
    """
    if lost:
        return "none_of_these", (), tuple(lost)
    if not steps:
        beyond = _news(looked, usual)
        worst, doubtful = (beyond or looked)[0], first and first[0].counts and outdone(first)
        if doubtful:
            words = f"{first[0].name} would explain it, {doubtful} would explain more"
            return "none_of_these", (), (f"{words}, and fails a rule for names (docs/gap.md)",)
        if worst.broken and not beyond:
            return "none_of_these", (), (f"{worst.missed}, as usual with this model",)
        if worst.broken:
            return "none_of_these", (), (f"{worst.missed}, and no effect explains it",)
        if unsteady:
            key, by = max(unsteady.items(), key=lambda one: one[1])
            words = f"{key} would have to be recalibrated otherwise in each block, by {by:.1f} standard deviations"
            return "none_of_these", (), (f"{words}, and no effect explains that",)
        return "none_missing", (), ("nothing beyond noise and recalibration",)
    if amiss:
        best = ", ".join(step.name for step in steps)
        return "none_of_these", (), (f"{best} comes nearest, and {amiss}",)
    if not any(step.others for step in steps):
        lacking = [f"{one.name}: {what}" for one in steps for what in held[one.name].lacks]
        lacking += [f"{one.name}: no link is broken, and only a proof can bear it out" for one in steps if one.faint]
        return ("one" if len(steps) == 1 else "several"), (), tuple(lacking)
    names = dict.fromkeys(name for step in steps for name in (step.name, *step.others))
    if all(step.faint and step.evidence < SET_NATS for step in steps):
        words = f"{', '.join(names)} would each explain a part of what a model may miss"
        if missed := _news(looked, usual):
            return "none_of_these", (), (f"{words}; {missed[0].missed}, and none of them explains that",)
        return "none_missing", (), (f"{words}, and no link is broken",)
    return "set", tuple(names), tuple(_set_words(step, held[step.name]) for step in steps)


def _news(looked: Sequence[Looked], usual: Usual) -> list[Looked]:
    """The broken targets that are missed by more than usual, without what is usual in them, the worst first."""
    some = [usual.beyond(one) for one in looked if one.broken and not usual.as_usual(one)]
    return sorted(some, key=lambda one: -one.amount)


def not_it(
    looked: Sequence[Looked], still: Sequence[Looked], left: Mapping[str, float], worked: Mapping[str, float],
    usual: Usual = NOTHING,
) -> str:  # fmt: skip
    """Why effects that were found are not what is missing, in words; '' where nothing speaks against them.

    looked, still: targets without and with them in the model; left: by target, of what could be explained the part that
    still can be; worked: the targets that they explain, each by how much of its signal. There they have to explain what
    there is; and what is missed elsewhere must be less than what they explain. What this model misses as usual speaks
    against nobody.
    """
    was = {one.signal: one for one in looked}
    for one in still:
        if usual.as_usual(one):
            continue
        if one.signal not in worked:
            news = usual.beyond(one)
            if one.broken and not usual.was_there(one) and news.amount > max(worked.values(), default=0.0):
                return f"explains less than what is left elsewhere: {news.missed}"
        elif _is_as_wild(one, was[one.signal], usual):
            return f"still {usual.beyond(one).missed}"
        elif one.broken and one.share > one.visible and left[one.signal] > MOST_LEFT:
            return f"leaves {left[one.signal]:.0%} of what could be explained of {one.signal}"
    return ""


def still_words(still: Sequence[Looked], worked: Iterable[str], usual: Usual = NOTHING) -> tuple[str, ...]:
    """What is missed beside the effects that are named, on signals that these do not work on, in words: it is less than
    what they explain, and the user's to look at all the same.
    """
    some = [one for one in still if one.broken and one.signal not in worked]
    return tuple(
        f"{usual.beyond(one).missed} all the same, and nothing that is named here explains that"
        for one in some
        if not usual.was_there(one)
    )


def _is_as_wild(now: Looked, was: Looked, usual: Usual) -> bool:
    """Whether moments, or the whole whatever foretells it, are missed as before, and by more than usual."""
    loud, gross = usual.loud_from(now.signal), usual.gross_from(now.signal)
    return _stays(now.loud, was.loud, loud) or _stays(now.gross, was.gross, gross)


def _stays(now: float, was: float, bar: float) -> bool:
    """Whether much of what was missed (of a signal, by any road) is missed still."""
    return now > max(bar, MOST_LEFT * was)


def wavers(
    steps: Sequence[Weighed], repaired: Modelled, blocks: Array, drives: Array, still: Sequence[Looked],
    worked: Mapping[str, float], moved: Moved,
) -> str:  # fmt: skip
    """An effect whose parameter is another one from block to block, in words: a constant it is not. Where that moves no
    signal by more than a calibrated model may miss of it, and by little of what the effects explain there, it is the
    form of the effect that is not quite the car's. drives: of which drive each block is; still: targets with the
    effects in the model; worked: the targets that they explain, each by how much of its signal.
    """
    bar = {one.signal: max(one.visible, MOST_WAVERING * worked.get(one.signal, 0.0)) for one in still}
    for step in steps:
        found = wavering(repaired.fitted, step.name, blocks, drives)
        if found.share > WAVERS and any(by > bar[name] for name, by in moved(found.key, found.by).items()):
            return f"what it would be of {step.name} differs by {found.share:.0%} of itself from block to block"
    return ""


def daily_words(found: Mapping[str, float]) -> tuple[str, ...]:
    """What is of the day and differs between drives (interval.apart), in words."""
    return tuple(
        f"{key} differs by {by:.1f} standard deviations between the drives, and is one for all of them here: ask them "
        "one by one as well"
        for key, by in found.items()
    )


def small_words(found: Mapping[str, Mapping[str, float]]) -> tuple[str, ...]:
    """Of effects that were named, each with the values of its parameters, those that are no more than what changes from
    one day to the next (drifts.py, twice its deviation), in words.
    """
    some = [
        (name, DRIFT.get(f"{name}.{parameter}", 0.0), value - effects()[name].neutral[parameter])
        for name, params in found.items()
        for parameter, value in params.items()
    ]
    return tuple(
        f"{name}: so little of it may come and go from day to day" for name, by, off in some if abs(off) < 2.0 * by
    )


def _set_words(step: Weighed, held: Excited) -> str:
    """Of a step of a set: what it cannot be told from, and why."""
    if not step.others:
        return f"{step.name} beside them"
    why = f": {'; '.join(held.lacks)}" if held.lacks else ""
    return f"{step.name} explains these logs as well as {', '.join(step.others)}{why}"


def alike_words(names: Iterable[str], drives: Sequence[Opened]) -> tuple[str, ...]:
    """Of each effect that is named, alone or in a set, in words: who else would look just the same on this car
    (interfaces 4), and is not named beside it.
    """
    has_lateral, named = any(one.has("report.lateral_accel_mps2") for one in drives), list(names)
    same = {name: ", ".join(sorted(class_of(name, has_lateral) - set(named))) for name in named}
    return tuple(f"{name}: no log of this car tells it from {others}" for name, others in same.items() if others)


def with_others(
    step: Weighed, steps: Sequence[Weighed], held: Mapping[str, Excited], drives: Sequence[Opened]
) -> Weighed:
    """A step with the rivals that no class has together with it, of each class the best one. Where the drive hardly
    holds what shows it, what it is easily taken for is a rival, too, as far as that comes near to it in its place,
    beside the other steps.
    """
    has_lateral = any(one.has("report.lateral_accel_mps2") for one in drives)
    others = step.others
    if held[step.name].score < HARDLY:
        least = NEARLY * step.placed.get(step.name, step.evidence)
        near = [name for name in effects()[step.name].impostors if step.placed.get(name, 0.0) > max(least, LEAST_NATS)]
        others += tuple(name for name in near if name not in others)
    apart, stay = class_of(step.name, has_lateral) | {one.name for one in steps}, set[str]()
    for name in sorted(others, key=lambda one: -step.placed.get(one, 0.0)):
        if name not in apart:
            stay.add(name)
            apart |= class_of(name, has_lateral)
    return step._replace(others=tuple(name for name in others if name in stay))
