"""The study file: an Optuna study in SQLite, `study.db` in the run folder, which optuna-dashboard opens as it is.

It is made under a temporary name and renamed, so a study that exists is whole. What was asked for is stored with it,
and a resume that asks for something else is refused: the trials of two different questions must not be mixed.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import optuna
from optuna.samplers import RandomSampler
from optuna.storages import RDBStorage
from sqlalchemy import URL

from tunefree_hil.base.errors import InputError
from tunefree_hil.tune.sampling import SAMPLERS
from tunefree_hil.tune.space import Space, from_description

STUDY_NAME = "tunefree"
BUSY_S = 60.0  # how long to wait while somebody else, such as the dashboard, holds the file
SETTINGS, VERSIONS = "settings", "optuna_versions"


class Settings(NamedTuple):
    """What makes a study this study: with these, slot n has the same parameters on every machine with this Optuna.

    bench_hash: of all that a score depends on (bench file, DBC, model, scenarios, weights). first: the parameters of
    slot 0, already inside the space; empty where slot 0 is left to the sampler. in_flight: slots that are asked
    together, a generation: their parameters depend on the generations before them alone. 0: many workers, each asks
    when it is free, and parameters depend on what is finished by then.
    """

    space: Space
    seed: int
    sampler: str
    bench_hash: str
    first: dict[str, float]
    in_flight: int = 1

    def described(self) -> dict[str, Any]:
        """As plain data, for the file and for comparison."""
        return {
            "parameters": self.space.described(),
            "seed": self.seed,
            "sampler": self.sampler,
            "bench_hash": self.bench_hash,
            "first": self.first,
            "in_flight": self.in_flight,
        }


def check_settings(settings: Settings) -> None:
    """Raise InputError for a seed, sampler or first trial that a study cannot have."""
    if settings.seed < 0:
        raise InputError(f"the seed is {settings.seed}", code="bad_seed", key="seed", hint="use 0 or more")
    if settings.sampler not in SAMPLERS:
        known = ", ".join(SAMPLERS)
        raise InputError(
            f"no sampler {settings.sampler!r}", code="unknown_sampler", key="tune.sampler", hint=f"use one of {known}"
        )
    if settings.in_flight < 0:
        raise InputError(f"in_flight is {settings.in_flight}", code="bad_in_flight", key="tune.in_flight")
    if settings.first and settings.space.fit(settings.first) != settings.first:
        raise InputError("the first trial lies outside the box", code="bad_parameter", hint="clip it with Space.fit")


class StudyFile(NamedTuple):
    """An open study file; give it back with `close_file`."""

    study: optuna.Study
    storage: RDBStorage


def open_file(path: Path, settings: Settings) -> StudyFile:
    """The study at `path`, made if it is not there. Raises InputError where its settings are others."""
    check_settings(settings)
    if not path.exists():
        _create_file(path, settings)
    file = read_file(path)
    try:
        refuse_differing(file.study.user_attrs[SETTINGS], settings, path)
    except InputError:
        close_file(file)
        raise
    versions = versions_of(file.study)
    if versions[-1] != optuna.__version__:
        file.study.set_user_attr(VERSIONS, [*versions, optuna.__version__])
    return file


def read_file(path: Path) -> StudyFile:
    """The study at `path`, unchanged. Raises InputError where there is none of ours."""
    _check_ours(path)
    try:
        storage = _storage(path)
    except RuntimeError as problem:  # what Optuna raises for a file of another version of its tables
        raise InputError(
            str(problem), code="no_study", file=str(path), hint="see `optuna storage upgrade`"
        ) from problem
    return StudyFile(optuna.load_study(study_name=STUDY_NAME, storage=storage, sampler=RandomSampler(seed=0)), storage)


def close_file(file: StudyFile) -> None:
    """Close the file. Nothing would be lost without it, but an open connection keeps it."""
    file.storage.remove_session()
    file.storage.engine.dispose()


def stored_settings(study: optuna.Study) -> Settings:
    """The settings a study was started with."""
    stored = study.user_attrs[SETTINGS]
    space = from_description(stored["parameters"])
    known = (stored["seed"], stored["sampler"], stored["bench_hash"], stored["first"], stored.get("in_flight", 1))
    return Settings(space, *known)


def versions_of(study: optuna.Study) -> tuple[str, ...]:
    """The versions of Optuna that worked on it, in order. More than one: a resume may have left the original course."""
    return tuple(study.user_attrs[VERSIONS])


def refuse_differing(stored: Mapping[str, Any], settings: Settings, where: Path | str) -> None:
    """Raise InputError that names what differs between the settings of the study at `where` and those asked for."""
    differences = differing(stored, settings.described())
    if differences:
        raise InputError(
            "the study was started with other settings: " + "; ".join(differences.values()),
            code="study_settings",
            file=str(where),
            key=", ".join(differences),
            hint="resume with the settings it was started with, or start a new run folder",
        )


def differing(stored: Mapping[str, Any], asked: Mapping[str, Any]) -> dict[str, str]:
    """What differs between two sets of settings: by key, a clause for a person."""
    stored = {"in_flight": 1, **stored}  # studies of before say nothing of it
    found = {
        key: f"{key} was {stored[key]}, now {asked[key]}"
        for key in ("seed", "sampler", "bench_hash", "in_flight")
        if stored[key] != asked[key]
    }
    for group in ("parameters", "first"):
        before, now = stored[group], asked[group]
        if list(before) != list(now):
            found[group] = f"{group} were {', '.join(before) or 'none'}, now {', '.join(now) or 'none'}"
            continue
        for name in [name for name in before if before[name] != now[name]]:
            found[f"{group} {name}"] = f"{group} {name} was {_short(before[name])}, now {_short(now[name])}"
    return found


@contextlib.contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold the study for this process; InputError when another one holds it, or where none can be held. The system lets
    go when a process dies.

    A locked SQLite file is the one lock that every system has in its standard library.
    """
    lock_path = path.with_suffix(".lock")
    try:
        lock = _locked(lock_path)
    except sqlite3.Error as problem:
        if getattr(problem, "sqlite_errorcode", None) == sqlite3.SQLITE_BUSY:
            hint = f"wait for it or end it, then resume (the lock is {lock_path.name})"
            raise InputError("another process works on it", code="study_busy", file=str(path), hint=hint) from problem
        hint = "it needs a folder that may be written, on a file system with locks; an old lock file may be deleted"
        message = f"cannot be locked: {problem}"
        raise InputError(message, code="study_not_locked", file=str(lock_path), hint=hint) from problem
    try:
        yield
    finally:
        lock.close()


def _locked(path: Path) -> sqlite3.Connection:
    lock = sqlite3.connect(path, timeout=0.0, check_same_thread=False, isolation_level=None)
    try:
        lock.execute("BEGIN EXCLUSIVE")
    except BaseException:
        lock.close()
        raise
    return lock


def _create_file(path: Path, settings: Settings) -> None:
    part = path.with_name(path.name + ".part")
    for left_over in (part, part.with_name(part.name + "-journal")):
        left_over.unlink(missing_ok=True)
    storage = _storage(part)
    study = optuna.create_study(study_name=STUDY_NAME, storage=storage, direction="minimize")
    study.set_user_attr(SETTINGS, settings.described())
    study.set_user_attr(VERSIONS, [optuna.__version__])
    close_file(StudyFile(study, storage))
    os.replace(part, path)


def _check_ours(path: Path) -> None:
    """Raise InputError unless `path` holds a study of ours. Optuna would add its tables to any SQLite file."""
    hint = "give the study.db in a run folder of `tune`"
    if not path.is_file():
        raise InputError("there is no study", code="no_study", file=str(path), hint=hint)
    # Not opened read-only: after a kill SQLite must be able to roll back what was half written.
    file = sqlite3.connect(path.resolve().as_uri() + "?mode=rw", uri=True, timeout=BUSY_S)
    try:
        ours = file.execute(
            "SELECT 1 FROM studies JOIN study_user_attributes USING (study_id) WHERE study_name = ? AND key = ?",
            (STUDY_NAME, SETTINGS),
        ).fetchone()
    except sqlite3.DatabaseError as problem:
        message = f"this is not an Optuna study ({problem})"
        raise InputError(message, code="no_study", file=str(path), hint=hint) from problem
    finally:
        file.close()
    if ours is None:
        raise InputError("this Optuna study is not one of ours", code="no_study", file=str(path), hint=hint)


def _storage(path: Path) -> RDBStorage:
    url = URL.create("sqlite", database=str(path)).render_as_string()  # SQLAlchemy 2.1 quotes the ? and % of a path
    return RDBStorage(url, engine_kwargs={"connect_args": {"timeout": BUSY_S}})


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return f"{value['low']:g} to {value['high']:g} {value['scale']}" + (" stepped" if value["grid"] else "")
    return f"{value:g}"
