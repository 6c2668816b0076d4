"""An answer as data, in the words of `gap.json` (interfaces 9): what a name, a place and a doubt are called there.

`signals`, `explained_frac`, `absorbed`, `model`, `figures` belong to whoever repairs and verifies; they are not here.
"""

from __future__ import annotations

import math
from typing import Any

from tunefree_hil.gap.name import Effect, Named

REGIONS = 3  # that are told, of those that stand out


def as_data(found: Named) -> dict[str, Any]:
    """Plain dicts, lists, numbers and words; what is no finite number is None."""
    return {
        "verdict": found.verdict,
        "effects": [_effect(one) for one in found.effects],
        "set": list(found.set),
        "separate_by": found.separate_by,
        "where": _where(found),
        "excitation": {
            name: {"score": _number(one.score), "enough": one.enough, "lacks": list(one.lacks)}
            for name, one in found.excitation.items()
        },
        "links": [
            {
                "link": one.link.value, "signal": one.signal, "unit": one.unit, "rms": one.rms, "noise": one.noise,
                "explicable": one.explicable, "share": one.share, "broken": one.broken,
            }
            for one in found.looked
        ],
        "lost": {link.value: words for link, words in found.lost.items()},
        "not_suspected": dict(found.question.cannot),
        "candidates": [
            {
                "name": one.name, "evidence": _number(one.evidence),
                "held_out": [_number(one.gain.total), _number(one.gain.low)],
                "shrink": [_number(value) for value in one.shrink], "signal": one.target, "counts": one.counts,
            }
            for one in found.candidates
        ],
        "words": list(found.words),
    }  # fmt: skip


def _effect(one: Effect) -> dict[str, Any]:
    params = {key: {**value._asdict(), **_ends(value.low, value.high)} for key, value in one.params.items()}
    return {"name": one.name, "params": params, "evidence": _number(one.evidence)}


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
