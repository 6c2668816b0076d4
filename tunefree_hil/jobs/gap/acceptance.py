"""Whether blocks that no fit has seen bear out what was named, and what is said where they do not.

closes, everywhere: the share of the gap that the repair closes there (value, low, high of 95 %), None where there is no
gap, or no block.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tunefree_hil.gap.result import NOWHERE, is_absorbed
from tunefree_hil.gap.selection.criteria import PLAIN_NATS
from tunefree_hil.gap.validation.gap_closed import LEAST_OPEN
from tunefree_hil.jobs.gap.report_text import SHOWS, STIRS, is_unshown, listed, percent

LEAST_CLOSED = 2.0 / 3.0  # of the gap: who surely leaves a third of it stands in for something else
SPEAKS_FOR = 0.3  # of the gap, surely closed: what a name needs that nothing else speaks for
# Of its own signal's error, there: who takes off that much and surely closes something is plain, however few rows that
# hang together say it. Asked only of a model that misses its own logs, whose own misses hold the rest of the gap open.
MOSTLY = 0.8
AGAIN = 0.5  # of what an effect takes off its own signal's error, on the blocks that prove: it is there as well


def is_borne_out(answer: Mapping[str, Any], closes: Mapping[str, float] | None) -> bool:
    """Whether blocks that no fit has seen bear out what was named: the repair closes the gap there, or, of a plain name
    (by its evidence), its own signal says so there.
    """
    return closes_it(answer, closes) or (closes is not None and _is_there_too(answer, closes))


def closes_it(answer: Mapping[str, Any], closes: Mapping[str, float] | None) -> bool:
    """Whether the repair closes something of the gap there, and as far as those blocks can tell most of it. Where no
    link is broken, so that nothing but the name says that anything is missing, none of them may speak against it (those
    that do not show the effect say nothing); a name that is faint even there (gap/selection/criteria.py) they have to speak for.
    """
    faint = any(one.get("faint") for one in answer["effects"])
    if closes is None:
        return not faint
    if closes["high"] < LEAST_CLOSED:
        return False
    if faint:
        return closes["low"] > SPEAKS_FOR
    broken = any(one["broken"] for one in answer["links"])
    return closes["value"] > 0.0 and (broken or closes["low"] > -LEAST_OPEN)


def _is_there_too(answer: Mapping[str, Any], closes: Mapping[str, float]) -> bool:
    """Whether plain effects do on the blocks that prove what they do elsewhere, each to the signal that shows it best,
    where the whole car's free run may be the better for it; or whether those blocks do not show them at all.

    A free run of a whole car sums up all that a model misses: a few blocks of it may not tell, or one that goes astray
    for another reason, what is plain from row to row. One of a model that misses its own logs tells nothing: there the
    effects have to show themselves on their own signals, and may do so by that alone.
    """
    told = [[one.get(key) for key in ("shrink", "unseen_shrink", "unseen_stirs")] for one in answer["effects"]]
    poor = bool(answer.get("as_usual")) and closes["low"] > SHOWS
    plain = all(
        (one.get("evidence") or 0.0) > PLAIN_NATS
        or (poor and not one.get("faint") and (one.get("unseen_shrink") or 0.0) > MOSTLY)
        for one in answer["effects"]
    )
    if not plain or any(one is None for some in told for one in some):
        return False
    if any(there < -SHOWS for _, there, _ in told):
        return False
    if answer.get("as_usual"):
        return all(there > max(AGAIN * here, SHOWS) for here, there, _ in told)
    if is_unshown(answer) or max(abs(one) for one in closes.values()) < SHOWS:
        return abs(closes["value"]) < SHOWS and closes["low"] > -SPEAKS_FOR
    return closes["high"] > LEAST_OPEN and all(
        there > max(AGAIN * here, SHOWS) or stirs < STIRS for here, there, stirs in told
    )


def taken_back(answer: Mapping[str, Any], closes: Mapping[str, float] | None, kind: str) -> dict[str, Any]:
    """Keys of gap.json where the proof does not bear out what was found: it was chance, or stood in for something else,
    and is not named. kind: of the model's plant.
    """
    names = [one["name"] for one in answer["effects"]]
    shrinks = [[one.get("shrink"), one.get("unseen_shrink")] for one in answer["effects"]]
    words = f"{listed(names)} came nearest, and {_share_of(closes)} of the gap in stretches that no fit has seen"
    broken = any(one["broken"] for one in answer["links"])
    verdict = "none_of_these" if broken else "none_missing"
    return {
        **({} if broken else {"where": NOWHERE}),
        "verdict": verdict,
        "absorbed": is_absorbed(verdict, kind),
        "effects": [],
        "words": [words],
        "changes": [],
        "taken_back": {"names": names, "explained_frac": closes and dict(closes), "shrinks": shrinks},
        "explained_frac": None,
        "explicable_frac": None,
        "worse": [],
    }


def _share_of(closes: Mapping[str, float] | None) -> str:
    if closes is None:
        return "nothing could be seen"
    if closes["value"] <= 0.0:
        return "closed nothing"
    why = "leaves a third and more" if closes["high"] < LEAST_CLOSED else "is not sure to be any"
    return f"closed {percent(closes)}, which {why},"
