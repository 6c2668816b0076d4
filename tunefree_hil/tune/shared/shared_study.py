"""A study in PostgreSQL that any number of workers share, each with a bench of its own.

A worker leases the next free slot (slot_leases.py), begins it, evaluates it and stores the score (shared_trials.py).
The attempt of a worker that was killed is stored as failed and repeated, with the same parameters, by the next free
worker. The parameters of a slot depend on the trials finished by then, so the score of each trial is reproducible, the
sequence of trials is not.

If the server is lost, the finished evaluation is saved in a file and stored when the server is back, or by the next
worker that is started with the same run folder.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Self, TypeVar

import optuna
import sqlalchemy
from optuna.samplers import RandomSampler

from tunefree_hil.base.errors import BenchError, TunefreeError
from tunefree_hil.tune import store
from tunefree_hil.tune.shared import server
from tunefree_hil.tune.shared.shared_trials import Attempt, SharedTrials
from tunefree_hil.tune.shared.slot_leases import GRACE_S, SlotLeases
from tunefree_hil.tune.trial import (
    INTERRUPTED,
    Baseline,
    EvaluateAll,
    Evaluation,
    Trial,
    check_evaluation,
    evaluation_from_data,
    find_best_trial,
)
from tunefree_hil.tune.trial_loop import MAX_RETRIES

PATIENCE_S = 120.0
POLL_S = 1.0
SAVED = "kept.json"
R = TypeVar("R")
TrialOrMessage = Trial | str


class SharedStudy:
    """The view of one worker. Make it with `join_study`. `trials` and `baselines` are as last read from the server."""

    def __init__(
        self,
        address: server.StudyAddress,
        shared_trials: SharedTrials,
        leases: SlotLeases,
        folder: Path,
        patience_s: float,
    ) -> None:
        self.address = address
        self.shared_trials = shared_trials
        self.settings = shared_trials.settings
        self.leases = leases
        self.folder = folder
        self.patience_s = patience_s
        self._trials: list[Trial] = []
        self._baselines: dict[str, Baseline] = {}
        self._read()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections to the server."""
        self.shared_trials.close()
        self.leases.engine.dispose()

    def trials(self) -> list[Trial]:
        """The filled slots, in slot order, as last read."""
        return list(self._trials)

    def best(self) -> Trial | None:
        """The best trial (`find_best_trial`), as last read."""
        return find_best_trial(self._trials)

    def baselines(self) -> dict[str, Baseline]:
        """The baselines by name, as last read."""
        return dict(self._baselines)

    def refresh(self) -> Generator[str, None, None]:
        """Read what other workers have stored; yields messages while the server is unreachable."""
        yield from self._retry(self._read)

    def store_baseline(self, name: str, values: dict[str, float], evaluation: Evaluation) -> Generator[str, None, None]:
        """Store the score of a baseline; yields messages while the server is unreachable."""
        yield from self._retry(lambda: self.shared_trials.stored.add_baseline(name, values, evaluation))
        yield from self.refresh()

    def run_trials(self, trials: int, evaluate: EvaluateAll) -> Generator[TrialOrMessage, None, None]:
        """Fill free slots until `trials` slots are filled by the workers together.

        Yields:
            The attempts of this worker, and messages for the user.

        Raises:
            BenchError: The bench failed one slot three times, or the server was unreachable for too long.
        """
        yield from self._store_saved()
        is_waiting = False
        while True:
            yield from self.refresh()
            filled = {trial.slot for trial in self._trials}
            free = [slot for slot in range(trials) if slot not in filled]
            if not free:
                return
            slot = yield from self._retry(lambda free=free: self._acquire_slot(free))
            if slot is None:
                if not is_waiting:
                    yield f"other workers evaluate the last {len(free)} slots; waiting for them"
                is_waiting = True
                time.sleep(POLL_S)
                continue
            is_waiting = False
            yield from self._fill_slot(slot, evaluate)

    def _acquire_slot(self, free: list[int]) -> int | None:
        """Lease the first slot of `free` that no other worker has leased or filled."""
        for slot in free:
            if self.leases.acquire(slot):
                self._read()
                if slot not in {trial.slot for trial in self._trials}:
                    return slot
                self.leases.release(slot)
        return None

    def _fill_slot(self, slot: int, evaluate: EvaluateAll) -> Generator[TrialOrMessage, None, None]:
        """Attempts at a leased slot, until one succeeds."""
        with self.leases.keep_renewed(slot):
            for retry in range(1 + MAX_RETRIES):
                attempt = yield from self._retry(lambda: self.shared_trials.begin(slot, self.leases.worker))
                outcome = yield from self._evaluate(attempt, evaluate)
                if isinstance(outcome, Evaluation):
                    self._save(attempt, outcome)
                    yield from self._store_saved()
                    return
                text = f"{outcome.code}: {outcome.message}"
                yield (
                    yield from self._retry(lambda attempt=attempt, text=text: self.shared_trials.fail(attempt, text))
                )
                if retry == MAX_RETRIES or not isinstance(outcome, BenchError):
                    yield from self._retry(lambda: self.leases.release(slot))
                    raise outcome

    def _evaluate(self, attempt: Attempt, evaluate: EvaluateAll) -> Generator[str, None, Evaluation | TunefreeError]:
        """The evaluation or its error. An interruption or a bug is passed on once the attempt is stored as failed."""
        try:
            (evaluation,) = evaluate({attempt.slot: dict(attempt.parameters)})
            check_evaluation(evaluation, f"slot {attempt.slot}")
        except TunefreeError as error:
            return error
        except BaseException:
            yield from self._retry(lambda: self.shared_trials.fail(attempt, INTERRUPTED))
            yield from self._retry(lambda: self.leases.release(attempt.slot))
            raise
        return evaluation

    def _save(self, attempt: Attempt, evaluation: Evaluation) -> None:
        """Save a finished evaluation in a file before it is stored, so that a lost server does not cost it."""
        data = {"begun": attempt._asdict(), **evaluation.as_data()}
        part = self.folder / f"{SAVED}.part"
        part.write_text(json.dumps(data))
        os.replace(part, self.folder / SAVED)

    def _store_saved(self) -> Generator[TrialOrMessage, None, None]:
        """Store the saved evaluation, if there is one."""
        path = self.folder / SAVED
        if not path.is_file():
            return
        data = json.loads(path.read_text())
        attempt, evaluation = Attempt(**data["begun"]), evaluation_from_data(data)
        note = f"the finished trial is in {path}"
        trial = yield from self._retry(lambda: self._complete(attempt, evaluation), note)
        path.unlink()
        yield trial or f"slot {attempt.slot + 1} was already filled by another worker; this evaluation is discarded"

    def _complete(self, attempt: Attempt, evaluation: Evaluation) -> Trial | None:
        with server.advisory_lock(self.leases.engine):
            trial = self.shared_trials.complete(attempt, evaluation)
        self.leases.release(attempt.slot)
        self._read()
        return trial

    def _read(self) -> None:
        self._trials = self.shared_trials.stored.trials()
        self._baselines = self.shared_trials.stored.baselines()

    def _retry(self, action: Callable[[], R], note: str = "") -> Generator[str, None, R]:
        return (yield from server.retry_while_unreachable(action, self.address, self.patience_s, note))


def join_study(
    text: str,
    settings: store.StudySettings,
    folder: Path,
    *,
    patience_s: float = PATIENCE_S,
    grace_s: float = GRACE_S,
) -> SharedStudy:
    """Open the study at this address, or make it.

    Args:
        text: Address as on the command line.
        settings: Settings that the study must have.
        folder: Where this worker saves an evaluation that it could not store.
        patience_s: Longest wait for a lost server, s.
        grace_s: Age at which the lease of another worker expires, s.

    Raises:
        InputError: Wrong address, a server that refuses, or a study of other settings.
        BenchError: The server does not answer.
    """
    address = server.parse_address(text)
    store.check_settings(settings)
    engine = server.open_engine(address)
    leases = SlotLeases(engine, address.name, grace_s=grace_s)
    shared_trials = None
    try:
        opening = server.retry_while_unreachable(lambda: _open_trials(address, engine, leases, settings), address, 0.0)
        shared_trials = _run_without_waiting(opening)
        where = f"{address.public} (study {address.name})"
        store.require_same_settings(shared_trials.settings.as_data(), settings, where)
        return SharedStudy(address, shared_trials, leases, folder, patience_s)
    except BaseException:
        if shared_trials is not None:
            shared_trials.close()
        engine.dispose()
        raise


def _run_without_waiting(action: Generator[str, None, R]) -> R:
    """The result of a retried action that has no time to wait."""
    try:
        next(action)
    except StopIteration as end:
        return end.value
    raise AssertionError("it has no time to wait")


def _open_trials(
    address: server.StudyAddress, engine: sqlalchemy.Engine, leases: SlotLeases, settings: store.StudySettings
) -> SharedTrials:
    """Open tables and study, or make them; a creation that was cut off is completed."""
    with server.advisory_lock(engine):
        leases.create_table()
        storage = server.open_storage(address)
        study = optuna.create_study(
            study_name=address.name,
            storage=storage,
            direction="minimize",
            load_if_exists=True,
            sampler=RandomSampler(seed=0),
        )
        if store.SETTINGS not in study.user_attrs:
            study.set_user_attr(store.VERSIONS, [optuna.__version__])
            study.set_user_attr(store.SETTINGS, settings.as_data())
        return SharedTrials(study, storage)
