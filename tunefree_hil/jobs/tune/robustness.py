"""Hold: what a search found best, driven once more in a slower car; the winner is the best that keeps calm in both.

The slower car is the plant that was searched, dead times and lags of all its actuators times `[tune] slower`. With the
default, 1.5, what holds has the least phase margin that textbooks allow, 30 degrees (docs/margins.md). The batch drives
it, whatever drove the trials; what it needs is compiled for a search in the batch anyhow.

Who won and who was passed over, from what jobs/tune/robustness.py found: plain data, a sentence's end, a table.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, parameters_of
from tunefree_hil.bench.batch import Batch, Driven, Job
from tunefree_hil.bench.scaling import DEAD_TIME, LAG
from tunefree_hil.grade.score import combine
from tunefree_hil.jobs.run_folder import JOINED, RunFolder, read_json, write_json
from tunefree_hil.jobs.tune.margins import ROUND, Drives, why_not
from tunefree_hil.tune.journal import slot_key
from tunefree_hil.tune.robust_winner import Came, ahead, came_of, holds, mean_of, passed_over, ranked
from tunefree_hil.tune.trial import Baseline, Scored, Trial

SCHEMA = "tunefree.held/1"
FILE = "held.json"
FEWEST = 2  # trials among which there is something to choose


class Held(NamedTuple):
    """What the slower car said. came: by `slot_key` of a trial and by a baseline's name; reason: '' or why it said
    nothing, and the winner is then the best by grade alone.
    """

    factor: float = 1.0
    came: Mapping[str, Came] = {}
    reason: str = ""

    def ranked(self, trials: Sequence[Trial]) -> list[Trial]:
        """The trials, the winner first."""
        return ranked(trials, self.came)

    def plain(self) -> dict[str, Any]:
        """As data that JSON can hold."""
        return {**self._asdict(), "came": {key: one._asdict() for key, one in self.came.items()}}


def held_of(data: Mapping[str, Any]) -> Held:
    """What `plain` made data of."""
    return Held(**{**data, "came": _came_of_all(data)})


def hold(
    bench: Bench, run: RunFolder, study: Scored, vectors: Mapping[str, Mapping[str, float]], batch: Drives | None = None
) -> Generator[Event, None, Held]:
    """Drive what may win, and the baselines, in the slower car; kept in held.json of the run, and read from there.

    batch: of the bench's own model; None for one of its own. Where a batch cannot drive this bench, the reason.
    """
    factor = bench.spec.tune.slower
    if factor == 1.0 or len(study.trials()) < FEWEST:
        return Held()
    identity = trials_hash(study, factor)
    reason = why_not(bench, run.record.get(JOINED))
    known = None if reason else _kept(run, identity)
    if known is not None:
        return Held(factor, known)
    if not reason:
        try:
            with ExitStack() as stack:
                came = yield from drive_slower(batch or stack.enter_context(Batch(bench)), bench, study, vectors)
            reason = _indifferent(bench, study, came)
            if not reason:
                held = Held(factor, came)
                data = {"schema": SCHEMA, "of": identity, "slower": factor, "came": held.plain()["came"]}
                write_json(run.path / FILE, data)
                return held
        except (InputError, BenchError) as error:
            reason = f"{error.code}: {error.message.splitlines()[0]}"
    yield Event("warning", f"the winner is the best grade alone, no slower car was driven: {reason}")
    return Held(factor, {}, reason)


def drive_slower(
    batch: Drives, bench: Bench, study: Scored, vectors: Mapping[str, Mapping[str, float]]
) -> Generator[Event, None, dict[str, Came]]:
    """Baselines that are calm as they are, then trials by their grade, until no other can win."""
    came: dict[str, Came] = {}
    baselines = {name: vectors[name] for name, one in study.baselines().items() if _of(one).calm}
    yield Event("note", f"now a slower car, {words_of(bench.spec.tune.slower)}: which of the best trials hold")
    came |= _driven(batch, bench, baselines)
    if not any(_of(one).calm for one in study.trials()):
        yield Event("warning", "no trial drives all roads without a re-plan: none can hold, the best grade wins")
    trials, began, at_once = study.trials(), time.monotonic(), -(-ROUND // len(bench.spec.scenarios))
    while wanted := ahead(trials, came):
        some = {slot_key(one.slot): parameters_of(bench, one.parameters) for one in wanted[:at_once]}
        came |= _driven(batch, bench, some)
        done, left = len(came) - len(baselines), len(ahead(trials, came))
        eta_s = (time.monotonic() - began) / done * left
        held = sum(holds(one, came) for one in trials)
        data = {"label": "trial in the slower car", "done": done, "total": done + left, "eta_s": eta_s}
        yield Event("progress", f"{held} of {done} hold", data)
    return came


def words_of(factor: float) -> str:
    """'dead times and lags +50 %'."""
    return f"dead times and lags {100.0 * (factor - 1.0):+.0f} %"


def _driven(batch: Drives, bench: Bench, vectors: Mapping[str, Mapping[str, float]]) -> dict[str, Came]:
    """What each came to in all scenarios of the bench, in the slower car."""
    scenarios = [bench.scenarios[name] for name in bench.spec.scenarios]
    scale = {DEAD_TIME: bench.spec.tune.slower, LAG: bench.spec.tune.slower}
    driven = batch.drive([Job(values, one, scale=scale) for values in vectors.values() for one in scenarios])
    n = len(scenarios)
    return {name: _came(bench, driven[i * n : (i + 1) * n]) for i, name in enumerate(vectors)}


def _came(bench: Bench, driven: Sequence[Driven]) -> Came:
    """A drive that ended for a reason of the bench's counts as failed: no car may do that to a set that holds."""
    grades = [one.grade for one in driven if one.grade is not None]
    lost = len(driven) - len(grades)
    if lost:
        return Came(bench.weights.failure_score, sum(one.replans for one in grades), lost)
    return came_of(combine(grades), {one.scenario: one._asdict() for one in grades})


def _of(one: Baseline | Trial) -> Came:
    return came_of(one.score, one.scenarios)


def _indifferent(bench: Bench, study: Scored, came: Mapping[str, Came]) -> str:
    """'' or that the slower car is the same car: some plants have no actuators of their own."""
    pairs = [(one.score, came[key].score) for one in study.trials() if (key := slot_key(one.slot)) in came]
    if pairs and all(score == slower for score, slower in pairs):
        return f"model {bench.spec.model} has no actuators that could be slower"
    return ""


def trials_hash(study: Scored, factor: float) -> str:
    """What an answer of the slower car belongs to: the trials with their scores, the baselines, the factor."""
    trials = [[one.slot, one.score] for one in study.trials()]
    words = json.dumps([study.settings.described(), trials, sorted(study.baselines()), factor], sort_keys=True)
    return hashlib.sha256(words.encode()).hexdigest()


def _kept(run: RunFolder, identity: str) -> dict[str, Came] | None:
    path = run.path / FILE
    if not path.is_file():
        return None
    data = read_json(path)
    return _came_of_all(data) if data.get("of") == identity else None


def _came_of_all(data: Mapping[str, Any]) -> dict[str, Came]:
    return {key: Came(**one) for key, one in data["came"].items()}


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
