"""commission.json: the options that a commission was started with, and the results of its stages.

An option belongs to the first stage that it changes. Another value is refused once that stage has begun, unless the
command restarts the stage.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.jobs.commission.plan import NAMES, CommissionPlan
from tunefree_hil.jobs.run_folder import read_json, write_json

SCHEMA = "tunefree.commission/1"
RECORD, LOCK = "commission.json", "commission.lock"
STAGE_OF = {  # the first stage that an option changes; others: collect
    "kind": "learn",
    "minutes": "learn",
    "set": "tune",
    "trials": "tune",
    "backend": "tune",
    "tuning_hash": "tune",
    "verify_hash": "verify",
}
FILES = {
    "vehicle_hash": "files of the vehicle",
    "model_hash": "files of the model",
    "tuning_hash": "scenarios, weights, ranges or controller in the bench file",
    "verify_hash": "scenarios of the verification",
}
MAX_WARNINGS = 40  # of a stage, stored for the report


class CommissionRecord:
    """The state of a commission; every change is written at once."""

    def __init__(self, path: Path, data: dict[str, Any]) -> None:
        self.path = path
        self.data = data

    def write(self) -> None:
        """Write the file, completely or not at all."""
        write_json(self.path, self.data)

    @property
    def done(self) -> dict[str, Any]:
        """Finished stages in their order: {"seconds", "result"}."""
        return {name: self.data["stages"][name] for name in NAMES if name in self.data["stages"]}

    @property
    def done_or_stopped(self) -> dict[str, Any]:
        """Finished stages, and the one that a gate has stopped."""
        stopped = self.data.get("stopped")
        if not stopped or not stopped["result"]:
            return self.done
        return self.done | {stopped["stage"]: {"result": stopped["result"]}}

    def result(self, name: str) -> dict[str, Any] | None:
        """The result of a stage, None where it is not finished."""
        stage = self.data["stages"].get(name)
        return None if stage is None else stage["result"]

    def is_begun(self, name: str) -> bool:
        """Whether a stage was entered since it was last restarted."""
        return name in self.data["spent_s"]

    def seconds(self, name: str) -> float:
        """Wall time of a stage so far, all sessions together, s."""
        return float(self.data["spent_s"].get(name, 0.0))

    def warnings(self, name: str) -> list[str]:
        """The warnings of a stage."""
        return list(self.data.get("warnings", {}).get(name, []))

    def sessions(self, name: str) -> int:
        """How often a stage was entered: 1 where it was never interrupted."""
        return int(self.data.get("sessions", {}).get(name, 0))

    def enter(self, name: str) -> None:
        """Record that a stage begins or resumes."""
        self.data.pop("stopped", None)
        self.data.setdefault("sessions", {})[name] = self.sessions(name) + 1
        self.spend(name, self.seconds(name))

    def spend(self, name: str, seconds: float) -> None:
        """Record the wall time of a stage."""
        self.data["spent_s"][name] = seconds
        self.write()

    def warn(self, name: str, message: str) -> None:
        """Record a warning of a stage; written with the next change."""
        warnings = self.data.setdefault("warnings", {}).setdefault(name, [])
        if message not in warnings and len(warnings) < MAX_WARNINGS:
            warnings.append(message)

    def leave(self, name: str, seconds: float, result: Mapping[str, Any]) -> None:
        """Record the result of a stage."""
        self.data["stages"][name] = {"seconds": round(seconds, 1), "result": dict(result)}
        self.spend(name, seconds)

    def stop(self, name: str, reason: str, *, repeat_helps: bool) -> None:
        """Record that a result is not good enough; with repeat_helps the same command repeats the stage."""
        stages = self.data["stages"]
        result = stages.pop(name) if repeat_helps else stages[name]
        self.data["stopped"] = {"stage": name, "reason": reason, "result": result["result"]}
        self.write()

    def fail(self, name: str, reason: str) -> None:
        """Record that a stage raised an error; the same command repeats it."""
        self.data["stopped"] = {"stage": name, "reason": reason, "result": {}}
        self.write()

    def finish(self) -> None:
        """Record that all requested stages are done."""
        self.data.pop("stopped", None)
        self.write()

    def forget(self, names: tuple[str, ...]) -> None:
        """Delete these stages from the record."""
        for part in ("stages", "spent_s", "warnings", "sessions"):
            self.data[part] = {key: value for key, value in self.data.get(part, {}).items() if key not in names}
        self.data.pop("stopped", None)
        self.write()


@contextmanager
def open_record(plan: CommissionPlan) -> Iterator[CommissionRecord]:
    """Open and lock the record: a new one, the stored one, or one without the stages to restart.

    Raises:
        InputError: Another process has the lock, the folder has other contents, the options have changed, or an
            earlier stage is missing.
    """
    from tunefree_hil.tune.store import exclusive_lock

    folder = plan.folder
    if folder.is_dir() and not (folder / RECORD).is_file() and _has_other_files(folder):
        hint = "give a folder that is new, empty, or has this commission"
        raise InputError(
            "is not empty and has no commission", code="not_a_run", file=str(folder), key="--out", hint=hint
        )
    folder.mkdir(parents=True, exist_ok=True)
    with exclusive_lock(folder / LOCK):
        yield _open(plan)


def _has_other_files(folder: Path) -> bool:
    """Whether there are files other than the lock, which a process that was killed early leaves."""
    return any(not path.name.startswith(LOCK) for path in folder.iterdir())


def _open(plan: CommissionPlan) -> CommissionRecord:
    path = plan.folder / RECORD
    if not path.is_file():
        record = CommissionRecord(path, {"schema": SCHEMA, "identity": plan.identity, "stages": {}, "spent_s": {}})
        _require_earlier(plan, record)
        record.write()
        return record
    record = CommissionRecord(path, read_json(path))
    if record.data.get("schema") != SCHEMA:
        raise InputError("not a record of this version", file=str(path), key="schema", hint="--out ANOTHER_FOLDER")
    changed = _find_changes(plan, record)
    _require_earlier(plan, record)
    if plan.restart_stage:
        _restart_stages(plan, record, bool(changed))
    record.data["identity"] = plan.identity
    record.write()
    return record


def _find_changes(plan: CommissionPlan, record: CommissionRecord) -> list[str]:
    """The keys of the identity that have changed; a key that an earlier version did not store has not.

    Raises:
        InputError: A stage that a change belongs to has begun and is not restarted.
    """
    old = record.data["identity"]
    changed = [key for key, value in plan.identity.items() if old.get(key, value) != value]
    if not changed:
        return []
    first = min(changed, key=lambda key: NAMES.index(STAGE_OF.get(key, NAMES[0])))
    stage = STAGE_OF.get(first, NAMES[0])
    has_begun = any(record.is_begun(name) for name in NAMES[NAMES.index(stage) :])
    if not has_begun or (plan.restart_stage and NAMES.index(plan.restart_stage) <= NAMES.index(stage)):
        return changed
    change = f"{first} {old.get(first)!r}, now it is {plan.identity[first]!r}"
    if first in FILES:
        change = f"other {FILES[first]}, which have changed"
    hint = f"restore it, or give --from {stage} to restart that stage, or --out ANOTHER_FOLDER for a new commission"
    raise InputError(f"was started with {change}", code="other_commission", file=str(record.path), key=first, hint=hint)


def _require_earlier(plan: CommissionPlan, record: CommissionRecord) -> None:
    """Raise InputError where a stage before the one to restart is not finished."""
    if not plan.restart_stage:
        return
    missing = [name for name in NAMES[: NAMES.index(plan.restart_stage)] if record.result(name) is None]
    if missing:
        key = "--only" if plan.options.only else "--from"
        hint = f"leave out {key}: all stages run in their order"
        raise InputError(f"the earlier stage {missing[0]} is not done", code="stage_missing", key=key, hint=hint)


def _restart_stages(plan: CommissionPlan, record: CommissionRecord, has_changed: bool) -> None:
    """Set aside the results of a stage and of the later ones; a stage that is unfinished and unchanged resumes."""
    names = NAMES[NAMES.index(plan.restart_stage) :]
    resumes = not has_changed and record.is_begun(plan.restart_stage) and record.result(plan.restart_stage) is None
    restarted = names[1:] if resumes else names
    plan.set_aside(restarted)
    record.forget(restarted)
