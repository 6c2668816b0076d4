"""An answer as data, in the words of `gap.json` (interfaces 9): what a name, a place and a doubt are called there.

`signals`, `explained_frac`, `model`, `figures` belong to whoever repairs and verifies; they are not here.

What a search came to, as it is kept between sessions: the answer, both models' values, and how it looked.

Repair, proof, page and pictures are made of this and the logs alone, so that a run that was cut off after the search
goes on without it, and comes to the same numbers: floats survive JSON bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.gap.diagnostics.residual_tests import Looked, Region, Shape
from tunefree_hil.gap.estimation.evidence import judged
from tunefree_hil.gap.estimation.intervals import held_back
from tunefree_hil.gap.measured.excitation import Excited
from tunefree_hil.gap.measured.observability import untold
from tunefree_hil.gap.model.graph import effects
from tunefree_hil.gap.pipeline import Effect, Named
from tunefree_hil.gap.selection.criteria import Weighed
from tunefree_hil.gap.workers.worker import Modelled
from tunefree_hil.learn.model_folder import plain

FEW_BLOCKS = 9  # judged, of a drive of a minute and three quarters; shorter ones have fewer
BY_TEST = ("one", "several", "set", "none_missing")  # verdicts that hold as far as nothing else was seen
NOWHERE: dict[str, Any] = {"link": None, "signal": "", "regime": [], "card": ""}  # where nothing is missed
REGIONS = 3  # that are told, of those that stand out
WITHOUT_NET = ("physics", "reference")  # kinds of plants that were not taught by logs, and so hide nothing


def as_data(found: Named, kind: str = "physics") -> dict[str, Any]:
    """Plain dicts, lists, numbers and words; what is no finite number is None. kind: of the model's plant."""
    blind = {**found.unmoved, **untold(effects(), found.lost, found.silent)}
    return {
        "verdict": found.verdict or None,
        "forced": forced_name(found),
        "absorbed": is_absorbed(found.verdict, kind),
        "effects": [_effect(one) for one in found.effects],
        "set": list(found.set),
        "together": together(found),
        "separate_by": found.separate_by,
        "where": _where(found),
        "excitation": {name: _excited(one, blind.get(name, "")) for name, one in found.excitation.items()},
        "links": [_link(one) for one in found.looked],
        "as_usual": [one.signal for one in found.looked if one.broken and found.usual.as_usual(one)],
        "untold": blind,
        "lost": {link.value: words for link, words in found.lost.items()},
        "not_suspected": dict(found.question.cannot),
        "candidates": [_candidate(one) for one in found.candidates],
        "words": [*found.words, *_short_words(found), *dict.fromkeys(found.silent.values())],
        "moved": list(moved_words(found)),
    }


def _excited(one: Excited, blind: str) -> dict[str, Any]:
    """Whether the logs hold what shows an effect. blind: why they cannot show it anyhow; '' where they can."""
    lacks = [*one.lacks, blind] if blind else list(one.lacks)
    return {"score": _number(one.score), "enough": one.enough and not blind, "lacks": lacks}


def _link(one: Looked) -> dict[str, Any]:
    return {
        "link": one.link.value, "signal": one.signal, "unit": one.unit, "rms": one.rms, "noise": one.noise,
        "explicable": one.explicable, "share": one.share, "broken": one.broken,
    }  # fmt: skip


def _candidate(one: Weighed) -> dict[str, Any]:
    return {
        "name": one.name, "evidence": _number(one.evidence),
        "held_out": [_number(one.gain.total), _number(one.gain.low)],
        "shrink": [_number(value) for value in one.shrink], "signal": one.target, "counts": one.counts,
    }  # fmt: skip


def _short_words(found: Named) -> tuple[str, ...]:
    """That so few blocks were judged by that much could be missing and not be seen; nothing where nobody says so."""
    count = len(judged(found.question.blocks))
    if count >= FEW_BLOCKS or found.verdict not in BY_TEST:
        return ()
    return (f"judged by {count} stretches alone: what else may be missing is hardly seen in so short a recording",)


def together(found: Named) -> list[str]:
    """Of a set that stands for several effects at once: those that fit best; the set's other names are rivals of one of
    them. Empty where the set is one effect's.
    """
    fitted = dict.fromkeys(key.partition(".")[0] for key in (one.key for one in found.repaired.fitted.free))
    heads = [name for name in fitted if name in found.set]
    return heads if found.verdict == "set" and len(heads) > 1 else []


def moved_words(found: Named) -> tuple[str, ...]:
    """What recalibration would move further than a calibrated model may be off, in words: it may as well be missing."""
    return tuple(one.words for one in held_back(found.repaired.fitted, judged(found.question.blocks)))


def forced_name(found: Named) -> str | None:
    """Who it would be if somebody had to be named; None where nobody was suspected."""
    if found.effects:
        return found.effects[0].name
    return max(found.candidates, key=lambda one: one.evidence).name if found.candidates else None


def is_absorbed(verdict: str, kind: str) -> bool:
    """Whether a learned plant may hide what is not found: its net may have been taught by logs that had it."""
    return kind not in WITHOUT_NET and verdict in ("none_missing", "none_of_these")


def _effect(one: Effect) -> dict[str, Any]:
    params = {key: {**value._asdict(), **_ends(value.low, value.high)} for key, value in one.params.items()}
    seen = {"shrink": one.own.seen, "unseen_shrink": one.own.unseen, "unseen_stirs": one.own.stirs}
    numbers = {key: _number(value) for key, value in {"evidence": one.evidence, **seen}.items()}
    return {"name": one.name, "params": params, "faint": one.faint, **numbers}


def _ends(low: float, high: float) -> dict[str, float | None]:
    return {"low": _number(low), "high": _number(high)}


def _where(found: Named) -> dict[str, Any]:
    card = found.card
    regime = [] if card is None else [one.words for one in card.regions if one.stands_out][:REGIONS]
    return {
        "link": None if found.link is None else found.link.value,
        "signal": "" if card is None else card.looked.signal,
        "regime": regime,
        "card": "" if card is None else card.words,
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


SCHEMA = "tunefree.gap_search/3"


class Kept(NamedTuple):
    """answer: as in gap.json (result.py); null, repaired: values by key as gap/model/graph.py takes them, of recalibration
    alone and with the effects. free: the keys that belong to effects found. regions, shape: of the target that shows it
    best, `signal` ('' where nothing is broken and nobody was found). seconds: that the search took. named: whether
    names were looked for. foretold: by target, of what the model with the effects still misses, the share that
    something foretells.
    """

    answer: dict[str, Any]
    null: dict[str, float]
    repaired: dict[str, float]
    free: tuple[str, ...]
    signal: str
    regions: tuple[Region, ...]
    shape: Shape | None
    seconds: float
    named: bool = True
    foretold: dict[str, float] = {}  # noqa: RUF012 - never mutated

    @property
    def verdict(self) -> str | None:
        """One of gap/pipeline.py's VERDICTS; None where nobody was to be named."""
        return self.answer["verdict"]

    @property
    def names(self) -> list[str]:
        """Of the effects that were found."""
        return [one["name"] for one in self.answer["effects"]]


def keep(found: Named, kind: str, seconds: float, named: bool = True) -> Kept:
    """Of a search's result. kind: of the model's plant; named: whether names were looked for."""
    card, answer = found.card, as_data(found, kind)
    if answer["verdict"] == "none_missing" and not any(one["enough"] for one in answer["excitation"].values()):
        answer |= {"verdict": "cannot_test", "absorbed": False, "words": [_lacking(answer)]}  # nothing could be seen
    return Kept(
        answer, _values(found.question.null), _values(found.repaired),
        tuple(one.key for one in found.repaired.fitted.free), "" if card is None else card.looked.signal,
        () if card is None else card.regions, None if card is None else card.shape, seconds, named,
        {name: min(max(one.explained / one.total, 0.0), 1.0) for name, one in found.after.items() if one.total > 0.0},
    )  # fmt: skip


def as_json(kept: Kept) -> dict[str, Any]:
    """Plain data."""
    return {"schema": SCHEMA, **plain(kept._asdict())}


def from_json(data: Mapping[str, Any]) -> Kept:
    """The same again. Raises ValueError for what no `as_json` wrote, by this version."""
    if data.get("schema") != SCHEMA:
        raise ValueError(f"schema is {data.get('schema')!r}, expected {SCHEMA!r}")
    try:
        fields = {name: data[name] for name in Kept._fields}
        shape = fields["shape"]
        return Kept(**fields)._replace(
            free=tuple(fields["free"]),
            regions=tuple(Region(**one) for one in fields["regions"]),
            shape=None if shape is None else Shape(**shape),
        )
    except (KeyError, TypeError) as error:
        raise ValueError(f"no whole search: {error}") from error


def _values(model: Modelled) -> dict[str, float]:
    return {key: float(value) for key, value in model.fitted.values.items()}


def _lacking(answer: Mapping[str, Any]) -> str:
    """What to record, where no effect could have been seen."""
    lacks = sorted({words for one in answer["excitation"].values() for words in one["lacks"]})
    return f"no effect of the catalogue could have shown itself; record a drive with more: {'; '.join(lacks)}"
