"""What a `gap` came to in one sentence, and what to do next."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tunefree_hil.jobs.command_text import given, pasted
from tunefree_hil.jobs.learn.report_text import benches_of

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec
    from tunefree_hil.jobs.gap.gap import Asked

COMMAND = pasted("gap")
SHARE = ("value", "low", "high")
UNJUDGED = "No block of it can be driven, by commands that are obeyed: what the repair does to it is not known."
CLOSES_NOTHING = 0.01  # of the gap: no model is written for less
SHOWS = 0.02  # of an error or the gap: what is no more may be chance
STIRS = 0.05  # of an error's squares: blocks that an effect changes by less do not show it
MOST_SHARE = 10.0  # of a signal, that is told
MOST_MOVED = 3  # numbers that are told of


def sentence_of(answer: Mapping[str, Any]) -> str:
    """What is missing, its value with interval and unit, and how much of the gap it closes."""
    verdict = answer["verdict"]
    if verdict in ("one", "several"):
        return _missing(answer)
    if verdict == "set":
        told = f"{_one_of(answer)}, and these logs do not tell which"
        return f"{told}; to tell them apart drive {answer['separate_by']}" if answer["separate_by"] else told
    if verdict == "none_missing":
        lacking = [name for name, one in answer["excitation"].items() if not one["enough"]]
        unseen = list(dict.fromkeys([*answer["untold"], *lacking]))
        told = "nothing is missing beyond noise and recalibration" + _moved(answer) + _recalibrated(answer)
        told += f"; {answer['words'][0]}" if answer.get("taken_back") else ""
        return f"{told}; these logs could not have shown {_few(unseen)}" if unseen else told
    if verdict == "none_of_these" and answer.get("missed_in_proof"):
        return f"something is missing that the search could not see: {answer['words'][0]}"
    if verdict == "none_of_these" and _is_no_news(answer):
        told = "nothing shows above what this model misses of its own logs, and what is less does not show"
        return f"{told}: {'; '.join(answer['words'])}"
    if verdict == "none_of_these":
        return f"something is missing that is none of the catalogue: {'; '.join(answer['words'])}{_place(answer)}"
    if verdict == "cannot_test":
        return f"these logs cannot tell: {'; '.join(answer['words'])}"
    return f"simulation and measurement part here: {answer['where']['card']}"


def _is_no_news(answer: Mapping[str, Any]) -> bool:
    """Whether all that is missed is missed as usual, and nothing else speaks for something that came later."""
    broken = {one["signal"] for one in answer["links"] if one["broken"]}
    as_usual = answer["words"][0].endswith("as usual with this model")
    return as_usual and bool(broken) and broken <= set(answer["as_usual"])


def value_words(effect: Mapping[str, Any]) -> str:
    """'tau_s 0.120 s (0.118 to 0.122)', its parameters one after the other."""
    return ", ".join(f"{key} {_value(one)}" for key, one in effect["params"].items())


def _value(one: Mapping[str, Any]) -> str:
    unit = "" if one["unit"] in ("", "1") else f" {one['unit']}"
    if one["low"] is None and one["high"] is None:
        return f"{_rounded(one['value'], one)}{unit} (how surely is not known)"
    ends = [_rounded(one[end], one) if one[end] is not None else "?" for end in ("low", "high")]
    return f"{_rounded(one['value'], one)}{unit} ({ends[0]} to {ends[1]})"


def _rounded(value: float, one: Mapping[str, Any]) -> str:
    """With the decimals that half the interval has; three figures where there is none."""
    low, high = one["low"], one["high"]
    if low is None or high is None or not high > low:
        return f"{value:.3g}"
    decimals = max(0, min(8, math.ceil(-math.log10(0.5 * (high - low)))))
    return f"{round(value, decimals) + 0.0:.{decimals}f}"  # no -0


def _missing(answer: Mapping[str, Any]) -> str:
    named = [f"{one['name']} ({value_words(one)})" for one in answer["effects"]]
    told = f"{listed(named)} {'is' if len(named) == 1 else 'are'} missing"
    worse, closed = answer.get("worse") or [], answer.get("explained_frac")
    if waits_for_proof(answer):
        return f"{told}; the stretches that no fit has seen do not show it, and another drive has to prove the model"
    if is_unproved(answer) and not worse:
        return f"{told}; no model is written, as it closes nothing of the gap in the stretches that no fit has seen"
    if closed:
        told += f"; it closes {percent(closed)} of the gap that recalibration leaves"
    if worse:
        told += f"; no model is written, as it would make what was there worse, above all {worse[0]}"
    return told


def is_unproved(answer: Mapping[str, Any]) -> bool:
    """Whether a name stands, and its repair closes nothing where no fit has looked: another drive has to prove it."""
    closed = answer.get("explained_frac")
    return answer["verdict"] in ("one", "several") and bool(closed) and closed["value"] < CLOSES_NOTHING


def is_unshown(answer: Mapping[str, Any]) -> bool:
    """Whether the blocks that prove do not show any of the effects that were named: they say nothing about them."""
    stirs = [one.get("unseen_stirs") for one in answer["effects"]]
    return bool(stirs) and all(one is not None and one < STIRS for one in stirs)


def waits_for_proof(answer: Mapping[str, Any]) -> bool:
    """Whether there is a repaired model of which no block that proves has anything to say."""
    closed = answer.get("explained_frac")
    return bool(answer.get("model")) and is_unshown(answer) and not (closed and closed["value"] > SHOWS)


def missed_words(missed: Mapping[str, float]) -> str:
    """What the blocks that prove miss and no other, the worst first. missed: by signal, as a share of it."""
    told = listed(
        [f"{name} by {min(by, MOST_SHARE):.0%} of the signal" for name, by in list(missed.items())[:MOST_MOVED]]
    )
    return f"the stretches that are kept for the proof miss {told}, and the others no more than a model may"


def _one_of(answer: Mapping[str, Any]) -> str:
    """Of a set: 'one of a and b is missing', and of several effects at once what may stand in place of one of them."""
    together = answer.get("together") or []
    others = [name for name in answer["set"] if name not in together]
    if not together:
        return f"one of {listed(others)} is missing"
    instead = f"one of {listed(others)}" if len(others) > 1 else others[0]
    return f"{listed(together)} are missing together, or {instead} in place of one of them"


def listed(names: Sequence[str]) -> str:
    """'a, b and c'."""
    *some, last = names
    return f"{', '.join(some)} and {last}" if some else last


def _moved(answer: Mapping[str, Any]) -> str:
    """What recalibration had to move by more than a calibrated model may be off."""
    moved = answer.get("moved") or []
    more = f" and {len(moved) - 1} more" if len(moved) > 1 else ""
    return f"; but {moved[0]}{more}, which may as well be something missing" if moved else ""


def remarks(answer: Mapping[str, Any]) -> list[str]:
    """What is to be known beside the sentence: why it is a set, what the drive lacked, what recalibration moved."""
    verdict, moved = answer["verdict"], answer.get("moved") or []
    words = [] if verdict in ("none_of_these", "cannot_test", "none_missing") else answer["words"]
    if len(moved) > MOST_MOVED:
        moved = [
            *moved[:MOST_MOVED],
            f"recalibration moves others about as far: {len(moved) - MOST_MOVED} (`moved` in gap.json)",
        ]
    return [*words, *([] if verdict == "none_missing" and len(moved) == 1 else moved)]  # what the sentence does not say


def percent(share: Mapping[str, float | None]) -> str:
    """'97 % (94 to 99)'."""
    value, low, high = (None if share[key] is None else round(100.0 * (share[key] or 0.0)) for key in SHARE)
    return f"{value or 0} %" + ("" if low is None or high is None else f" ({low} to {high})")


def _recalibrated(answer: Mapping[str, Any]) -> str:
    """What `calibrate` would gain, in the signal that gains most."""
    gained = answer.get("recalibration")
    if not gained:
        return ""
    name, one = min(gained.items(), key=lambda pair: pair[1]["recalibrated"] / pair[1]["before"])
    ends = f"from {one['before']:.3g} to {one['recalibrated']:.3g} {answer['signals'][name]['unit']}"
    return f"; `calibrate` on these logs would take the error of {name} {ends}"


def _few(names: Sequence[str], most: int = 4) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _place(answer: Mapping[str, Any]) -> str:
    card = answer["where"]["card"]
    return f" (where: {card})" if card else ""


def again(asked: Asked, until: str = "", more: Sequence[str] = (), out: str = "") -> str:
    """The command that asks this again; with more logs and another folder where they are given."""
    wish = asked._replace(until=until or asked.until, out=out or asked.out)
    return pasted("gap", *asked.logs, *more, **given(wish, leave=["logs"]))


def next_of(asked: Asked, answer: Mapping[str, Any], vehicle: VehicleSpec, bench: str = "") -> list[str]:
    """Commands to go on with. bench: a bench file that is known to be the vehicle's."""
    verdict, logs, folder = answer["verdict"], asked.logs, asked.vehicle
    if verdict is None:
        return [again(asked, "verify")]
    waits = is_unproved(answer) or waits_for_proof(answer) or bool(answer.get("missed_in_proof"))
    if verdict in ("set", "cannot_test") or waits:
        return [again(asked, more=["NEXT.log"], out=f"{asked.out}-2")]
    if verdict == "none_of_these":
        return [pasted("learn", *logs, vehicle=folder, out=f"{asked.out}-hybrid")]
    if verdict == "none_missing" and answer.get("recalibration"):
        return [pasted("calibrate", *logs, vehicle=folder, out=f"{asked.model}-recalibrated")]
    if verdict in ("one", "several") and answer["until"] != "verify":
        return [again(asked, "verify")]
    model = answer["model"] or asked.model
    bench = bench or next(iter(benches_of(vehicle)), "BENCH")
    return [pasted("drive", bench, model=model)]
