"""What a model misses as usual: of the very logs that it was made from, where nothing in the catalogue explains it all.

Most models come near their own logs, and whatever a later log shows is news. A model of a shaking car of 2 kg does not,
and each later log is missed as its own were: that is no reason to doubt a name, and an effect that has the value there
that its own logs gave it, is nothing that came later. `calibrate` asks a model's own logs once, and its card keeps it.
What explains them is kept as well (gap/selection/confounding.py).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.gap.diagnostics.residual_tests import GROSS, LOUD, Looked
from tunefree_hil.gap.estimation.evidence import LEAST_NATS
from tunefree_hil.gap.estimation.intervals import across
from tunefree_hil.gap.estimation.least_squares import Fitted
from tunefree_hil.gap.model.card import card_of
from tunefree_hil.gap.model.graph import effects
from tunefree_hil.gap.selection.criteria import Weighed
from tunefree_hil.learn.model_folder import OWN_EFFECTS

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec

Array = np.ndarray

KEY = "usual"  # of card.json
RESTLESS, OWN_MISSED = "restless", "own_missed"  # of it as well
KINDS = ("loud", "gross", "share")  # of what is missed of a signal
PEDALS = ("throttle_gain.gain_frac", "brake_gain.gain_frac")  # the same force along the car shows in either
TIMES = 2.0  # as much missed as usual is as usual: another drive shakes more, or less
HAD = 2.0  # deviations from neutral: what the own logs of a model that misses them leave open is no news either
NEWS = 4.0  # deviations, of both values together, from which on a value is another one: they are those of a poor model

Known = tuple[float, float]  # (value, deviation), both in the parameter's unit


class Usual(NamedTuple):
    """missed: by target, as a share of its signal. effects: what the own logs make of each, alone, as far as they feel
    it. broken: the targets that are missed by more than a calibrated model may. own: effects that explain the own logs,
    where these leave nothing broken, with what they are there; own_missed: what is missed of the own logs without them.
    restless: gains that the own logs would move otherwise in each block, by how many deviations: the car's form is not
    quite the model's. loud, gross, share: as Looked has them, of the own logs, be they broken by that or just not; of a
    card that does not have the share, what was missed stands for it.
    """

    missed: Mapping[str, float]
    effects: Mapping[str, Mapping[str, Known]]
    broken: frozenset[str] = frozenset()
    own: Mapping[str, Mapping[str, Known]] = {}
    restless: Mapping[str, float] = {}
    own_missed: Mapping[str, float] = {}
    loud: Mapping[str, float] = {}
    gross: Mapping[str, float] = {}
    share: Mapping[str, float] = {}

    def more_restless(self, found: Mapping[str, float]) -> dict[str, float]:
        """Those that differ from block to block by more than usual."""
        usual = dict(self.restless)
        usual |= dict.fromkeys(PEDALS, max(usual.get(key, 0.0) for key in PEDALS))
        return {key: by for key, by in found.items() if by > TIMES * usual.get(key, 0.0)}

    def was_there(self, one: Looked) -> bool:
        """Whether no more is missed of a target than of the own logs, whatever explained it there: it speaks against
        nobody who is asked about something else.
        """
        unexplained = self.own_missed.get(one.signal, 0.0)
        return self.as_usual(one) or self.beyond(one).amount <= TIMES * unexplained

    def as_usual(self, one: Looked) -> bool:
        """Whether no more is missed of a target, as a share of its signal, than usual: of what could be explained, of
        its moments and of the whole, each by itself.
        """
        usual = self.share.get(one.signal, self.missed.get(one.signal, 0.0))
        return self.beyond(one).amount <= max(TIMES * usual, one.visible)

    def loud_from(self, target: str) -> float:
        """What moments of a target have to miss of its signal to be more than usual."""
        return max(LOUD, TIMES * self.loud.get(target, 0.0))

    def gross_from(self, target: str) -> float:
        """The same of the whole, whatever of it could be foretold."""
        return max(GROSS, TIMES * self.gross.get(target, 0.0))

    def beyond(self, one: Looked) -> Looked:
        """A target whose moments and whole say nothing where they are missed as usual: each is held against its own,
        and what could be explained against what could be there.
        """
        loud = one.loud if one.loud > self.loud_from(one.signal) else 0.0
        return one._replace(loud=loud, gross=one.gross if one.gross > self.gross_from(one.signal) else 0.0)


NOTHING = Usual({}, {})


def usual_of(model: ModelSpec) -> Usual:
    """What a model's card says; nothing is usual with a model that comes near its own logs, or was not asked.

    Raises InputError for a card that is none.
    """
    try:
        return usual_in(card_of(model))
    except (AttributeError, TypeError, KeyError, ValueError) as error:
        raise InputError(
            f"{KEY}: {error}",
            code="bad_card",
            file=str(Path(model.folder) / model.plant.card),
            key=KEY,
            hint="calibrate the model again",
        ) from error


def usual_in(card: Mapping[str, Any]) -> Usual:
    """The same of what a card says. Raises what reading a table raises for one that is none."""
    said, own = card.get(KEY) or {}, card.get(OWN_EFFECTS) or {}
    found, there = _numbers(said.get("effects", {})), _numbers(own)
    missed = {name: _finite(one) for name, one in said.get("missed", {}).items()}
    restless, own_missed = (
        {str(name): _finite(one) for name, one in (card.get(key) or {}).items()} for key in (RESTLESS, OWN_MISSED)
    )
    broken = frozenset(str(name) for name in said["broken"]) if said else frozenset[str]()
    loud, gross, share = ({name: _finite(one) for name, one in said.get(key, {}).items()} for key in KINDS)
    return Usual(missed, found, broken, there, restless, own_missed, loud, gross, share)


def as_data(usual: Usual) -> dict[str, Any]:
    """Keys of the card; none where there is nothing to keep."""
    said: dict[str, Any] = {OWN_EFFECTS: _as_numbers(usual.own)} if usual.own else {}
    some = {RESTLESS: usual.restless, OWN_MISSED: usual.own_missed}
    said |= {key: dict(one) for key, one in some.items() if one}
    if usual.missed:
        broken = sorted(usual.broken)
        said[KEY] = {"missed": dict(usual.missed), "broken": broken, "effects": _as_numbers(usual.effects)}
        said[KEY] |= {key: dict(one) for key, one in zip(KINDS, (usual.loud, usual.gross, usual.share), strict=True)}
    return said


def by_name(values: Mapping[str, Known]) -> dict[str, dict[str, Known]]:
    """'effect.parameter' -> by effect, by parameter."""
    found: dict[str, dict[str, Known]] = {}
    for key, known in values.items():
        name, _, parameter = key.partition(".")
        found.setdefault(name, {})[parameter] = known
    return found


def _as_numbers(some: Mapping[str, Mapping[str, Known]]) -> dict[str, Any]:
    return {
        name: {key: {"value": value, "deviation": by} for key, (value, by) in params.items()}
        for name, params in some.items()
        if all(math.isfinite(number) for known in params.values() for number in known)
    }


def _numbers(said: Mapping[str, Any]) -> dict[str, dict[str, Known]]:
    return {
        name: {key: (_finite(one["value"]), _finite(one["deviation"])) for key, one in params.items()}
        for name, params in said.items()
    }


def _finite(number: Any) -> float:
    found = float(number)
    if not math.isfinite(found):
        raise ValueError(f"{number} is no number to compare with")
    return found


def parted(
    steps: Sequence[Weighed], model: Fitted, usual: Usual, blocks: Array, *, explained: bool = False
) -> tuple[list[Weighed], tuple[str, ...]]:
    """(steps that are named, in words why others are not, or that they are no news). model: with all of them. A step
    that gains where the model came near its own logs is news, unless they plainly had as much of it: the same tyres
    that cornered less.

    explained: whether nothing is broken with all of them in the model. Then they are what it lacks, news or not, as
    they were if the own logs had shown them as clearly.
    """
    if not usual.broken:
        return list(steps), ()
    values, news, words = across(model, blocks), list[Weighed](), list[str]()
    for step in steps:
        asked = step.target in usual.broken or _had(step.name, usual)
        why = _no_news(step.name, values, usual) if asked else ""
        if why:
            words.append(f"{step.name} is no news: {why}")
        if explained or not why:
            news.append(step)
    return news, tuple(words)


def seen_alone(
    news: Sequence[Weighed], steps: Sequence[Weighed], first: Sequence[Weighed]
) -> tuple[list[Weighed], tuple[str, ...]]:
    """(news, or none of them, in words why): where some steps are no news, and nobody of the others gains anything
    without those. first: every suspect by itself. What is no news is not put into the model, and what shows only
    beside it shows nothing of the model as it is.
    """
    stays = {one.name for one in news}
    left_out = [one.name for one in steps if one.name not in stays]
    alone = {one.name: one.evidence for one in first}
    if not (news and left_out) or any(alone.get(one.name, math.inf) > LEAST_NATS for one in news):
        return list(news), ()
    names = " and ".join(left_out)
    return [], tuple(f"{one.name} shows only beside {names}, which is not put in" for one in news)


def _had(name: str, usual: Usual) -> bool:
    """Whether the own logs had an effect, as far as they tell: a parameter of it is off neutral. Of a limit, which
    changes nothing at infinity, no number of deviations says so.
    """
    neutral, known = effects()[name].neutral, usual.effects.get(name, {})
    told = {key: one for key, one in known.items() if math.isfinite(neutral[key])}
    return any(abs(value - neutral[key]) > HAD * by for key, (value, by) in told.items())


def _no_news(name: str, values: Mapping[str, Known], usual: Usual) -> str:
    """Why an effect with these values (of all keys) is nothing that came after the model; '' where it is."""
    said = []
    for key, (value, by) in values.items():
        owner, _, parameter = key.partition(".")
        if owner != name:
            continue
        known = usual.effects.get(name, {}).get(parameter)
        if known is None:
            return "the logs that the model was made from do not hold what would show it, and it misses those as well"
        was, doubt = known
        if abs(value - was) > NEWS * math.hypot(by, doubt):
            return ""
        said.append(f"{parameter} {value:.4g}, and {was:.4g} in the logs that the model was made from")
    return ", ".join(said)


def usual_words(usual: Usual) -> tuple[str, ...]:
    """That the model misses its own logs, in words."""
    if not usual.missed:
        return ()
    name, by = max(usual.missed.items(), key=lambda one: one[1])
    return (f"the model misses {name} by {by:.0%} of the signal in the very logs that it was made from",)
