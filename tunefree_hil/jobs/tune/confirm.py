"""Confirm: what a batch found best, and the baselines, driven again over the bus, which alone names a winner."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, parameters_of
from tunefree_hil.jobs.tune.evaluators import BusEvaluator, Candidate
from tunefree_hil.jobs.tune.robustness import Held
from tunefree_hil.jobs.tune.search import Vectors
from tunefree_hil.tune.journal import Journal, slot_key
from tunefree_hil.tune.trial import Baseline, Trial, lowest

SHOWN = 3  # differences that a line names


class Scores(NamedTuple):
    """One candidate's score in the batch and over the bus. different: 'scenario: metric' of all that is not equal."""

    batch: float
    bus: float
    different: tuple[str, ...]

    @property
    def equal(self) -> bool:
        """Bit for bit: score, every metric, re-plans and end of every scenario."""
        return self.batch == self.bus and not self.different

    @property
    def verdict(self) -> str:
        """For a person."""
        if self.equal:
            return "equal"
        more = ", ..." if len(self.different) > SHOWN else ""
        return f"DIFFERENT ({', '.join(self.different[:SHOWN]) or 'score'}{more})"


class Confirmed:
    """The study as the bus confirmed it: the best of the confirmed trials, and the baselines over the bus."""

    def __init__(self, journal: Journal) -> None:
        self.settings = journal.settings
        self._journal = journal
        self._over_bus = journal.confirmed()

    def trials(self) -> list[Trial]:
        """All trials; those that were confirmed as the bus has them."""
        return [self._confirmed(trial) or trial for trial in self._journal.trials()]

    def known(self) -> list[Trial]:
        """The trials that were confirmed, as the bus has them."""
        return [one for trial in self._journal.trials() if (one := self._confirmed(trial)) is not None]

    def best(self) -> Trial | None:
        """The lowest over the bus, the earliest of equals."""
        return lowest(self.known())

    def baselines(self) -> dict[str, Baseline]:
        """Over the bus."""
        return {
            name: Baseline(one.parameters, self._over_bus[name].score, self._over_bus[name].scenarios)
            for name, one in self._journal.baselines().items()
            if name in self._over_bus
        }

    def scores(self) -> dict[str, Scores]:
        """Batch and bus side by side, by `slot_key` or the baseline's name."""
        batch: dict[str, Trial | Baseline] = {slot_key(trial.slot): trial for trial in self._journal.trials()}
        batch |= self._journal.baselines()
        return {
            key: Scores(batch[key].score, one.score, differing(batch[key].scenarios, one.scenarios))
            for key, one in self._over_bus.items()
        }

    def _confirmed(self, trial: Trial) -> Trial | None:
        one = self._over_bus.get(slot_key(trial.slot))
        return trial._replace(score=one.score, scenarios=one.scenarios) if one else None


def differing(batch: Mapping[str, Any], bus: Mapping[str, Any]) -> tuple[str, ...]:
    """What is not equal in the grades of two times the same scenarios; a frame hash only where both have one."""
    found = []
    for name in {**batch, **bus}:
        one, other = _flat(batch.get(name, {})), _flat(bus.get(name, {}))
        known = [key for key in {**one, **other} if key != "frame_hash" or (key in one and key in other)]
        found += [f"{name}: {key}" for key in known if one.get(key, "none") != other.get(key, "none")]
    return tuple(found)


def _flat(drive: Mapping[str, Any]) -> dict[str, Any]:
    return {**{key: value for key, value in drive.items() if key != "metrics"}, **drive.get("metrics", {})}


def to_confirm(journal: Journal, best: int, held: Held) -> dict[str, Trial | None]:
    """Keys of what the bus has not said yet: the `best` trials, those that hold first, and every baseline (None)."""
    chosen = held.ranked(journal.trials())[:best]
    keys: dict[str, Trial | None] = {slot_key(trial.slot): trial for trial in chosen}
    keys |= dict.fromkeys(journal.baselines())
    return {key: trial for key, trial in keys.items() if key not in journal.confirmed()}


def confirm(
    bench: Bench, journal: Journal, evaluator: BusEvaluator, vectors: Vectors, missing: dict[str, Trial | None]
) -> Iterator[Event]:
    """Drive what is missing, one candidate after the other, and store what the bus says."""
    started, order = time.monotonic(), list(vectors)
    for done, (key, trial) in enumerate(missing.items(), 1):
        if trial is None:
            candidate = Candidate(order.index(key), vectors[key])
        else:
            candidate = Candidate(len(order) + trial.slot, parameters_of(bench, trial.parameters))
        try:
            (evaluation,) = evaluator.evaluate([candidate])
        except BenchError as error:
            yield Event("warning", f"{key} failed over the bus and is driven again: {error.message}")
            (evaluation,) = evaluator.evaluate([candidate])
        journal.confirm(key, evaluation)
        scores = Confirmed(journal).scores()[key]
        each_s = (time.monotonic() - started) / done
        data = {"label": "confirm", "done": done, "total": len(missing), "eta_s": each_s * (len(missing) - done)}
        message = f"{key}: batch {scores.batch:.6f}, bus {scores.bus:.6f}, {scores.verdict}"
        yield Event("progress" if scores.equal else "warning", message, {**data, **evaluator.pace})
