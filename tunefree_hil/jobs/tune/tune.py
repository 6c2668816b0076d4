"""Tune: baselines, trials, robustness check, verification of the winner. Killed anywhere, the same command resumes.

Three ways to score (jobs/tune/evaluators.py): over the bus in lockstep, over the bus in real time, in a compiled batch
whose best trials are confirmed over the bus. Two places of the study: the run folder, or a shared PostgreSQL server.
"""

from __future__ import annotations

import zlib
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, model_of, parameters_of
from tunefree_hil.bench.batch import Batch
from tunefree_hil.grade.requirements.verdict import GainsVerdict
from tunefree_hil.jobs.command_text import shell_command
from tunefree_hil.jobs.learn.report_text import describe_model
from tunefree_hil.jobs.options.records import TuneOptions, VerifyOptions
from tunefree_hil.jobs.run_folder import JOINED, RunFolder
from tunefree_hil.jobs.running.foreign import joined_controller_name, make_launch, require_announced
from tunefree_hil.jobs.running.session import open_lanes
from tunefree_hil.jobs.running.trial_driver import TrialDriver
from tunefree_hil.jobs.tune.confirm import ConfirmedStudy, confirm_over_bus, find_unconfirmed
from tunefree_hil.jobs.tune.ensemble.cars import EnsembleCars
from tunefree_hil.jobs.tune.ensemble.evaluator import EnsembleEvaluator, ensemble_data, open_batch
from tunefree_hil.jobs.tune.ensemble.selection import select_on_held_out, selection_text
from tunefree_hil.jobs.tune.evaluators import BatchEvaluator, BusEvaluator, Evaluator, RealtimeDriver, VectorCandidate
from tunefree_hil.jobs.tune.folder import open_run_folder
from tunefree_hil.jobs.tune.options import BATCH, TunePlan, make_tune_plan
from tunefree_hil.jobs.tune.report import has_recordings, write_tune_report
from tunefree_hil.jobs.tune.robustness import RobustnessResult, check_robustness, hash_trials, robustness_from_data
from tunefree_hil.jobs.tune.search import TrialSearch
from tunefree_hil.jobs.tune.verdict.text import infeasible_text, verdict_reason
from tunefree_hil.jobs.tune.verify import verify_winner
from tunefree_hil.roads.coverage import RoadBeyond, envelope, outside, outside_text
from tunefree_hil.tune.journal import Journal, open_journal, slot_key
from tunefree_hil.tune.shared.finalisation import WORKER, Finalisation
from tunefree_hil.tune.shared.shared_study import SharedStudy, join_study
from tunefree_hil.tune.shared.study_copy import copy_study
from tunefree_hil.tune.study import open_study
from tunefree_hil.tune.trial import ScoredStudy, Trial

JOURNAL = "trials.jsonl"
MAX_NAMED_ROADS = 3  # outside the searched envelope, in one warning
EXIT_REJECTED = 1  # exit status
ROBUSTNESS, VERIFIED = "held", "verified"  # keys of the parts of a finalisation


class TuneOutcome(NamedTuple):
    """A finished search.

    confirmed: Of a batch, the study as confirmed over the bus.
    finalisation: Of a shared study, the work that one worker does for all.
    """

    study: ScoredStudy
    robustness: RobustnessResult
    confirmed: ConfirmedStudy | None = None
    finalisation: Finalisation | None = None

    @property
    def is_verifier(self) -> bool:
        """Whether this process verifies the winner."""
        return self.finalisation is None or (self.finalisation.is_ours and VERIFIED not in self.finalisation.parts)


def tune(options: TuneOptions) -> Iterator[Event]:
    """Run baselines and trials on the model of the bench file, and choose, report and verify the winner.

    Exit status 1 where batch and bus differ or the verification rejects the winner, 4 where the machine is too slow
    for real time.
    """
    plan = make_tune_plan(options)
    with open_run_folder(plan) as (run, is_resumed):
        text = f"{'resuming' if is_resumed else 'run folder'} {run.path}"
        yield Event("note", text, {"resume": plan.command})
        yield Event("note", describe_model(model_of(plan.bench, plan.bench.spec.model)))
        if plan.sampler_choice is not None:
            yield Event("note", plan.sampler_text, plan.sampler_choice._asdict())
        if plan.study_address:
            text = f"study: {plan.study_address}; the score of a trial is reproducible, the sequence of trials is not"
            yield Event("note", text)
        uncovered = find_uncovered_roads(plan.bench) if _is_verified(plan) else []
        yield from _warn_uncovered(uncovered)
        yield from warn_faster_than_data(plan.bench)
        with ExitStack() as stack:
            if plan.options.study:
                run_search = _tune_shared
            else:
                run_search = _tune_in_batch if plan.options.backend == BATCH else _tune_over_bus
            outcome = yield from run_search(plan, run, stack)
            yield from _finish(plan, run, outcome, uncovered)


def _finish(
    plan: TunePlan, run: RunFolder, outcome: TuneOutcome, uncovered: Sequence[RoadBeyond] = ()
) -> Iterator[Event]:
    """Report, verify, and mark the run as complete."""
    report = write_tune_report(plan.bench, run, outcome.study, outcome.robustness, outcome.confirmed)
    yield from (Event("note", line) for line in report.lines)
    data, sentence = dict(report.data), report.sentence
    if plan.bench.spec.ensemble is not None:
        data["ensemble"] = ensemble_data(plan.bench, outcome.study, outcome.robustness.held_out)
        text = selection_text(outcome.robustness.held_out, plan.bench.spec.ensemble)
        sentence = "; ".join(part for part in (sentence, text) if part)
    if plan.options.realtime:
        data["discarded"] = run.record.get("discarded", 0)
        sentence += f"; drives not in real time, discarded and repeated: {data['discarded']}"
    infeasible = infeasible_text(report.decided, len(outcome.study.trials()))
    sentence = f"{infeasible}; {sentence}" if infeasible else sentence
    if _is_verified(plan) and outcome.is_verifier:
        verified = data["verify"] = yield from _verify(plan, run, outcome.finalisation)
        data["verdict"] = verified["verdict"]
        is_rejected = GainsVerdict(verified["verdict"]) is GainsVerdict.REJECTED
        data["exit"] = max(data.get("exit", 0), EXIT_REJECTED if is_rejected else 0)
        sentence = f"{data['verdict']}: {verified['reason']}. Searched: {sentence}. "
        sentence += f"On {plan.bench.spec.verify_model}, unseen scenarios: {verified['summary']}"
    else:
        reason = verdict_reason(report.decided)
        sentence = f"{data['verdict']} on the searched roads, not verified: {reason}; {sentence}"
    if plan.options.verify and _joined_other_model(plan):
        yield Event("warning", _not_verified_text(plan, run))
    data["outside_envelope"] = [{**road._asdict(), "quantity": road.quantity.value} for road in uncovered]
    run.finish(result={"sentence": sentence})
    data["next"] = _next_commands(plan, run)
    yield Event("result", sentence, {"sentence": sentence, "run": str(run.path), **data})


def find_uncovered_roads(bench: Bench) -> list[RoadBeyond]:
    """The roads to be verified that ask for more than the searched ones."""
    courses = {
        kind: {bench.scenarios[name].name: bench.course(bench.scenarios[name]) for name in names}
        for kind, names in (("search", bench.spec.scenarios), ("verify", bench.spec.verify_scenarios))
    }
    return outside(envelope(courses["search"].values()), courses["verify"])


def _warn_uncovered(uncovered: Sequence[RoadBeyond]) -> Iterator[Event]:
    """One warning that names the first roads."""
    if uncovered:
        named, more = [outside_text(road) for road in uncovered[:MAX_NAMED_ROADS]], len(uncovered) - MAX_NAMED_ROADS
        named += [f"and {more} more"] if more > 0 else []
        yield Event("warning", f"{'; '.join(named)}. What is not searched is not known to hold")


def warn_faster_than_data(bench: Bench) -> Iterator[Event]:
    """One warning where searched roads are faster than the data that the model was learned from; its cars are too."""
    valid = model_of(bench, bench.spec.model).valid.speed_mps
    if valid is None:
        return
    fastest = {name: float(np.max(bench.course(bench.scenarios[name]).speed_mps)) for name in bench.spec.scenarios}
    faster = sorted(name for name, speed_mps in fastest.items() if speed_mps > valid[1])
    if faster:
        cars = " and its cars" if bench.spec.ensemble is not None else ""
        yield Event(
            "warning",
            f"{len(faster)} of {len(fastest)} searched roads are faster than the data of model {bench.spec.model} "
            f"({valid[1]:.1f} m/s), {max(fastest.values()):.1f} m/s at most: there it{cars} extrapolates. Collect data "
            "at these speeds and learn it again, or leave these roads out",
            {"faster": faster, "valid_mps": list(valid)},
        )


def _is_verified(plan: TunePlan) -> bool:
    return bool(plan.options.verify and plan.bench.spec.verify_model and not _joined_other_model(plan))


def _joined_other_model(plan: TunePlan) -> bool:
    """Whether the joined nodes simulate another model than the verify model."""
    spec = plan.bench.spec
    return plan.options.join and bool(spec.verify_model) and spec.model != spec.verify_model


def _not_verified_text(plan: TunePlan, run: RunFolder) -> str:
    """The reason, and the commands that verify."""
    spec, session = plan.bench.spec, plan.session
    ecu = shell_command("ecu", run.path / "bench.toml", model=spec.verify_model, session=session)
    verify = shell_command("verify", run.path, join=True, session=session)
    reason = f"not verified: the joined ecu simulates {spec.model}, the verify model is {spec.verify_model}"
    return f"{reason}. End the ecu, start `{ecu}`, then `{verify}`"


def _verify(
    plan: TunePlan, run: RunFolder, finalisation: Finalisation | None
) -> Generator[Event, None, dict[str, Any]]:
    """Verify the winner; in a shared study store that it is done."""
    options = plan.options
    connection = VerifyOptions(run.path, options.bus, options.bench_bus, options.join, plan.session)
    result = yield from verify_winner(plan.bench, run, connection)
    if finalisation is not None:
        yield from _as_warnings(finalisation.store_parts(**{VERIFIED: result["sentence"]}))
    return result


def _next_commands(plan: TunePlan, run: RunFolder) -> list[str]:
    """Commands to run next."""
    replay = [] if plan.options.realtime else [shell_command("replay", run.path, verify=True)]
    return [shell_command("verify", run.path), *replay, shell_command("explain", run.path)]


def _tune_over_bus(plan: TunePlan, run: RunFolder, stack: ExitStack) -> Generator[Event, None, TuneOutcome]:
    """The study is in study.db of the run folder, stored trial by trial."""
    study = stack.enter_context(open_study(run.path / "study.db", plan.settings))
    if len(study.baselines()) < len(plan.vectors) or len(study.trials()) < plan.trials:
        with _open_evaluator(plan, run) as evaluator:
            yield Event("note", _describe_lanes(plan, evaluator))
            search = TrialSearch(plan, run, evaluator, study)
            yield from search.score_baselines()
            yield from search.run_trials()
    robustness = yield from check_robustness(plan.bench, run, study, plan.vectors)
    yield from _redrive_winner(plan, run, robustness.rank_trials(study.trials())[0])
    return TuneOutcome(study, robustness)


def _redrive_winner(plan: TunePlan, run: RunFolder, winner: Trial) -> Iterator[Event]:
    """Drive the winner again where its logs were deleted, as its score was not the best; for figures and `replay`.

    A joined bench is not available any more, so it is left out.
    """
    if has_recordings(plan.bench, run, winner.slot) or plan.options.join:
        return
    with _open_evaluator(plan, run) as evaluator:
        yield Event("note", f"{slot_key(winner.slot)} wins and is driven again, as its logs were deleted")
        values = parameters_of(plan.bench, winner.parameters)
        (evaluation,) = evaluator.evaluate([VectorCandidate(len(plan.vectors) + winner.slot, values)])
    if evaluation.score != winner.score and not plan.options.realtime:
        yield Event("warning", f"driven again it scores {evaluation.score!r}, in the study {winner.score!r}")


def _tune_shared(plan: TunePlan, run: RunFolder, stack: ExitStack) -> Generator[Event, None, TuneOutcome]:
    """One worker of a study in PostgreSQL. Workers begin with different baselines."""
    study = stack.enter_context(join_study(plan.options.study or "", plan.settings, run.path))
    with _open_evaluator(plan, run) as evaluator:
        yield Event("note", _describe_lanes(plan, evaluator))
        search = TrialSearch(plan, run, evaluator, study)
        names = list(plan.vectors)
        n_rotated = zlib.crc32(study.leases.worker.encode()) % len(names)
        yield from search.score_baselines(names[n_rotated:] + names[:n_rotated])
        yield from search.run_trials()
    yield from _as_warnings(study.refresh())
    copy_study(run.path / "study.db", study, {})  # for `explain`, which then needs no server
    finalisation = stack.enter_context(Finalisation(study, hash_trials(study, plan.bench.spec.tune.slower)))
    robustness = yield from _share_robustness(plan, run, study, finalisation)
    if finalisation.is_ours:
        yield from _redrive_winner(plan, run, robustness.rank_trials(study.trials())[0])
    return TuneOutcome(study, robustness, finalisation=finalisation)


def _share_robustness(
    plan: TunePlan, run: RunFolder, study: SharedStudy, finalisation: Finalisation
) -> Generator[Event, None, RobustnessResult]:
    """The robustness result of a shared study, computed by this worker or awaited from another one."""
    wanted = (ROBUSTNESS, VERIFIED) if _is_verified(plan) else (ROBUSTNESS,)
    yield from _as_warnings(finalisation.wait_for_parts(wanted))
    if ROBUSTNESS not in finalisation.parts:
        result = yield from check_robustness(plan.bench, run, study, plan.vectors)
        yield from _as_warnings(finalisation.store_parts(**{ROBUSTNESS: result.as_data()}))
    else:
        text = f"the winner was determined by worker {finalisation.parts[WORKER]}"
        if finalisation.is_ours:
            text += ", which has not verified it"
        elif VERIFIED in finalisation.parts:
            text += " and verified"
        else:
            text += ", which verifies it unless --no-verify was given"
        yield Event("note", text)
    return robustness_from_data(finalisation.parts[ROBUSTNESS])


def _as_warnings(messages: Iterator[str]) -> Iterator[Event]:
    return (Event("warning", message) for message in messages)


def _tune_in_batch(plan: TunePlan, run: RunFolder, stack: ExitStack) -> Generator[Event, None, TuneOutcome]:
    """The study is in trials.jsonl; the trials that may win and the best baseline are confirmed over the bus."""
    journal = open_journal(run.path / JOURNAL, plan.settings)
    if len(journal.baselines()) < len(plan.vectors) or len(journal.trials()) < plan.trials:
        with open_batch(plan.bench) as (batch, cars):
            text = f"batch: {plan.settings.in_flight} trials in flight; a new bench is compiled first"
            n_confirmed = min(plan.confirm, plan.trials)
            text += f". Afterwards the {n_confirmed} best trials and the best manual set are driven over the bus"
            yield Event("note", text)
            evaluator = _make_batch_evaluator(plan, batch, cars, journal)
            search = TrialSearch(plan, run, evaluator, journal)
            yield from search.score_baselines()
            yield from search.run_trials()
            robustness = yield from check_robustness(plan.bench, run, journal, plan.vectors, batch)
    else:
        robustness = yield from check_robustness(plan.bench, run, journal, plan.vectors)
    ranked = robustness.rank_trials(journal.trials())
    held_out = yield from select_on_held_out(plan.bench, run, journal, ranked)
    robustness = robustness._replace(held_out=held_out)
    copying = stack.enter_context(ThreadPoolExecutor(1)).submit(journal.copy_to, run.path / "study.db")
    missing = find_unconfirmed(journal, plan.confirm, robustness)
    if missing:
        with _open_evaluator(plan, run) as evaluator:
            trials = sum(trial is not None for trial in missing.values())
            text = f"confirmation over the bus: {trials} trials" + (
                " and a manual set" if None in missing.values() else ""
            )
            yield Event("note", f"{text}; {_describe_lanes(plan, evaluator)}")
            yield from confirm_over_bus(plan.bench, journal, evaluator, plan.vectors, missing)
    copying.result()
    journal.copy_to(run.path / "study.db")
    confirmed = ConfirmedStudy(journal)
    return TuneOutcome(confirmed, robustness, confirmed)


def _make_batch_evaluator(plan: TunePlan, batch: Batch, cars: EnsembleCars | None, journal: Journal) -> Evaluator:
    """Of the model alone, or of an ensemble of cars."""
    bench, settings, n_baselines = plan.bench, plan.settings, len(plan.vectors)
    if cars is not None:
        asked = {"limits": settings.requirements, "objectives": settings.objectives}
        return EnsembleEvaluator(batch, bench, cars, journal.baselines, first_trial=n_baselines, **asked)
    scenarios = [bench.scenarios[name] for name in bench.spec.scenarios]
    return BatchEvaluator(batch, bench, scenarios, batch_size=max(n_baselines, 1))


def _describe_lanes(plan: TunePlan, evaluator: BusEvaluator) -> str:
    """The bus, the number of benches, trials in flight, and real time."""
    benches = len(evaluator.driver.sessions)
    text = f"bus: {evaluator.driver.sessions[0].choice.why}; "
    text += f"{benches} benches side by side" if benches > 1 else "1 bench"
    in_flight = plan.settings.in_flight
    if in_flight > 1 and plan.options.backend != BATCH:
        text += f", {in_flight} trials in flight: the same --benches and --in-flight give the same trials"
    return text + (", real time" if plan.options.realtime else "")


@contextmanager
def _open_evaluator(plan: TunePlan, run: RunFolder) -> Iterator[BusEvaluator]:
    """Start the benches over the bus and evaluate on them."""
    options, bench = plan.options, plan.bench
    bus = {"bus": options.bus, "bench_bus": options.bench_bus, "join": options.join, "realtime": options.realtime}
    launch = make_launch(bench, bench.spec.model, session=plan.session, **bus)
    with open_lanes(plan.benches, Path(bench.file), run.node_output(), launch) as lanes:
        require_announced(bench, lanes, plan.settings.space.names)
        if options.join:
            run.add_to_record(**{JOINED: joined_controller_name(lanes)})
        driver = TrialDriver(lanes, bench, run)
        scenarios = [bench.scenarios[name] for name in bench.spec.scenarios]
        batch_size = 1 if options.backend == BATCH else max(1, plan.settings.in_flight)
        realtime = RealtimeDriver(driver, repeats=run.record.get("discarded", 0)) if options.realtime else None
        try:
            yield BusEvaluator(driver, scenarios, batch_size=batch_size, realtime=realtime)
        finally:
            driver.close()
            if realtime is not None:
                run.add_to_record(discarded=realtime.repeats)
