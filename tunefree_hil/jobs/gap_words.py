"""What a `gap` came to in one sentence, and what to do next."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tunefree_hil.jobs.calibrate_words import benches_of

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec
    from tunefree_hil.jobs.gap import Asked


def sentence_of(answer: Mapping[str, Any]) -> str:
    """What is missing, its value with interval and unit, and how much of the gap it closes."""
    verdict = answer["verdict"]
    if verdict in ("one", "several"):
        return _missing(answer)
    if verdict == "set":
        *some, last = answer["set"]
        told = f"one of {', '.join(some)} and {last} is missing, and these logs do not tell which"
        return f"{told}; to tell them apart drive {answer['separate_by']}" if answer["separate_by"] else told
    if verdict == "none_missing":
        unseen = [name for name, one in answer["excitation"].items() if not one["enough"]]
        told = "nothing is missing beyond noise and recalibration" + _recalibrated(answer)
        return f"{told}; these logs could not have shown {_few(unseen)}" if unseen else told
    if verdict == "none_of_these":
        return f"something is missing that is none of the catalogue: {'; '.join(answer['words'])}{_place(answer)}"
    if verdict == "cannot_test":
        return f"these logs cannot tell: {'; '.join(answer['words'])}"
    return f"simulation and measurement part here: {answer['where']['card']}"


def value_words(effect: Mapping[str, Any]) -> str:
    """'tau_s 0.120 s (0.118 to 0.122)', its parameters one after the other."""
    return ", ".join(f"{key} {_value(one)}" for key, one in effect["params"].items())


def _value(one: Mapping[str, Any]) -> str:
    unit = "" if one["unit"] in ("", "1") else f" {one['unit']}"
    ends = [_rounded(one[end], one) if one[end] is not None else "?" for end in ("low", "high")]
    return f"{_rounded(one['value'], one)}{unit} ({ends[0]} to {ends[1]})"


def _rounded(value: float, one: Mapping[str, Any]) -> str:
    """With the decimals that half the interval has; three figures where there is none."""
    low, high = one["low"], one["high"]
    if low is None or high is None or not high > low:
        return f"{value:.3g}"
    decimals = max(0, min(8, math.ceil(-math.log10(0.5 * (high - low)))))
    return f"{value:.{decimals}f}"


def _missing(answer: Mapping[str, Any]) -> str:
    named = [f"{one['name']} ({value_words(one)})" for one in answer["effects"]]
    told = f"{named[0]} is missing" if len(named) == 1 else f"{', '.join(named[:-1])} and {named[-1]} are missing"
    worse, closed = answer.get("worse") or [], answer.get("explained_frac")
    if closed:
        told += f"; it closes {percent(closed)} of the gap that recalibration leaves"
    if worse:
        told += f"; no model is written, as it would make what was there worse, above all {worse[0]}"
    return told


def percent(share: Mapping[str, float | None]) -> str:
    """'97 % (94 to 99)'."""
    value, low, high = (share[key] for key in ("value", "low", "high"))
    ends = "" if low is None or high is None else f" ({100.0 * low:.0f} to {100.0 * high:.0f})"
    return f"{100.0 * (value or 0.0):.0f} %{ends}"


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


def command_of(asked: Asked, until: str = "", more: Sequence[str] = (), out: str = "") -> str:
    """The command that asks this again; with more logs and another folder where they are given."""
    words = ["tunefree-hil", "gap", *(str(log) for log in asked.logs), *more]
    words += ["--vehicle", asked.vehicle, "--model", asked.model, "--out", out or str(asked.out)]
    for log in asked.older:
        words += ["--older", str(log)]
    until = until or asked.until
    return " ".join(shlex.quote(word) for word in words) + (f" --until {until}" if until != "verify" else "")


def next_of(asked: Asked, answer: Mapping[str, Any], vehicle: VehicleSpec) -> list[str]:
    """Commands to go on with."""
    verdict, logs = answer["verdict"], " ".join(shlex.quote(str(log)) for log in asked.logs)
    folder = shlex.quote(asked.vehicle)
    if verdict is None:
        return [command_of(asked, "verify")]
    if verdict in ("set", "cannot_test"):
        return [command_of(asked, more=["NEXT.log"], out=f"{asked.out}-2")]
    if verdict == "none_of_these":
        return [f"tunefree-hil learn {logs} --vehicle {folder} --out {shlex.quote(str(asked.out))}-hybrid"]
    if verdict == "none_missing" and answer.get("recalibration"):
        return [f"tunefree-hil calibrate {logs} --vehicle {folder} --out {shlex.quote(asked.model)}-recalibrated"]
    if verdict in ("one", "several") and not answer["model"] and asked.until in ("locate", "name"):
        return [command_of(asked, "verify")]
    benches, model = benches_of(vehicle), answer["model"] or asked.model
    bench = benches[0] if benches else "BENCH"
    return [f"tunefree-hil drive {shlex.quote(bench)} --model {shlex.quote(model)}"]
