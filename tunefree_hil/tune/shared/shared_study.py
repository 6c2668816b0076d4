"""A study in PostgreSQL with any number of workers, each with a bench of its own (design D13, D14).

A worker takes the next free slot (claims.py), begins it, evaluates, tells (slots.py). The slot of a worker that was
killed is told FAIL and repeated, with the same parameters, by whoever is free next. What a slot is asked for depends on
what was finished by then, so only each trial's score is reproducible, not the course of the study.

A server that goes away in the middle costs nothing: the finished evaluation is kept in a file, told when the server is
back, or by the next worker that is started with the same run folder.
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
from tunefree_hil.tune.shared.shared_trials import Begun, Slots
from tunefree_hil.tune.shared.slot_leases import GRACE_S, Claims
from tunefree_hil.tune.trial import CUT_OFF, Baseline, EvaluateAll, Evaluation, Trial, check, lowest
from tunefree_hil.tune.trial_loop import ASKED_AGAIN

PATIENCE_S = 120.0
POLL_S = 1.0
KEPT = "kept.json"
R = TypeVar("R")
TrialOrWords = Trial | str


class SharedStudy:
    """One worker's view of a shared study. Make it with `join_study`. `trials` and `baselines` are as last read."""

    def __init__(self, address: server.Address, slots: Slots, claims: Claims, folder: Path, patience_s: float) -> None:
        self.address = address
        self.slots = slots
        self.settings = slots.settings
        self.claims = claims
        self.folder = folder
        self.patience_s = patience_s
        self._known: list[Trial] = []
        self._baselines: dict[str, Baseline] = {}
        self._read()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the server."""
        self.slots.close()
        self.claims.engine.dispose()

    def trials(self) -> list[Trial]:
        """The filled slots, in slot order, as last read."""
        return list(self._known)

    def best(self) -> Trial | None:
        """The trial of the lowest score, as last read."""
        return lowest(self._known)

    def baselines(self) -> dict[str, Baseline]:
        """The baselines by name, as last read."""
        return dict(self._baselines)

    def refresh(self) -> Generator[str, None, None]:
        """Read what other workers have done; yields what a person should know while the server is gone."""
        yield from self._patiently(self._read)

    def keep_baseline(self, name: str, values: dict[str, float], evaluation: Evaluation) -> Generator[str, None, None]:
        """Store a baseline's score, patiently."""
        yield from self._patiently(lambda: self.slots.add_baseline(name, values, evaluation))
        yield from self.refresh()

    def run_all(self, trials: int, evaluate: EvaluateAll) -> Generator[TrialOrWords, None, None]:
        """Fill free slots until `trials` are filled, by whomever; yields own attempts, and sentences for a person.

        Raises BenchError when the bench failed a slot three times, or the server was gone for too long.
        """
        yield from self._tell_kept()
        waiting = False
        while True:
            yield from self.refresh()
            filled = {trial.slot for trial in self._known}
            free = [slot for slot in range(trials) if slot not in filled]
            if not free:
                return
            slot = yield from self._patiently(lambda free=free: self._take(free))
            if slot is None:
                if not waiting:
                    yield f"{len(free)} slots are with other workers; waiting for them"
                waiting = True
                time.sleep(POLL_S)
                continue
            waiting = False
            yield from self._fill(slot, evaluate)

    def _take(self, free: list[int]) -> int | None:
        """Claim the first of `free` that nobody alive has, and that was not filled meanwhile."""
        for slot in free:
            if self.claims.take(slot):
                self._read()
                if slot not in {trial.slot for trial in self._known}:
                    return slot
                self.claims.leave(slot)
        return None

    def _fill(self, slot: int, evaluate: EvaluateAll) -> Generator[TrialOrWords, None, None]:
        """Attempts at a slot that is ours, until one is told."""
        with self.claims.alive(slot):
            for attempt in range(1 + ASKED_AGAIN):
                begun = yield from self._patiently(lambda: self.slots.begin(slot, self.claims.worker))
                answer = yield from self._answer(begun, evaluate)
                if isinstance(answer, Evaluation):
                    self._keep(begun, answer)
                    yield from self._tell_kept()
                    return
                text = f"{answer.code}: {answer.message}"
                yield (yield from self._patiently(lambda begun=begun, text=text: self.slots.fail(begun, text)))
                if attempt == ASKED_AGAIN or not isinstance(answer, BenchError):
                    yield from self._patiently(lambda: self.claims.leave(slot))
                    raise answer

    def _answer(self, begun: Begun, evaluate: EvaluateAll) -> Generator[str, None, Evaluation | TunefreeError]:
        """The evaluation, or what went wrong. An interruption or a bug goes through once FAIL was told."""
        try:
            (evaluation,) = evaluate({begun.slot: dict(begun.parameters)})
            check(evaluation, f"slot {begun.slot}")
        except TunefreeError as problem:
            return problem
        except BaseException:
            yield from self._patiently(lambda: self.slots.fail(begun, CUT_OFF))
            yield from self._patiently(lambda: self.claims.leave(begun.slot))
            raise
        return evaluation

    def _keep(self, begun: Begun, evaluation: Evaluation) -> None:
        """Into a file before anything else: a finished evaluation is not lost to a server."""
        data = {"begun": begun._asdict(), "score": evaluation.score, "scenarios": evaluation.scenarios}
        part = self.folder / f"{KEPT}.part"
        part.write_text(json.dumps(data))
        os.replace(part, self.folder / KEPT)

    def _tell_kept(self) -> Generator[TrialOrWords, None, None]:
        """Tell what the file holds, if it is there."""
        path = self.folder / KEPT
        if not path.is_file():
            return
        kept = json.loads(path.read_text())
        begun, evaluation = Begun(**kept["begun"]), Evaluation(kept["score"], kept["scenarios"])
        trial = yield from self._patiently(lambda: self._settle(begun, evaluation), f"the finished trial is in {path}")
        path.unlink()
        yield trial or f"slot {begun.slot + 1} was filled by another worker meanwhile; ours is dropped"

    def _settle(self, begun: Begun, evaluation: Evaluation) -> Trial | None:
        with server.one_at_a_time(self.claims.engine):
            trial = self.slots.settle(begun, evaluation)
        self.claims.leave(begun.slot)
        self._read()
        return trial

    def _read(self) -> None:
        self._known = self.slots.trials()
        self._baselines = self.slots.baselines()

    def _patiently(self, work: Callable[[], R], kept: str = "") -> Generator[str, None, R]:
        return (yield from server.patiently(work, self.address, self.patience_s, kept))


def join_study(
    text: str,
    settings: store.Settings,
    folder: Path,
    *,
    patience_s: float = PATIENCE_S,
    grace_s: float = GRACE_S,
) -> SharedStudy:
    """The study at this address, made if it is not there; `folder` is where this worker keeps what it could not tell.

    Raises InputError for a wrong address, a server that refuses, or a study of other settings; BenchError when the
    server does not answer.
    """
    address = server.address_of(text)
    store.check_settings(settings)
    engine = server.open_engine(address)
    claims = Claims(engine, address.name, grace_s=grace_s)
    slots = None
    try:
        slots = _at_once(server.patiently(lambda: _made(address, engine, claims, settings), address, 0.0))
        store.refuse_differing(slots.settings.described(), settings, f"{address.shown} (study {address.name})")
        return SharedStudy(address, slots, claims, folder, patience_s)
    except BaseException:
        if slots is not None:
            slots.close()
        engine.dispose()
        raise


def _at_once(patient: Generator[str, None, R]) -> R:
    """The answer of something patient that has no time to wait."""
    try:
        next(patient)
    except StopIteration as done:
        return done.value
    raise AssertionError("it was not to wait")


def _made(address: server.Address, engine: sqlalchemy.Engine, claims: Claims, settings: store.Settings) -> Slots:
    """Tables and study; a creation that was cut off is finished."""
    with server.one_at_a_time(engine):
        claims.create()
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
            study.set_user_attr(store.SETTINGS, settings.described())
        return Slots(study, storage)
