"""From an unknown vehicle on a bus to verified gains: one resumable, unattended command (paper II and III together).

Six stages and a report, each a job that can be run by itself: collect, calibrate, learn, map, tune, verify. What a
stage came to stands in commission.json when it is done; a commission that was cut off goes on with the stage that was,
and that stage goes on as it does by itself. A stage whose result is not good enough ends the command with the reason.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs import commission_stages as stages
from tunefree_hil.jobs.commission_plan import Asked, Plan, make_plan
from tunefree_hil.jobs.commission_report import write_report
from tunefree_hil.jobs.run_folder import read_json, write_json

SCHEMA = "tunefree.commission/1"
RECORD = "commission.json"
NOT_GOOD_ENOUGH = 1  # exit status
SAID_EVERY_S = 10.0  # how often the time that a stage has taken is written down


class Stage(NamedTuple):
    """name: as in commission.json and on the command line. run: a job. require: '' or why its result will not do."""

    name: str
    run: Callable[[Plan], Iterator[Event]]
    require: Callable[[dict[str, Any], Plan], str]
    words: str


STAGES = (
    Stage("collect", stages.run_collect, stages.covered_enough, "drive what has to be learned from"),
    Stage("calibrate", stages.run_calibrate, stages.known_enough, "actuators and physical constants from the logs"),
    Stage("learn", stages.run_learn, stages.free_run_good_enough, "a plant from the logs"),
    Stage("map", stages.run_map, stages.map_good_enough, "the open-loop map from the logs"),
    Stage("tune", stages.run_tune, stages.inside_enough, "gains on the learned plant"),
    Stage("verify", stages.run_verify, stages.always, "the gains on the vehicle, roads that no search saw, margins"),
)
NAMES = tuple(stage.name for stage in STAGES)


def commission(asked: Asked) -> Iterator[Event]:
    """All stages that are not done yet; --only STAGE: that one again, and nothing after it.

    Exit 1 where a stage is not good enough, or where the winner does not hold on the vehicle. Raises InputError for a
    folder that was begun with other options, and whatever a stage raises.
    """
    plan = make_plan(asked)
    record = _record(plan)
    resume = {"resume": f"tunefree-hil commission {plan.words}"}
    yield Event("note", f"commission of {plan.vehicle.name} in {plan.folder}", resume)
    if asked.only:
        record = _forget(plan, record, asked.only)
    for number, stage in enumerate(STAGES, 1):
        if asked.only and stage.name != asked.only:
            continue
        head = f"stage {number} of {len(STAGES)}, {stage.name}: {stage.words}"
        if stage.name in record["stages"]:
            yield Event("note", f"{head}: done before")
            continue
        yield Event("note", head, resume)
        result = yield from _timed(plan, record, stage, resume)
        reason = stage.require(result, plan)
        if reason:
            yield _stopped(plan, record, stage, reason)
            return
    yield _ended(plan, record)


def _record(plan: Plan) -> dict[str, Any]:
    """What is known of this commission, or a new record. Raises InputError where the options are others."""
    path = plan.folder / RECORD
    if not path.is_file():
        plan.folder.mkdir(parents=True, exist_ok=True)
        record = {"schema": SCHEMA, "identity": plan.identity, "stages": {}, "spent_s": {}}
        write_json(path, record)
        return record
    record = read_json(path)
    if record.get("schema") != SCHEMA:
        raise InputError("not a record of this version", file=str(path), key="schema", hint="--out ANOTHER_FOLDER")
    changed = [key for key, value in plan.identity.items() if record["identity"].get(key) != value]
    if changed:
        raise InputError(
            f"was begun with another {', '.join(changed)}",
            code="other_commission",
            file=str(path),
            key=changed[0],
            hint="give the same options to go on, or --out ANOTHER_FOLDER",
        )
    return record


def _forget(plan: Plan, record: dict[str, Any], name: str) -> dict[str, Any]:
    """The record without a stage and without what was built on it; what it wrote is set aside, not lost."""
    later = NAMES[NAMES.index(name) :]
    missing = [one for one in NAMES[: NAMES.index(name)] if one not in record["stages"]]
    if missing:
        raise InputError(
            f"stage {missing[0]} comes before it and is not done", code="stage_missing", key="--only",
            hint="leave --only out: all stages run in their order",
        )  # fmt: skip
    plan.set_aside([one for one in later if one in record["stages"]])
    record["stages"] = {key: value for key, value in record["stages"].items() if key not in later}
    record["spent_s"] = {key: value for key, value in record["spent_s"].items() if key not in later}
    write_json(plan.folder / RECORD, record)
    return record


def _timed(
    plan: Plan, record: dict[str, Any], stage: Stage, resume: dict[str, str]
) -> Generator[Event, None, dict[str, Any]]:
    """The stage's events; its result, written to the record with the wall time of all sessions that it took."""
    path, before_s = plan.folder / RECORD, float(record["spent_s"].get(stage.name, 0.0))
    began = said = time.monotonic()
    result: dict[str, Any] = {}
    for event in stage.run(plan):
        if event.kind == "result":
            result = {**event.data, "sentence": event.data.get("sentence") or event.message}
        else:
            yield event._replace(data={**event.data, **resume})
        if time.monotonic() - said > SAID_EVERY_S:
            said = time.monotonic()
            record["spent_s"][stage.name] = before_s + said - began
            write_json(path, record)
    seconds = before_s + time.monotonic() - began
    record["spent_s"][stage.name] = seconds
    record["stages"][stage.name] = {"seconds": round(seconds, 1), "result": stages.kept(result)}
    write_json(path, record)
    yield Event("note", f"{stage.name}: {result.get('sentence', '')} ({seconds / 60.0:.1f} min)")
    return result


def _stopped(plan: Plan, record: dict[str, Any], stage: Stage, reason: str) -> Event:
    """The end before the last stage. The stage counts as not done, so that the same command tries it again."""
    done = record["stages"].pop(stage.name)
    record["stopped"] = {"stage": stage.name, "reason": reason, "result": done["result"]}
    write_json(plan.folder / RECORD, record)
    sentence = f"stopped after {stage.name}: {reason}"
    data = {"sentence": sentence, "stage": stage.name, "reason": reason, "folder": str(plan.folder)}
    return Event("result", sentence, {**data, "exit": NOT_GOOD_ENOUGH, "next": stages.advice(stage.name, plan)})


def _ended(plan: Plan, record: dict[str, Any]) -> Event:
    done = record["stages"]
    whole = len(done) == len(STAGES)
    record.pop("stopped", None)
    write_json(plan.folder / RECORD, record)
    report = write_report(plan, record) if whole else None
    minutes = sum(one["seconds"] for one in done.values()) / 60.0
    verified = done.get("verify", {}).get("result", {})
    sentence = f"{len(done)} of {len(STAGES)} stages done in {minutes:.1f} min"
    sentence += f"; on the vehicle, unseen: {verified['sentence']}" if verified else ""
    data = {
        "sentence": sentence,
        "folder": str(plan.folder),
        "minutes": minutes,
        "stages": {name: one["seconds"] for name, one in done.items()},
        "report": str(report) if report else "",
        "exit": 0 if verified.get("holds", True) else NOT_GOOD_ENOUGH,
        "next": [f"tunefree-hil commission {plan.words}"] if not whole else [],
    }
    return Event("result", sentence, data)
