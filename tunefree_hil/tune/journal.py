"""A study in memory whose finished generations are appended to a file of the run folder, `trials.jsonl`.

It is for evaluations that are faster than a database: SQLite takes 40 ms a trial, a trial in the batch less. Each line
of the file is a JSON object, written at once. The first line has the settings, the others generations, baselines and
confirmations over the bus. `copy_to` copies the study to a study.db for optuna-dashboard.
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
from tunefree_hil.grade.requirements.judgement import measure_violation
from tunefree_hil.tune import store
from tunefree_hil.tune.pareto import with_trades
from tunefree_hil.tune.shared.study_copy import copy_study
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.trial import (
    OBJECTIVES,
    Baseline,
    Evaluation,
    Trial,
    check_evaluation,
    evaluation_from_data,
    failure_text,
    find_best_trial,
)
from tunefree_hil.tune.trial_loop import Outcomes, Points

SCHEMA = "tunefree.trials/1"
CONFIRMED = "confirmed "  # prefix of the key of a user attribute in the copy


class Journal:
    """A study in `path` (`trials.jsonl` in the run folder). Make it with `open_journal`."""

    def __init__(self, path: Path, settings: StudySettings) -> None:
        self.path = path
        self.settings = settings
        self._trials: dict[int, Trial] = {}
        self._failures: list[Trial] = []
        self._baselines: dict[str, Baseline] = {}
        self._confirmed: dict[str, Evaluation] = {}

    def trials(self) -> list[Trial]:
        """The filled slots, in slot order."""
        return self._with_trades([self._trials[slot] for slot in sorted(self._trials)])

    def failures(self) -> list[Trial]:
        """The failed attempts in the order in which they were made; those of a killed process are not stored."""
        return list(self._failures)

    def best(self) -> Trial | None:
        """The best trial (`find_best_trial`); None before the first trial."""
        return find_best_trial(self.trials())

    def baselines(self) -> dict[str, Baseline]:
        """The stored baselines by name."""
        return dict(self._baselines)

    def confirmations(self) -> dict[str, Evaluation]:
        """Evaluations over the bus, by `slot_key` of a trial or name of a baseline."""
        return dict(self._confirmed)

    def add_baseline(self, name: str, parameters: Mapping[str, float], evaluation: Evaluation) -> None:
        """Store the score of a baseline with the study. It is not a trial: the sampler does not learn from it."""
        check_evaluation(evaluation, f"baseline {name}")
        self._store({"baseline": name, "parameters": dict(parameters), **evaluation.as_data()})

    def store_confirmation(self, key: str, evaluation: Evaluation) -> None:
        """Store the evaluation of a trial or a baseline over the bus."""
        check_evaluation(evaluation, key)
        self._store({"confirmed": key, **evaluation.as_data()})

    def lock(self) -> AbstractContextManager[None]:
        """Lock the file for this process. Raises InputError where another process holds it."""
        return store.exclusive_lock(self.path)

    def begin(self, points: Points) -> None:
        """Store nothing: after a kill the same slots are suggested again."""

    def end(self, begun: None, points: Points, outcomes: Outcomes) -> list[Trial]:
        """Append the generation to the file."""
        trials, failures = [], []
        for slot, outcome in outcomes.items():
            if isinstance(outcome, TunefreeError):
                failures.append({"slot": slot, "parameters": points[slot], "error": failure_text(outcome)})
            else:
                trials.append({"slot": slot, "parameters": points[slot], **outcome.as_data()})
        self._store({"trials": trials, "failures": failures})
        failed = {trial.slot: trial for trial in self._failures[len(self._failures) - len(failures) :]}
        ended = [failed.get(slot) or self._trials[slot] for slot in outcomes]
        return self._with_trades(ended)

    def load(self) -> None:
        """Read the file and remove an incomplete last line. Raises InputError for a study of other settings."""
        complete, _, incomplete = self.path.read_bytes().rpartition(b"\n")
        if incomplete:
            os.truncate(self.path, len(complete) + 1 if complete else 0)
        if not complete:
            return
        try:
            header, *lines = [json.loads(line) for line in complete.split(b"\n")]
        except ValueError as problem:
            raise _no_journal(self.path, str(problem)) from problem
        if not isinstance(header, dict) or header.get("schema") != SCHEMA:
            raise _no_journal(self.path, "its first line has an unknown schema")
        store.require_same_settings(header["settings"], self.settings, self.path)
        for line in lines:
            self._apply(line)

    def write_header(self) -> None:
        """Write the first line of an empty file."""
        if not self.path.exists() or not self.path.stat().st_size:
            self._append({"schema": SCHEMA, "settings": self.settings.as_data(), "optuna": optuna.__version__})

    def copy_to(self, path: Path) -> None:
        """Copy the study with its confirmations to the study file at `path`."""
        attributes = {CONFIRMED + key: evaluation.as_data() for key, evaluation in self._confirmed.items()}
        copy_study(path, self, attributes)

    def _store(self, line: dict[str, Any]) -> None:
        self._append(line)
        self._apply(json.loads(json.dumps(line)))

    def _append(self, line: dict[str, Any]) -> None:
        try:
            with self.path.open("ab") as file:
                file.write((json.dumps(line, separators=(",", ":")) + "\n").encode())
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            hint = "make room, then run the same command"
            raise BenchError(f"cannot write: {error.strerror}", code="disk", file=str(self.path), hint=hint) from error

    def _apply(self, line: Mapping[str, Any]) -> None:
        """Read a line of the file into memory."""
        if "baseline" in line:
            scored = evaluation_from_data(line)
            self._baselines[line["baseline"]] = Baseline(
                line["parameters"],
                scored.score,
                scored.scenarios,
                self._violation(scored.scenarios),
                scored.objectives,
            )
        elif "confirmed" in line:
            self._confirmed[line["confirmed"]] = evaluation_from_data(line)
        for data in line.get("trials", ()):
            slot, violation = data["slot"], self._violation(data["scenarios"])
            trial = Trial(slot, slot, data["parameters"], data["score"], data["scenarios"], violation=violation)
            self._trials.setdefault(slot, trial._replace(objectives=tuple(data.get(OBJECTIVES, ()))))
        for data in line.get("failures", ()):
            failed = Trial(data["slot"], data["slot"], data["parameters"], math.nan, {}, data["error"])
            self._failures.append(failed)

    def _with_trades(self, trials: list[Trial]) -> list[Trial]:
        return with_trades(trials, self._baselines) if self.settings.objectives else trials

    def _violation(self, scenarios: Mapping[str, Any]) -> float:
        return measure_violation(scenarios, self.settings.requirements)


def open_journal(path: Path, settings: StudySettings) -> Journal:
    """Open the study at `path`, or make it. Raises InputError for a study that was started with other settings."""
    store.check_settings(settings)
    journal = Journal(path, settings)
    if path.exists():
        journal.load()
    journal.write_header()
    return journal


def slot_key(slot: int) -> str:
    """The name of a trial in confirmations and in the robustness check."""
    return f"trial {slot + 1}"


def _no_journal(path: Path, reason: str) -> InputError:
    hint = "give the folder of a `tune --backend batch`, or start a new run"
    return InputError(f"this is not a list of trials ({reason})", code="no_study", file=str(path), hint=hint)
