"""From an unknown vehicle on a bus to verified gains: one resumable, unattended command (paper, II and III together).

Six stages and a report. Each stage is a job that can be run alone: collect, calibrate, learn, map, tune, verify. The
result of a finished stage is stored in commission.json. A commission that was cut off resumes with the stage that was,
and that stage resumes as the job does. A stage whose result is not good enough ends the command with the reason.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from typing import Any, NamedTuple

from tunefree_hil.base.errors import TunefreeError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.commission import gates, stages
from tunefree_hil.jobs.commission.gates import GateResult
from tunefree_hil.jobs.commission.next_gap_command import find_shortfall, make_gap_command
from tunefree_hil.jobs.commission.plan import CommissionPlan, make_plan
from tunefree_hil.jobs.commission.record import CommissionRecord, open_record
from tunefree_hil.jobs.commission.report import write_report
from tunefree_hil.jobs.options.records import CommissionOptions

EXIT_NOT_GOOD_ENOUGH = 1  # exit status
RECORD_PERIOD_S = 10.0  # how often the wall time of a running stage is stored


class CommissionStage(NamedTuple):
    """One stage.

    name: As in commission.json and on the command line.
    run: The job.
    check: Whether the result is good enough.
    purpose: For the progress lines.
    repeat_helps: Whether the same command may improve a result that is not good enough; otherwise the result is kept
        until the stage is restarted.
    """

    name: str
    run: Callable[[CommissionPlan], Iterator[Event]]
    check: Callable[[dict[str, Any], CommissionPlan], GateResult]
    purpose: str
    repeat_helps: bool = False


STAGES = (
    CommissionStage(
        "collect", stages.run_collect, gates.check_coverage, "drive to collect training data", repeat_helps=True
    ),
    CommissionStage("calibrate", stages.run_calibrate, gates.accept, "fit actuators and physical constants"),
    CommissionStage("learn", stages.run_learn, gates.check_free_run, "learn the plant"),
    CommissionStage("map", stages.run_map, gates.accept, "learn the open-loop map"),
    CommissionStage("tune", stages.run_tune, gates.check_outside_share, "tune the gains on the learned plant"),
    CommissionStage(
        "verify", stages.run_verify, gates.accept, "verify the gains on the vehicle, in unseen scenarios, with margins"
    ),
)


def commission(options: CommissionOptions) -> Iterator[Event]:
    """Run all stages that are not done. --from STAGE: restart from that stage; --only STAGE: that one alone.

    Exit status 1 where a result is not good enough, or the winner fails the verification on the vehicle. Raises
    InputError for a folder that was started with other options or is in use, and the errors of the stages.
    """
    plan = make_plan(options)
    with open_record(plan) as record:
        resume = {"resume": plan.command}
        yield Event("note", f"commission of {plan.vehicle.name} in {plan.folder}", resume)
        for number, stage in enumerate(STAGES, 1):
            if options.only and stage.name != options.only:
                continue
            head = f"stage {number} of {len(STAGES)}, {stage.name}: {stage.purpose}"
            result = record.result(stage.name)
            if result is not None:
                yield Event("note", f"{head}: done before")
            else:
                yield Event("note", head, resume)
                try:
                    result = yield from _run_stage(plan, record, stage, resume)
                except TunefreeError as error:
                    record.fail(stage.name, error.message)
                    write_report(plan, record)
                    raise
            gate = stage.check(result, plan)
            if not gate.is_passed:
                record.stop(stage.name, gate.reason, repeat_helps=stage.repeat_helps)
                yield _stop_event(plan, record, stage.name, gate.reason)
                return
        yield _end_event(plan, record)


def _run_stage(
    plan: CommissionPlan, record: CommissionRecord, stage: CommissionStage, resume: dict[str, str]
) -> Generator[Event, None, dict[str, Any]]:
    """Yield the events of a stage; returns its result, which is stored with the wall time of all its sessions."""
    earlier_s, start = record.seconds(stage.name), time.monotonic()
    record.enter(stage.name)
    plan.remove_partial_folders()
    recorded, result = start, dict[str, Any]()
    for event in stage.run(plan):
        if event.kind == "result":
            result = {**event.data, "sentence": event.data.get("sentence") or event.message}
            continue
        if event.kind == "warning":
            record.warn(stage.name, event.message)
        yield event._replace(data={**event.data, **resume})
        if time.monotonic() - recorded > RECORD_PERIOD_S:
            recorded = time.monotonic()
            record.spend(stage.name, earlier_s + recorded - start)
    seconds = earlier_s + time.monotonic() - start
    result = stages.select_result(result, plan.folder)
    record.leave(stage.name, seconds, result)
    yield Event("note", f"{stage.name}: {result.get('sentence', '')} ({seconds / 60.0:.1f} min)")
    return result


def _stop_event(plan: CommissionPlan, record: CommissionRecord, name: str, reason: str) -> Event:
    """The result of a commission that a gate has stopped."""
    sentence = f"stopped after {name}: {reason}"
    data = {"sentence": sentence, "stage": name, "reason": reason, "folder": str(plan.folder)}
    data["report"] = str(write_report(plan, record))
    return Event("result", sentence, {**data, "exit": EXIT_NOT_GOOD_ENOUGH, "next": gates.suggest_commands(name, plan)})


def _end_event(plan: CommissionPlan, record: CommissionRecord) -> Event:
    record.finish()
    done = record.done
    minutes = sum(stage["seconds"] for stage in done.values()) / 60.0
    verified = done.get("verify", {}).get("result", {})
    verdict = f"{verified['verdict']}: " if "verdict" in verified else ""
    sentence = f"{verdict}{len(done)} of {len(STAGES)} stages done in {minutes:.1f} min"
    sentence += f"; on the vehicle, unseen scenarios: {verified['sentence']}" if verified else ""
    shortfall = find_shortfall(done)
    gap_command = make_gap_command(plan) if shortfall else ""
    if shortfall and gap_command:
        sentence += f"; {shortfall.text}: the `gap` command below finds what the learned plant lacks"
    if len(done) == len(STAGES):
        commands = [gap_command] if gap_command else []
    else:
        commands = [plan.command]
    data = {
        "sentence": sentence,
        "folder": str(plan.folder),
        "minutes": minutes,
        "stages": {name: stage["seconds"] for name, stage in done.items()},
        "report": str(write_report(plan, record)),
        "exit": 0 if verified.get("holds", True) else EXIT_NOT_GOOD_ENOUGH,
        "next": commands,
    }
    return Event("result", sentence, data)
