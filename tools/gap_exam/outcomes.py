"""What one answer is worth against one truth. Outcomes exclude each other; every log has exactly one.

right: the effects, and only they ('none_missing' where nothing is hidden, 'none_of_these' outside the catalogue; of a
recording as it is either: what a real car lacks nobody knows, and no name is what is asked for). A model that was
learned from logs with the effect and took it in: 'none_missing', with `absorbed`.
in_set: a set with the truth in it (of two effects: with a true one in it). partial: of two effects one, and nothing
false. silent: 'none_missing' or 'none_of_these' on a log with an effect ('none_of_these' where nothing is hidden,
'none_missing' outside the catalogue). wrong: any false name. cannot_test: it says so. failed: no answer at all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from tools.gap_exam.catalogue import EFFECTS, OUTSIDE, departure, kind_of, links_of, same_class

OUTCOMES = ("right", "in_set", "partial", "silent", "wrong", "cannot_test", "failed")
VERDICTS = ("one", "several", "set", "none_missing", "none_of_these", "cannot_test")
Answer = Mapping[str, Any] | None


class Mark(NamedTuple):
    """One log's outcome and what else its row asks; None where it does not apply.

    at_least_one: of two effects. value_errors: of effects that were named, in their distance from neutral; covered: by
    their intervals. link: whether it is right. closed: of the explainable gap. forced: had it to name one effect.
    absorbed: of answers that say so, whether it is true.
    """

    outcome: str
    set_size: int | None = None
    at_least_one: bool | None = None
    value_errors: tuple[float, ...] = ()
    covered: tuple[bool, ...] = ()
    link: bool | None = None
    closed: float | None = None
    replay_down: float | None = None
    replay_worst: float | None = None
    seconds: float | None = None
    forced: str | None = None
    absorbed: bool | None = None


def detectable(truth: Mapping[str, Any]) -> bool:
    """What the oracle said before the answer; recordings have no oracle, and all of theirs count."""
    return truth.get("oracle") is None or bool(truth["oracle"]["detectable"])


def taken_in(truth: Mapping[str, Any]) -> bool:
    """Whether a log's model was learned from logs with the effect, and by the oracle holds it."""
    return truth["row"] == "start_d" and not detectable(truth)


def names_of(answer: Mapping[str, Any]) -> list[str]:
    """The effects that an answer states as there."""
    return [str(one.get("name", "")) for one in answer.get("effects", [])]


def _matched(names: Sequence[str], truths: Sequence[str]) -> tuple[list[str], list[str]]:
    """(true effects that are named, names that are false); a class counts as one name."""
    hit = [truth for truth in truths if any(same_class(truth, name) for name in names)]
    false = [name for name in names if not any(same_class(truth, name) for truth in truths)]
    return hit, false


def outcome(truths: Sequence[str], answer: Answer, *, absorbed: bool = False, original: bool = False) -> str:
    """The outcome of an answer. absorbed: the model has taken the effect in (`taken_in`), so saying so is right.

    original: a recording as it is, of which nothing is known: no name is right, whichever way it is said.
    """
    if answer is None or answer.get("verdict") not in VERDICTS:
        return "failed"
    verdict = answer["verdict"]
    if verdict == "cannot_test":
        return "cannot_test"
    if verdict in ("none_missing", "none_of_these"):
        said = absorbed and verdict == "none_missing" and bool(answer.get("absorbed"))
        return "right" if said or original else _of_silence(verdict, truths)
    if verdict == "set":
        names = list(answer.get("set", []))
        hit, false = _matched(names, truths)
        if truths and all(name in OUTSIDE for name in truths) and names and not names_of(answer):
            return "in_set"  # honest doubt: of what it knows nothing else can be said
        if not hit or names_of(answer):
            return "wrong"
        return "right" if not false and len(truths) == 1 else "in_set"
    names = names_of(answer)
    hit, false = _matched(names, truths)
    if false or not names:
        return "wrong"
    return "right" if len(hit) == len(truths) else "partial"


def _of_silence(verdict: str, truths: Sequence[str]) -> str:
    if not truths and verdict == "none_missing":
        return "right"
    outside = bool(truths) and all(name in OUTSIDE for name in truths)
    return "right" if outside and verdict == "none_of_these" else "silent"


def forced_name(answer: Mapping[str, Any]) -> str | None:
    """The one name that it would give if it had to: `forced`, else the first of `effects` or `set`."""
    for name in (answer.get("forced"), *names_of(answer), *answer.get("set", [])):
        if name:
            return str(name["name"] if isinstance(name, Mapping) else name)
    return None


def mark(truth: Mapping[str, Any], answer: Answer, seconds: float | None = None) -> Mark:
    """All that is counted of one log."""
    effects: dict[str, dict[str, float]] = truth["effects"]
    truths = list(effects)
    result = outcome(truths, answer, absorbed=taken_in(truth), original=truth["row"] == "semi_free")
    if answer is None:
        return Mark(result, seconds=seconds, at_least_one=False if len(truths) > 1 else None)
    named = names_of(answer) + (list(answer.get("set", [])) if answer.get("verdict") == "set" else [])
    errors, covered = _values(effects, answer) if result in ("right", "partial") else ((), ())
    forced = forced_name(answer)
    replay = answer.get("closed_loop") or {}
    return Mark(
        outcome=result,
        set_size=_set_size(answer, result),
        at_least_one=bool(_matched(named, truths)[0]) if len(truths) > 1 else None,
        value_errors=errors,
        covered=covered,
        link=_link(truths, answer),
        closed=_number(answer.get("explained_frac")),
        replay_down=_number(replay.get("down_frac")),
        replay_worst=_number(replay.get("worst_frac")),
        seconds=_number(answer.get("elapsed_s")) or seconds,
        forced=("right" if forced and _matched([forced], truths)[0] else "wrong" if forced else "silent")
        if truths
        else None,
        absorbed=taken_in(truth) and answer.get("verdict") == "none_missing" if answer.get("absorbed") else None,
    )


def _number(value: Any) -> float | None:
    value = value.get("value") if isinstance(value, Mapping) else value
    return float(value) if isinstance(value, int | float) else None


def _set_size(answer: Mapping[str, Any], result: str) -> int | None:
    if result not in ("right", "in_set"):
        return None
    return len(answer.get("set", [])) if answer.get("verdict") == "set" else 1


def _values(
    effects: Mapping[str, Mapping[str, float]], answer: Mapping[str, Any]
) -> tuple[tuple[float, ...], tuple[bool, ...]]:
    """Relative error and cover of the main parameter of every effect that is named by its own name."""
    errors, covered = [], []
    for one in answer.get("effects", []):
        name = one.get("name", "")
        if name not in effects or name not in EFFECTS:
            continue
        parameter = kind_of(name).parameter
        said, true = one.get("params", {}).get(parameter), effects[name][parameter]
        value = _number(said)
        if value is None:
            continue
        errors.append(abs(value - true) / departure(name, true))
        low, high = (
            said.get("low") if isinstance(said, Mapping) else None,
            said.get("high") if isinstance(said, Mapping) else None,
        )
        if low is not None and high is not None:
            covered.append(low <= true <= high)
    return tuple(errors), tuple(covered)


def _link(truths: Sequence[str], answer: Mapping[str, Any]) -> bool | None:
    """Whether the broken link is the right one; of several effects one of theirs."""
    said = (answer.get("where") or {}).get("link")
    if not truths or said is None:
        return None
    return any(said in links_of(name) for name in truths)
