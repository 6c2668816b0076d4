"""From an unknown vehicle on a bus to verified gains: one resumable, unattended command (paper II and III together).

Six stages and a report, each a job that can be run by itself: collect, calibrate, learn, map, tune, verify. What a
stage came to stands in commission.json when it is done; a commission that was cut off goes on with the stage that was,
and that stage goes on as it does by itself. A stage whose result is not good enough ends the command with the reason.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from typing import Any, NamedTuple

from tunefree_hil.base.errors import TunefreeError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.commission import gates, stages
from tunefree_hil.jobs.commission.next_gap_command import disappointed, gap_command
from tunefree_hil.jobs.commission.plan import NAMES, Asked, Plan, make_plan
from tunefree_hil.jobs.commission.record import Record, held_record
from tunefree_hil.jobs.commission.report import write_report

NOT_GOOD_ENOUGH = 1  # exit status
SAID_EVERY_S = 10.0  # how often the time that a stage has taken is written down

__all__ = ["NAMES", "STAGES", "Stage", "commission"]


class Stage(NamedTuple):
    """name: as in commission.json and on the command line. run: a job. require: '' or why its result will not do.

    again: the same command may bring more where the result would not do; else its result stands until it is redone.
    """

    name: str
    run: Callable[[Plan], Iterator[Event]]
    require: Callable[[dict[str, Any], Plan], str]
    words: str
    again: bool = False


STAGES = (
    Stage("collect", stages.run_collect, gates.covered_enough, "drive what has to be learned from", again=True),
    Stage("calibrate", stages.run_calibrate, gates.enough, "actuators and physical constants from the logs"),
    Stage("learn", stages.run_learn, gates.free_run_good_enough, "a plant from the logs"),
    Stage("map", stages.run_map, gates.enough, "the open-loop map from the logs"),
    Stage("tune", stages.run_tune, gates.inside_enough, "gains on the learned plant"),
    Stage("verify", stages.run_verify, gates.enough, "the gains on the vehicle, roads that no search saw, margins"),
)


def commission(asked: Asked) -> Iterator[Event]:
    """All stages that are not done yet. --from STAGE: that one again and all that follow; --only STAGE: it alone.

    Exit 1 where a stage is not good enough, or where the winner does not hold on the vehicle. Raises InputError for a
    folder that was begun with other options or that another process works in, and whatever a stage raises.
    """
    plan = make_plan(asked)
    with held_record(plan) as record:
        resume = {"resume": plan.command}
        yield Event("note", f"commission of {plan.vehicle.name} in {plan.folder}", resume)
        for number, stage in enumerate(STAGES, 1):
            if asked.only and stage.name != asked.only:
                continue
            head = f"stage {number} of {len(STAGES)}, {stage.name}: {stage.words}"
            result = record.result(stage.name)
            if result is not None:
                yield Event("note", f"{head}: done before")
            else:
                yield Event("note", head, resume)
                try:
                    result = yield from _timed(plan, record, stage, resume)
                except TunefreeError as error:
                    record.fail(stage.name, error.message)
                    write_report(plan, record)
                    raise
            reason = stage.require(result, plan)
            if reason:
                record.stop(stage.name, reason, again=stage.again)
                yield _stopped(plan, record, stage.name, reason)
                return
        yield _ended(plan, record)


def _timed(plan: Plan, record: Record, stage: Stage, resume: dict[str, str]) -> Generator[Event, None, dict[str, Any]]:
    """The stage's events; its result, written to the record with the wall time of all sessions that it took."""
    before_s, began = record.seconds(stage.name), time.monotonic()
    record.enter(stage.name)
    plan.tidy()
    said, result = began, dict[str, Any]()
    for event in stage.run(plan):
        if event.kind == "result":
            result = {**event.data, "sentence": event.data.get("sentence") or event.message}
            continue
        if event.kind == "warning":
            record.warn(stage.name, event.message)
        yield event._replace(data={**event.data, **resume})
        if time.monotonic() - said > SAID_EVERY_S:
            said = time.monotonic()
            record.spend(stage.name, before_s + said - began)
    seconds = before_s + time.monotonic() - began
    result = stages.kept(result, plan.folder)
    record.leave(stage.name, seconds, result)
    yield Event("note", f"{stage.name}: {result.get('sentence', '')} ({seconds / 60.0:.1f} min)")
    return result


def _stopped(plan: Plan, record: Record, name: str, reason: str) -> Event:
    """The end before the last stage."""
    sentence = f"stopped after {name}: {reason}"
    data = {"sentence": sentence, "stage": name, "reason": reason, "folder": str(plan.folder)}
    data["report"] = str(write_report(plan, record))
    return Event("result", sentence, {**data, "exit": NOT_GOOD_ENOUGH, "next": gates.advice(name, plan)})


def _ended(plan: Plan, record: Record) -> Event:
    record.end()
    done = record.done
    whole = len(done) == len(STAGES)
    minutes = sum(one["seconds"] for one in done.values()) / 60.0
    verified = done.get("verify", {}).get("result", {})
    sentence = f"{len(done)} of {len(STAGES)} stages done in {minutes:.1f} min"
    sentence += f"; on the vehicle, unseen: {verified['sentence']}" if verified else ""
    why = disappointed(done)
    offered = gap_command(plan) if why else ""
    sentence += f"; {why}: `gap`, as below, names what the learned plant lacks" if offered else ""
    data = {
        "sentence": sentence,
        "folder": str(plan.folder),
        "minutes": minutes,
        "stages": {name: one["seconds"] for name, one in done.items()},
        "report": str(write_report(plan, record)),
        "exit": 0 if verified.get("holds", True) else NOT_GOOD_ENOUGH,
        "next": ([offered] if offered else []) if whole else [plan.command],
    }
    return Event("result", sentence, data)
