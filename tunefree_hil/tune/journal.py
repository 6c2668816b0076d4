"""A study in memory whose every finished generation is appended to a file of the run folder, for evaluations that are
faster than a database (opt_anchors A: SQLite takes 40 ms a trial, a batch less).

The file is JSON lines, each written at once and complete or not counted: a header with the settings, then generations,
baselines and what was confirmed over the bus. `mirror` copies it to a study.db that optuna-dashboard opens.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import optuna

from tunefree_hil.base.errors import BenchError, InputError, TunefreeError
from tunefree_hil.tune import store
from tunefree_hil.tune.shared.study_copy import mirror
from tunefree_hil.tune.store import Settings
from tunefree_hil.tune.trial import CUT_OFF, Baseline, Evaluation, Trial, check, lowest
from tunefree_hil.tune.trial_loop import Answers, Filling, Points

SCHEMA = "tunefree.trials/1"
CONFIRMED = "confirmed "


class Journal(Filling):
    """A study in `path` (`trials.jsonl` in the run folder). Make it with `open_journal`."""

    def __init__(self, path: Path, settings: Settings) -> None:
        self.path = path
        self.settings = settings
        self._trials: dict[int, Trial] = {}
        self._failures: list[Trial] = []
        self._baselines: dict[str, Baseline] = {}
        self._confirmed: dict[str, Evaluation] = {}

    def trials(self) -> list[Trial]:
        """The filled slots, in slot order."""
        return [self._trials[slot] for slot in sorted(self._trials)]

    def failures(self) -> list[Trial]:
        """The attempts that failed, in the order in which they were made; those of a killed process left no trace."""
        return list(self._failures)

    def best(self) -> Trial | None:
        """The trial of the lowest score, the earliest of equals; None before the first."""
        return lowest(self.trials())

    def baselines(self) -> dict[str, Baseline]:
        """The stored baselines by name."""
        return dict(self._baselines)

    def confirmed(self) -> dict[str, Evaluation]:
        """What the bus said, by `slot_key` of a trial or name of a baseline."""
        return dict(self._confirmed)

    def add_baseline(self, name: str, parameters: Mapping[str, float], evaluation: Evaluation) -> None:
        """Store a baseline's score with the study. It is no trial: the sampler does not learn from it."""
        check(evaluation, f"baseline {name}")
        self._keep({"baseline": name, "parameters": dict(parameters), **_scored(evaluation)})

    def confirm(self, key: str, evaluation: Evaluation) -> None:
        """Store what the bus says of a trial or a baseline."""
        check(evaluation, key)
        self._keep({"confirmed": key, **_scored(evaluation)})

    def alone(self) -> AbstractContextManager[None]:
        """Hold the file. Raises InputError when another process holds it."""
        return store.alone(self.path)

    def begin(self, points: Points) -> None:
        """Nothing is written before there is a result: what a kill leaves is asked again."""

    def end(self, begun: None, points: Points, answers: Answers) -> list[Trial]:
        """Append the generation."""
        trials, failures = [], []
        for slot, answer in answers.items():
            if isinstance(answer, TunefreeError):
                text = CUT_OFF if answer.code == CUT_OFF else f"{answer.code}: {answer.message}"
                failures.append({"slot": slot, "parameters": points[slot], "error": text})
            else:
                trials.append({"slot": slot, "parameters": points[slot], **_scored(answer)})
        self._keep({"trials": trials, "failures": failures})
        by_slot = {one.slot: one for one in self._failures[len(self._failures) - len(failures) :]}
        return [by_slot.get(slot) or self._trials[slot] for slot in answers]

    def load(self) -> None:
        """Read what the file holds; a line that was cut off is taken away. Raises InputError for another study."""
        whole, _, cut = self.path.read_bytes().rpartition(b"\n")
        if cut:
            os.truncate(self.path, len(whole) + 1 if whole else 0)
        if not whole:
            return
        try:
            header, *lines = [json.loads(line) for line in whole.split(b"\n")]
        except ValueError as problem:
            raise _no_journal(self.path, str(problem)) from problem
        if not isinstance(header, dict) or header.get("schema") != SCHEMA:
            raise _no_journal(self.path, "its first line does not say so")
        store.refuse_differing(header["settings"], self.settings, self.path)
        for line in lines:
            self._take(line)

    def write_header(self) -> None:
        """Begin the file, where it is empty."""
        if not self.path.exists() or not self.path.stat().st_size:
            self._append({"schema": SCHEMA, "settings": self.settings.described(), "optuna": optuna.__version__})

    def mirror(self, path: Path) -> None:
        """Copy to the study file at `path` what it does not hold yet, and what the bus confirmed."""
        mirror(path, self, {CONFIRMED + key: _scored(one) for key, one in self._confirmed.items()})

    def _keep(self, line: dict[str, Any]) -> None:
        self._append(line)
        self._take(json.loads(json.dumps(line)))

    def _append(self, line: dict[str, Any]) -> None:
        try:
            with self.path.open("ab") as file:
                file.write((json.dumps(line, separators=(",", ":")) + "\n").encode())
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            hint = "make room, then run the same command"
            raise BenchError(f"cannot write: {error.strerror}", code="disk", file=str(self.path), hint=hint) from error

    def _take(self, line: Mapping[str, Any]) -> None:
        """A line of the file into memory."""
        if "baseline" in line:
            self._baselines[line["baseline"]] = Baseline(line["parameters"], line["score"], line["scenarios"])
        elif "confirmed" in line:
            self._confirmed[line["confirmed"]] = Evaluation(line["score"], line["scenarios"])
        for one in line.get("trials", ()):
            slot = one["slot"]
            self._trials.setdefault(slot, Trial(slot, slot, one["parameters"], one["score"], one["scenarios"]))
        for one in line.get("failures", ()):
            failed = Trial(one["slot"], one["slot"], one["parameters"], math.nan, {}, one["error"])
            self._failures.append(failed)


def open_journal(path: Path, settings: Settings) -> Journal:
    """The study in `path`, made if it is not there. Raises InputError for one that was started with other settings."""
    store.check_settings(settings)
    journal = Journal(path, settings)
    if path.exists():
        journal.load()
    journal.write_header()
    return journal


def slot_key(slot: int) -> str:
    """The name under which a trial is confirmed."""
    return f"trial {slot + 1}"


def _scored(evaluation: Evaluation) -> dict[str, Any]:
    return {"score": float(evaluation.score), "scenarios": evaluation.scenarios}


def _no_journal(path: Path, why: str) -> InputError:
    hint = "give the folder of a `tune --backend batch`, or start a new run"
    return InputError(f"this is no list of trials ({why})", code="no_study", file=str(path), hint=hint)
