"""The study file: an Optuna study in SQLite, `study.db` in the run folder, which optuna-dashboard can open.

It is made under a temporary name and renamed, so an existing study is complete. The settings are stored with it, and a
resume with other settings is refused: trials of two different searches must not be mixed.
"""

from __future__ import annotations

import contextlib
import math
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import optuna
from optuna.samplers import RandomSampler
from optuna.storages import RDBStorage
from sqlalchemy import URL

from tunefree_hil.base.errors import InputError
from tunefree_hil.tune.sampling import GP_UCB, KAPPA_W, check_sampler
from tunefree_hil.tune.space import Space, space_from_data

STUDY_NAME = "tunefree"
BUSY_S = 60.0  # longest wait while another program, such as the dashboard, has locked the file
SETTINGS, VERSIONS = "settings", "optuna_versions"
REQUIREMENTS, STARTS, OBJECTIVES = "requirements", "starts", "objectives"  # keys of the settings
KAPPA = "kappa_w"  # another one


class StudySettings(NamedTuple):
    """What determines a study: with the same settings and Optuna version, slot n has the same parameters everywhere.

    bench_hash: Hash of all that a score depends on (bench file, DBC, model, scenarios, weights).
    first: Parameters of slot 0, inside the space; empty where the sampler chooses them.
    starts: Parameters of the slots after it, such as further manual sets.
    in_flight: Slots of a generation, which are tried together; their parameters depend on earlier generations only.
        0: A shared study, in which each free worker takes a slot; its parameters depend on the trials finished by then.
    requirements: Limits by name, which the sampler gets as a constraint; empty in a search by score alone, as in every
        study of earlier versions.
    objectives: Names of the parts of the score (grade/objectives.py) that are searched at the same time; empty where
        the score is the only objective.
    kappa_w: Weight of the uncertainty for the sampler `gp_ucb`, which alone uses it.
    """

    space: Space
    seed: int
    sampler: str
    bench_hash: str
    first: dict[str, float]
    in_flight: int = 1
    requirements: Mapping[str, float] = {}
    starts: Sequence[Mapping[str, float]] = ()
    objectives: tuple[str, ...] = ()
    kappa_w: float = KAPPA_W

    @property
    def given_points(self) -> list[dict[str, float]]:
        """Parameters of the first slots, which no sampler chooses."""
        return [dict(values) for values in (self.first, *self.starts) if values]

    def as_data(self) -> dict[str, Any]:
        """Plain data, for the study file and for comparison."""
        requirements = {REQUIREMENTS: dict(self.requirements)} if self.requirements else {}
        return {
            "parameters": self.space.as_data(),
            "seed": self.seed,
            "sampler": self.sampler,
            "bench_hash": self.bench_hash,
            "first": self.first,
            "in_flight": self.in_flight,
            **requirements,
            **({STARTS: [dict(values) for values in self.starts]} if self.starts else {}),
            **({OBJECTIVES: list(self.objectives)} if self.objectives else {}),
            **({KAPPA: self.kappa_w} if self.sampler == GP_UCB else {}),
        }


def check_settings(settings: StudySettings) -> None:
    """Raise InputError for settings that a study cannot have."""
    if settings.seed < 0:
        raise InputError(f"the seed is {settings.seed}", code="bad_seed", key="seed", hint="use 0 or more")
    check_sampler(settings.sampler)  # one that searches a single objective gets the trade of several (trial_loop.py)
    if not 0.0 < settings.kappa_w < math.inf:
        hint = f"use a number above 0; default: {KAPPA_W:g}"
        raise InputError(f"kappa_w is {settings.kappa_w:g}", code="bad_kappa_w", key="tune.kappa_w", hint=hint)
    if settings.in_flight < 0:
        raise InputError(f"in_flight is {settings.in_flight}", code="bad_in_flight", key="tune.in_flight")
    if any(settings.space.clip(values) != values for values in settings.given_points):
        message = "a first trial lies outside the search space"
        raise InputError(message, code="bad_parameter", hint="clip it with Space.clip")


class StudyFile(NamedTuple):
    """An open study file; close it with `close_study_file`."""

    study: optuna.Study
    storage: RDBStorage


def open_study_file(path: Path, settings: StudySettings) -> StudyFile:
    """Open the study at `path`, or make it. Raises InputError where it has other settings."""
    check_settings(settings)
    if not path.exists():
        _create_file(path, settings)
    file = read_study_file(path)
    try:
        require_same_settings(file.study.user_attrs[SETTINGS], settings, path)
    except InputError:
        close_study_file(file)
        raise
    versions = read_versions(file.study)
    if versions[-1] != optuna.__version__:
        file.study.set_user_attr(VERSIONS, [*versions, optuna.__version__])
    return file


def read_study_file(path: Path) -> StudyFile:
    """Open the study at `path` unchanged. Raises InputError where there is no study of this program."""
    _require_own_study(path)
    try:
        storage = _storage(path)
    except RuntimeError as error:  # raised by Optuna for a file of another table version
        raise InputError(str(error), code="no_study", file=str(path), hint="see `optuna storage upgrade`") from error
    return StudyFile(optuna.load_study(study_name=STUDY_NAME, storage=storage, sampler=RandomSampler(seed=0)), storage)


def close_study_file(file: StudyFile) -> None:
    """Close the file, which is otherwise in use until the process ends. No data depend on it."""
    file.storage.remove_session()
    file.storage.engine.dispose()


def read_settings(study: optuna.Study) -> StudySettings:
    """The settings that a study was started with."""
    stored = study.user_attrs[SETTINGS]
    space = space_from_data(stored["parameters"])
    values = (stored["seed"], stored["sampler"], stored["bench_hash"], stored["first"], stored.get("in_flight", 1))
    further = {key: stored[key] for key in (REQUIREMENTS, STARTS, KAPPA) if key in stored}
    return StudySettings(space, *values, **further, objectives=tuple(stored.get(OBJECTIVES, ())))


def read_versions(study: optuna.Study) -> tuple[str, ...]:
    """The Optuna versions used, in order. With more than one, a resumed study may differ from an uninterrupted one."""
    return tuple(study.user_attrs[VERSIONS])


def require_same_settings(stored: Mapping[str, Any], settings: StudySettings, where: Path | str) -> None:
    """Raise InputError, which names the differences, where the study at `where` has other settings."""
    differences = describe_differences(stored, settings.as_data())
    if differences:
        raise InputError(
            "the study was started with other settings: " + "; ".join(differences.values()),
            code="study_settings",
            file=str(where),
            key=", ".join(differences),
            hint="resume with the settings it was started with, or start a new run folder",
        )


def describe_differences(stored: Mapping[str, Any], requested: Mapping[str, Any]) -> dict[str, str]:
    """The differences between two settings as plain data: a clause for an error message, by key."""
    stored = {"in_flight": 1, **stored}  # studies of earlier versions do not have it
    stored, requested = ({KAPPA: KAPPA_W, **settings} for settings in (stored, requested))  # of gp_ucb alone
    clauses = {
        key: f"{key} was {stored[key]}, now {requested[key]}"
        for key in ("seed", "sampler", KAPPA, "bench_hash", "in_flight")
        if stored[key] != requested[key]
    }
    for group in ("parameters", "first"):
        old, new = stored[group], requested[group]
        if list(old) != list(new):
            clauses[group] = f"{group} were {', '.join(old) or 'none'}, now {', '.join(new) or 'none'}"
            continue
        for name in [name for name in old if old[name] != new[name]]:
            clauses[f"{group} {name}"] = f"{group} {name} was {_value_text(old[name])}, now {_value_text(new[name])}"
    if stored.get(STARTS, []) != requested.get(STARTS, []):
        clauses[STARTS] = f"{len(stored.get(STARTS, []))} further starts before, now {len(requested.get(STARTS, []))}"
    old, new = (", ".join(settings.get(OBJECTIVES, ())) or "the score" for settings in (stored, requested))
    if old != new:
        clauses[OBJECTIVES] = f"the objectives were {old}, now {new}"
    old, new = stored.get(REQUIREMENTS, {}), requested.get(REQUIREMENTS, {})
    for name in [name for name in {**old, **new} if old.get(name) != new.get(name)]:
        before, after = ("none" if limit is None else f"{limit:g}" for limit in (old.get(name), new.get(name)))
        clauses[f"require {name}"] = f"require.{name} was {before}, now {after}"
    return clauses


@contextlib.contextmanager
def exclusive_lock(path: Path) -> Iterator[None]:
    """Lock `path` for this process, with a locked SQLite file: it works on every system and ends with the process.

    Raises:
        InputError: Another process has the lock, or the file system has no locks.
    """
    lock_path = path.with_suffix(".lock")
    try:
        lock = _open_lock(lock_path)
    except sqlite3.Error as error:
        if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_BUSY:
            hint = f"wait for it or end it, then resume (the lock is {lock_path.name})"
            raise InputError("another process works on it", code="study_busy", file=str(path), hint=hint) from error
        hint = "it needs a folder that may be written, on a file system with locks; an old lock file may be deleted"
        message = f"cannot be locked: {error}"
        raise InputError(message, code="study_not_locked", file=str(lock_path), hint=hint) from error
    try:
        yield
    finally:
        lock.close()


def _open_lock(path: Path) -> sqlite3.Connection:
    lock = sqlite3.connect(path, timeout=0.0, check_same_thread=False, isolation_level=None)
    try:
        lock.execute("BEGIN EXCLUSIVE")
    except BaseException:
        lock.close()
        raise
    return lock


def _create_file(path: Path, settings: StudySettings) -> None:
    part = path.with_name(path.name + ".part")
    for old_part in (part, part.with_name(part.name + "-journal")):
        old_part.unlink(missing_ok=True)
    storage = _storage(part)
    study = optuna.create_study(study_name=STUDY_NAME, storage=storage, direction="minimize")
    study.set_user_attr(SETTINGS, settings.as_data())
    study.set_user_attr(VERSIONS, [optuna.__version__])
    close_study_file(StudyFile(study, storage))
    os.replace(part, path)


def _require_own_study(path: Path) -> None:
    """Raise InputError unless `path` has a study of this program. Optuna would add its tables to any SQLite file."""
    hint = "give the study.db in a run folder of `tune`"
    if not path.is_file():
        raise InputError("there is no study", code="no_study", file=str(path), hint=hint)
    # Not opened read-only: after a kill SQLite must be able to roll back.
    file = sqlite3.connect(path.resolve().as_uri() + "?mode=rw", uri=True, timeout=BUSY_S)
    try:
        row = file.execute(
            "SELECT 1 FROM studies JOIN study_user_attributes USING (study_id) WHERE study_name = ? AND key = ?",
            (STUDY_NAME, SETTINGS),
        ).fetchone()
    except sqlite3.DatabaseError as error:
        message = f"this is not an Optuna study ({error})"
        raise InputError(message, code="no_study", file=str(path), hint=hint) from error
    finally:
        file.close()
    if row is None:
        raise InputError("this Optuna study was not made by tunefree_hil", code="no_study", file=str(path), hint=hint)


def _storage(path: Path) -> RDBStorage:
    url = URL.create("sqlite", database=str(path)).render_as_string()  # SQLAlchemy 2.1 quotes the ? and % of a path
    return RDBStorage(url, engine_kwargs={"connect_args": {"timeout": BUSY_S}})


def _value_text(value: Any) -> str:
    if isinstance(value, dict):
        return f"{value['low']:g} to {value['high']:g} {value['scale']}" + (" stepped" if value["grid"] else "")
    return f"{value:g}"
