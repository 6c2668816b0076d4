"""Tune: baselines, the study, which trial holds, the winner on the verify model. Killed anywhere, the same goes on.

Three ways (jobs/tune/evaluators.py): over the bus in lockstep, over the bus in real time, in a compiled batch whose
best are confirmed over the bus. And two places of the study: the run folder, or a PostgreSQL that workers share.
"""

from __future__ import annotations

import zlib
from collections.abc import Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from tunefree_hil.base.events import Event
from tunefree_hil.bench import is_heavy, model_of, parameters_of
from tunefree_hil.bench.batch import Batch
from tunefree_hil.jobs.command_text import pasted
from tunefree_hil.jobs.learn.report_text import model_words
from tunefree_hil.jobs.run_folder import JOINED, RunFolder
from tunefree_hil.jobs.running.foreign import joined_name, program_of, require_announced
from tunefree_hil.jobs.running.session import open_lanes
from tunefree_hil.jobs.running.trial_driver import Track
from tunefree_hil.jobs.tune.confirm import Confirmed, confirm, to_confirm
from tunefree_hil.jobs.tune.evaluators import BatchEvaluator, BusEvaluator, Candidate, RealtimeEvaluator
from tunefree_hil.jobs.tune.folder import run_folder_of
from tunefree_hil.jobs.tune.options import BATCH, Asked, Wish, resolve_wish
from tunefree_hil.jobs.tune.report import finish_report, is_kept
from tunefree_hil.jobs.tune.robustness import Held, held_of, hold, trials_hash
from tunefree_hil.jobs.tune.search import Search
from tunefree_hil.jobs.tune.verify import verify_winner
from tunefree_hil.tune.journal import open_journal, slot_key
from tunefree_hil.tune.shared.finalisation import WORKER, Ending
from tunefree_hil.tune.shared.shared_study import SharedStudy, join_study
from tunefree_hil.tune.shared.study_copy import mirror
from tunefree_hil.tune.study import open_study
from tunefree_hil.tune.trial import Scored, Trial

JOURNAL = "trials.jsonl"
HELD, VERIFIED = "held", "verified"  # what one worker of a shared study finds for all


class Finished:
    """What a way of tuning leaves for the end. ending: of a study that workers share, what one of them does for all."""

    def __init__(
        self, study: Scored, held: Held, confirmed: Confirmed | None = None, ending: Ending | None = None
    ) -> None:
        self.study = study
        self.held = held
        self.confirmed = confirmed
        self.ending = ending

    @property
    def verify(self) -> bool:
        """Whether this process is the one to do it."""
        return self.ending is None or (self.ending.ours and VERIFIED not in self.ending.kept)


def tune(asked: Asked) -> Iterator[Event]:
    """Baselines and trials on the bench file's model; the same command goes on where it was cut off.

    Exit 1 where batch and bus differ, 4 where real time could not be had.
    """
    wish = resolve_wish(asked)
    asked = wish.asked  # a run that goes on does so in its own way
    with run_folder_of(wish) as (run, old):
        words = f"{'goes on with' if old else 'run folder'} {run.path}"
        yield Event("note", words, {"resume": wish.command})
        yield Event("note", model_words(model_of(wish.bench, wish.bench.spec.model)))
        if wish.shown:
            yield Event("note", f"study: {wish.shown}; only each trial's score is reproducible, not their course")
        with ExitStack() as stack:
            way = _shared if asked.study else _batch if asked.backend == BATCH else _over_bus
            finished = yield from way(wish, run, stack)
            yield from _told(wish, run, finished)


def _told(wish: Wish, run: RunFolder, finished: Finished) -> Iterator[Event]:
    """The report, the verification, and the run is complete."""
    report = finish_report(wish.bench, run, finished.study, finished.held, finished.confirmed)
    yield from (Event("note", line) for line in report.lines)
    data, sentence = dict(report.data), report.sentence
    if wish.asked.realtime:
        data["discarded"] = run.record.get("discarded", 0)
        sentence += f"; drives that were not real time, discarded and repeated: {data['discarded']}"
    if _verifies(wish) and finished.verify:
        data["verify"] = yield from _verified(wish, run, finished.ending)
        sentence += f". On {wish.bench.spec.verify_model}, unseen: {data['verify']['sentence']}"
    elif wish.asked.verify and _other_car(wish):
        yield Event("warning", _not_verified(wish, run))
    run.finish(result={"sentence": sentence})
    data["next"] = _next(wish, run)
    yield Event("result", sentence, {"sentence": sentence, "run": str(run.path), **data})


def _verifies(wish: Wish) -> bool:
    return bool(wish.asked.verify and wish.bench.spec.verify_model and not _other_car(wish))


def _other_car(wish: Wish) -> bool:
    """Whether the nodes that were joined go on as another car than the one to verify on."""
    spec = wish.bench.spec
    return wish.asked.join and bool(spec.verify_model) and spec.model != spec.verify_model


def _not_verified(wish: Wish, run: RunFolder) -> str:
    """Why not, and how it is done."""
    spec, session = wish.bench.spec, wish.session
    ecu = pasted("ecu", run.path / "bench.toml", model=spec.verify_model, session=session)
    verify = pasted("verify", run.path, join=True, session=session)
    words = f"not verified: the ecu that was joined drives {spec.model}, and {spec.verify_model} is to be driven"
    return f"{words}. End it, start `{ecu}`, then `{verify}`"


def _verified(wish: Wish, run: RunFolder, ending: Ending | None) -> Generator[Event, None, dict[str, Any]]:
    """The winner on the verify model; other workers are told that it is done."""
    asked = wish.asked
    found = yield from verify_winner(
        wish.bench, run, bus=asked.bus, bench_bus=asked.bench_bus, session=wish.session, join=asked.join
    )
    if ending is not None:
        yield from _warnings(ending.keep(**{VERIFIED: found["sentence"]}))
    return found


def _next(wish: Wish, run: RunFolder) -> list[str]:
    """What to type next: commands that installation brought, so each works as it is pasted."""
    replayed = [] if wish.asked.realtime else [pasted("replay", run.path, verify=True)]
    return [pasted("verify", run.path), *replayed, pasted("explain", run.path)]


def _over_bus(wish: Wish, run: RunFolder, stack: ExitStack) -> Generator[Event, None, Finished]:
    """The study in the run folder's study.db, told trial by trial."""
    study = stack.enter_context(open_study(run.path / "study.db", wish.settings))
    if len(study.baselines()) < len(wish.vectors) or len(study.trials()) < wish.trials:
        with _on_lanes(wish, run) as evaluator:
            yield Event("note", _said_of(wish, evaluator))
            search = Search(wish.bench, run, evaluator, study, wish.vectors, wish.trials)
            yield from search.baselines()
            yield from search.trials()
    held = yield from hold(wish.bench, run, study, wish.vectors)
    yield from _winner_again(wish, run, held.ranked(study.trials())[0])
    return Finished(study, held)


def _winner_again(wish: Wish, run: RunFolder, winner: Trial) -> Iterator[Event]:
    """A winner that was not the best grade has no logs any more: it is driven again, for figures and `replay`.

    A bench that was joined is gone by now; the winner is then without.
    """
    if is_kept(wish.bench, run, winner.slot) or wish.asked.join:
        return
    with _on_lanes(wish, run) as evaluator:
        yield Event("note", f"{slot_key(winner.slot)} wins and is driven again, its logs were not kept")
        values = parameters_of(wish.bench, winner.parameters)
        (again,) = evaluator.evaluate([Candidate(len(wish.vectors) + winner.slot, values)])
    if again.score != winner.score and not wish.asked.realtime:
        yield Event("warning", f"driven again it scores {again.score!r}, the study has {winner.score!r}")


def _shared(wish: Wish, run: RunFolder, stack: ExitStack) -> Generator[Event, None, Finished]:
    """One worker of a study in PostgreSQL. Workers begin with different baselines."""
    study = stack.enter_context(join_study(wish.asked.study or "", wish.settings, run.path))
    with _on_lanes(wish, run) as evaluator:
        yield Event("note", _said_of(wish, evaluator))
        search = Search(wish.bench, run, evaluator, study, wish.vectors, wish.trials)
        names = list(wish.vectors)
        turn = zlib.crc32(study.claims.worker.encode()) % len(names)
        yield from search.baselines(names[turn:] + names[:turn])
        yield from search.trials()
    yield from _warnings(study.refresh())
    mirror(run.path / "study.db", study, {})  # what reads a run's study (`explain`) needs no server
    ending = stack.enter_context(Ending(study, trials_hash(study, wish.bench.spec.tune.slower)))
    held = yield from _held_for_all(wish, run, study, ending)
    if ending.ours:
        yield from _winner_again(wish, run, held.ranked(study.trials())[0])
    return Finished(study, held, ending=ending)


def _held_for_all(wish: Wish, run: RunFolder, study: SharedStudy, ending: Ending) -> Generator[Event, None, Held]:
    """What the slower car said, found by one worker: by this one, or by another that is waited for."""
    yield from _warnings(ending.look((HELD, VERIFIED) if _verifies(wish) else (HELD,)))
    if HELD not in ending.kept:
        found = yield from hold(wish.bench, run, study, wish.vectors)
        yield from _warnings(ending.keep(**{HELD: found.plain()}))
    elif ending.ours:
        yield Event("note", f"who wins was found by worker {ending.kept[WORKER]}, which has not verified it")
    else:
        done = "verified the winner too" if VERIFIED in ending.kept else "verifies the winner, if it was asked to"
        yield Event("note", f"who wins was found by worker {ending.kept[WORKER]}; it {done}")
    return held_of(ending.kept[HELD])


def _warnings(words: Iterator[str]) -> Iterator[Event]:
    return (Event("warning", one) for one in words)


def _batch(wish: Wish, run: RunFolder, stack: ExitStack) -> Generator[Event, None, Finished]:
    """The study in memory and in a list of generations; what may win and the baselines then over the bus."""
    journal = open_journal(run.path / JOURNAL, wish.settings)
    scenarios = [wish.bench.scenarios[name] for name in wish.bench.spec.scenarios]
    if len(journal.baselines()) < len(wish.vectors) or len(journal.trials()) < wish.trials:
        with Batch(wish.bench) as batch:
            words = f"batch: {wish.settings.in_flight} trials in flight; a bench new to this machine is compiled first"
            best = min(wish.confirm, wish.trials)
            yield Event("note", f"{words}. In the end the bus confirms the winner ({best} trials) and the baselines")
            evaluator = BatchEvaluator(batch, wish.bench, scenarios, at_once=max(len(wish.vectors), 1))
            search = Search(wish.bench, run, evaluator, journal, wish.vectors, wish.trials)
            yield from search.baselines()
            yield from search.trials()
            held = yield from hold(wish.bench, run, journal, wish.vectors, batch)
    else:
        held = yield from hold(wish.bench, run, journal, wish.vectors)
    mirror = stack.enter_context(ThreadPoolExecutor(1)).submit(journal.mirror, run.path / "study.db")
    missing = to_confirm(journal, wish.confirm, held)
    if missing:
        with _on_lanes(wish, run) as evaluator:
            trials = sum(trial is not None for trial in missing.values())
            words = f"now over the bus: {trials} of the batch's trials and {len(missing) - trials} baselines"
            yield Event("note", f"{words}; {_said_of(wish, evaluator)}")
            yield from confirm(wish.bench, journal, evaluator, wish.vectors, missing)
    mirror.result()
    journal.mirror(run.path / "study.db")
    confirmed = Confirmed(journal)
    return Finished(confirmed, held, confirmed)


def _said_of(wish: Wish, evaluator: BusEvaluator) -> str:
    benches = len(evaluator.track.sessions)
    side = f"{benches} benches side by side" if benches > 1 else "1 bench"
    words = f"bus: {evaluator.track.sessions[0].choice.why}; {side}"
    flying = wish.settings.in_flight
    if flying > 1 and wish.asked.backend != BATCH:
        words += f", {flying} trials in flight: the same --benches and --in-flight give the same trials"
    return words + (", real time" if wish.asked.realtime else "")


@contextmanager
def _on_lanes(wish: Wish, run: RunFolder) -> Iterator[BusEvaluator]:
    """Benches over the bus, and what evaluates on them."""
    asked, bench, model = wish.asked, wish.bench, wish.bench.spec.model
    with open_lanes(
        wish.benches,
        Path(bench.file),
        run.words(),
        session=wish.session,
        model=model,
        bus=asked.bus,
        bench_bus=asked.bench_bus,
        realtime=asked.realtime,
        join=asked.join,
        jitted_ecu=is_heavy(bench, model),
        controller_command=program_of(bench),
    ) as lanes:
        require_announced(bench, lanes, wish.settings.space.names)
        if asked.join:
            run.note(**{JOINED: joined_name(lanes)})
        track = Track(lanes, bench, run)
        scenarios = [bench.scenarios[name] for name in bench.spec.scenarios]
        at_once = 1 if asked.backend == BATCH else max(1, wish.settings.in_flight)
        evaluator = BusEvaluator(track, scenarios, at_once=at_once)
        if asked.realtime:
            repeats = run.record.get("discarded", 0)
            evaluator = RealtimeEvaluator(track, scenarios, at_once=at_once, repeats=repeats)
        try:
            yield evaluator
        finally:
            track.close()
            if isinstance(evaluator, RealtimeEvaluator):
                run.note(discarded=evaluator.repeats)
