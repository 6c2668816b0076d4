"""Who won and who was passed over, from what jobs/tune/hold.py found: plain data, a sentence's end, a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tunefree_hil.jobs.tune.hold import Held, words_of
from tunefree_hil.tune.holding import Came, came_of, holds, mean_of, passed_over
from tunefree_hil.tune.journal import slot_key
from tunefree_hil.tune.trial import Scored, Trial

SHOWN = 5  # trials that are passed over, in a table


def held_data(held: Held, study: Scored, trials: Sequence[Trial]) -> dict[str, Any]:
    """The value of "held" in a result. trials: those of which the winner is one (of a batch: that the bus confirmed).

    driven: trials that were driven in the slower car, of which `holding` hold. winner, passed_over (better than the
    winner by grade alone), baselines: what each came to; `slower` is None for what was not driven there.
    """
    every = study.trials()
    driven = [one for one in every if slot_key(one.slot) in held.came]
    data: dict[str, Any] = {"factor": held.factor, "reason": held.reason, "driven": len(driven)}
    data["holding"] = sum(holds(one, held.came) for one in driven)
    if driven:
        data["winner"] = _row(held.ranked(trials)[0], held)
        data["passed_over"] = [_row(one, held) for one in passed_over(every, held.came)]
        data["baselines"] = {name: held.came[name]._asdict() for name in study.baselines() if name in held.came}
    return data


def held_words(data: Mapping[str, Any]) -> str:
    """The end of a sentence: who is better by grade alone and why it was passed over; '' where there is nobody."""
    if data["reason"]:
        return f"chosen by grade alone ({data['reason']})"
    if not data["driven"]:
        return ""
    winner, car, parts = data["winner"], f"a car with {words_of(data['factor'])}", []
    if not winner["holds"]:
        parts.append(f"NO trial holds in {car}, the winner {_came_words(winner)} there")
    if data["passed_over"]:
        best, number = data["passed_over"][0], len(data["passed_over"])
        others = f", like {number - 1} more of a better grade" if number > 1 else ""
        words = f"{best['key']} scores {best['score']:.3f} and is passed over{others}: it {_came_words(best)}"
        there = f" in {car}, the winner scores {winner['slower']['score']:.3f} there" if best["slower"] else ""
        parts.append(words + there)
    return "; ".join(parts)


def held_table(data: Mapping[str, Any]) -> list[str]:
    """Lines for a person: the winner, who was passed over, and the baselines, in both cars."""
    rows = held_rows(data)
    if not rows:
        return []
    width = max(len(row[0]) for row in rows)
    head = f"{data['holding']} of {data['driven']} trials that were driven with {words_of(data['factor'])} hold there"
    lines = [head, f"{'':{width}}  as it is  slower"]
    lines += [f"{name:{width}}  {own:>8}  {slower:>6}  {verdict}" for name, own, slower, verdict in rows]
    more = len(data["passed_over"]) - SHOWN
    return [*lines, f"... {more} more of a better grade"] if more > 0 else lines


def held_rows(data: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    """(name, score as it is, score in the slower car, verdict), the winner first; none where nothing was driven."""
    if not data["driven"]:
        return []
    rows = {f"{data['winner']['key']}, the winner": data["winner"]}
    rows |= {one["key"]: one for one in data["passed_over"][:SHOWN]}
    rows |= {
        name: {"score": None, "slower": came, "holds": Came(**came).calm} for name, came in data["baselines"].items()
    }
    return [
        (name, _shown(one["score"]), _shown((one["slower"] or {}).get("score")),
         "holds" if one["holds"] else _came_words(one))
        for name, one in rows.items()
    ]  # fmt: skip


def _shown(score: float | None) -> str:
    return "" if score is None else f"{score:.3f}"


def _row(trial: Trial, held: Held) -> dict[str, Any]:
    came = held.came.get(slot_key(trial.slot))
    return {
        "key": slot_key(trial.slot), "slot": trial.slot, "score": trial.score, "mean": mean_of(trial, held.came),
        "calm": came_of(trial.score, trial.scenarios).calm, "slower": came and came._asdict(),
        "holds": holds(trial, held.came),
    }  # fmt: skip


def _came_words(row: Mapping[str, Any]) -> str:
    """'re-plans 13 times and fails in 3 scenarios', or what else keeps a set from winning."""
    came = row["slower"]
    if came is None:
        return "re-plans or fails as it is"
    parts = [f"re-plans {_counted(came['replans'], 'time')}"] if came["replans"] else []
    parts += [f"fails in {_counted(came['failed'], 'scenario')}"] if came["failed"] else []
    return " and ".join(parts) or f"scores {came['score']:.3f}"


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
