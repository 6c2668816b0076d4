"""commission.json: with which options a commission was begun, and what each stage came to.

An option belongs to the first stage that it changes. Another value of it is refused once that stage has begun, unless
the command says that the stage is to be done again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.jobs.commission.plan import NAMES, Plan
from tunefree_hil.jobs.run_folder import read_json, write_json

SCHEMA = "tunefree.commission/1"
RECORD, LOCK = "commission.json", "commission.lock"
STAGE_OF = {
    "kind": "learn", "minutes": "learn", "set": "tune", "trials": "tune", "backend": "tune", "tuning_hash": "tune",
    "verify_hash": "verify",
}  # else: collect  # fmt: skip
FILES = {
    "vehicle_hash": "files of the vehicle",
    "model_hash": "files of the model",
    "tuning_hash": "roads, weights, boxes or controller in the bench file",
    "verify_hash": "roads to verify on",
}
MOST_WARNINGS = 40  # of a stage that are kept for the report


class Record:
    """What is known of a commission; every change is written at once."""

    def __init__(self, path: Path, data: dict[str, Any]) -> None:
        self.path = path
        self.data = data

    def write(self) -> None:
        """The file, whole or not at all."""
        write_json(self.path, self.data)

    @property
    def done(self) -> dict[str, Any]:
        """Stages that came to their end, in their order: {"seconds", "result"}."""
        return {name: self.data["stages"][name] for name in NAMES if name in self.data["stages"]}

    @property
    def shown(self) -> dict[str, Any]:
        """The same, with the stage that was not good enough."""
        stopped = self.data.get("stopped")
        if not stopped or not stopped["result"]:
            return self.done
        return self.done | {stopped["stage"]: {"result": stopped["result"]}}

    def result(self, name: str) -> dict[str, Any] | None:
        """What a stage came to, None where it is not done."""
        found = self.data["stages"].get(name)
        return None if found is None else found["result"]

    def begun(self, name: str) -> bool:
        """Whether a stage was ever entered since it was last set aside."""
        return name in self.data["spent_s"]

    def seconds(self, name: str) -> float:
        """Wall time that a stage has taken so far, all sessions together, s."""
        return float(self.data["spent_s"].get(name, 0.0))

    def warnings(self, name: str) -> list[str]:
        """What a stage warned of."""
        return list(self.data.get("warnings", {}).get(name, []))

    def sessions(self, name: str) -> int:
        """How often a stage was entered: 1 where it was never cut off."""
        return int(self.data.get("sessions", {}).get(name, 0))

    def enter(self, name: str) -> None:
        """A stage begins, or goes on."""
        self.data.pop("stopped", None)
        self.data.setdefault("sessions", {})[name] = self.sessions(name) + 1
        self.spend(name, self.seconds(name))

    def spend(self, name: str, seconds: float) -> None:
        """A stage has taken so long."""
        self.data["spent_s"][name] = seconds
        self.write()

    def warn(self, name: str, words: str) -> None:
        """A stage warned; written with the next change."""
        known = self.data.setdefault("warnings", {}).setdefault(name, [])
        if words not in known and len(known) < MOST_WARNINGS:
            known.append(words)

    def leave(self, name: str, seconds: float, result: Mapping[str, Any]) -> None:
        """A stage is done."""
        self.data["stages"][name] = {"seconds": round(seconds, 1), "result": dict(result)}
        self.spend(name, seconds)

    def stop(self, name: str, reason: str, *, again: bool) -> None:
        """A stage is not good enough. again: the same command tries it anew; else what it came to stands."""
        found = self.data["stages"]
        result = found.pop(name) if again else found[name]
        self.data["stopped"] = {"stage": name, "reason": reason, "result": result["result"]}
        self.write()

    def fail(self, name: str, reason: str) -> None:
        """A stage could not do its work; the same command tries it anew."""
        self.data["stopped"] = {"stage": name, "reason": reason, "result": {}}
        self.write()

    def end(self) -> None:
        """All that was asked for is done."""
        self.data.pop("stopped", None)
        self.write()

    def forget(self, names: tuple[str, ...]) -> None:
        """As if these stages had never begun."""
        for part in ("stages", "spent_s", "warnings", "sessions"):
            self.data[part] = {key: value for key, value in self.data.get(part, {}).items() if key not in names}
        self.data.pop("stopped", None)
        self.write()


@contextmanager
def held_record(plan: Plan) -> Iterator[Record]:
    """The record as it is to go on from: new, as it was, or without the stages that are to be done again.

    No other process may work in the folder meanwhile. Raises InputError where one does, for a folder that holds
    something else or was begun with other options, and for a stage that cannot come yet.
    """
    from tunefree_hil.tune.store import alone

    folder = plan.folder
    if folder.is_dir() and not (folder / RECORD).is_file() and _any_but_lock(folder):
        raise InputError(
            "is not empty and holds no commission", code="not_a_run", file=str(folder), key="--out",
            hint="give a folder that is new, empty, or holds this commission",
        )  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    with alone(folder / LOCK):
        yield _open(plan)


def _any_but_lock(folder: Path) -> bool:
    """A process that was killed first of all has left its lock file and nothing else."""
    return any(not one.name.startswith(LOCK) for one in folder.iterdir())


def _open(plan: Plan) -> Record:
    path = plan.folder / RECORD
    if not path.is_file():
        record = Record(path, {"schema": SCHEMA, "identity": plan.identity, "stages": {}, "spent_s": {}})
        _require_earlier(plan, record)
        record.write()
        return record
    record = Record(path, read_json(path))
    if record.data.get("schema") != SCHEMA:
        raise InputError("not a record of this version", file=str(path), key="schema", hint="--out ANOTHER_FOLDER")
    changed = _changed(plan, record)
    _require_earlier(plan, record)
    if plan.again:
        _do_again(plan, record, bool(changed))
    record.data["identity"] = plan.identity
    record.write()
    return record


def _changed(plan: Plan, record: Record) -> list[str]:
    """Options that are others than before; InputError where a stage that they change has begun and is not to be redone.

    What an earlier version did not write down counts as unchanged.
    """
    before = record.data["identity"]
    changed = [key for key, value in plan.identity.items() if before.get(key, value) != value]
    if not changed:
        return []
    first = min(changed, key=lambda key: NAMES.index(STAGE_OF.get(key, NAMES[0])))
    stage = STAGE_OF.get(first, NAMES[0])
    touched = any(record.begun(name) for name in NAMES[NAMES.index(stage) :])
    if not touched or (plan.again and NAMES.index(plan.again) <= NAMES.index(stage)):
        return changed
    was = f"{first} {before.get(first)!r}, now it is {plan.identity[first]!r}"
    if first in FILES:
        was = f"other {FILES[first]}: they have changed since"
    raise InputError(
        f"was begun with {was}",
        code="other_commission",
        file=str(record.path),
        key=first,
        hint=f"the same as before goes on; --from {stage} does that stage and what follows anew; "
        "--out ANOTHER_FOLDER begins another commission",
    )


def _require_earlier(plan: Plan, record: Record) -> None:
    missing = [name for name in NAMES[: NAMES.index(plan.again)] if record.result(name) is None] if plan.again else []
    if missing:
        raise InputError(
            f"stage {missing[0]} comes before it and is not done", code="stage_missing",
            key="--only" if plan.asked.only else "--from", hint="leave it out: all stages run in their order",
        )  # fmt: skip


def _do_again(plan: Plan, record: Record, changed: bool) -> None:
    """Set aside what a stage and the later ones wrote; what it had only begun with these options goes on."""
    names = NAMES[NAMES.index(plan.again) :]
    goes_on = not changed and record.begun(plan.again) and record.result(plan.again) is None
    gone = names[1:] if goes_on else names
    plan.set_aside(gone)
    record.forget(gone)
