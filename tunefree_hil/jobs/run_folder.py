"""The run folder of interfaces 6: written under temporary names, readable and resumable wherever it was cut off."""

from __future__ import annotations

import contextlib
import errno
import glob
import json
import os
import platform
from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from tunefree_hil import __version__
from tunefree_hil.base.errors import BenchError, InputError

SCHEMA = "tunefree.run/1"
JOINED = "joined"  # key of run.json: what the controller of a bench that was joined calls itself
FULL = (errno.ENOSPC, errno.EDQUOT)
LIBRARIES = ("python-can", "cantools", "numpy", "optuna", "msgspec")


def write_text(path: Path, text: str) -> None:
    """Write a whole file or nothing. Raises BenchError that says why: the disk is full, the folder is not ours."""
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text)
        os.replace(part, path)
    except OSError as error:
        with contextlib.suppress(OSError):  # of what cannot be written there is often nothing
            part.unlink(missing_ok=True)
        hint = "make room" if error.errno in FULL else "see to the folder and its permissions"
        raise BenchError(
            f"cannot write: {error.strerror}",
            code="disk",
            file=str(path),
            hint=f"{hint}, then run the same command",
        ) from error


def write_json(path: Path, data: Any) -> None:
    """Write `data` as indented JSON, atomically."""
    write_text(path, json.dumps(data, indent=1, sort_keys=True) + "\n")


def versions(libraries: Iterable[str] = LIBRARIES) -> dict[str, str]:
    """What numbers were made with: this package, Python, and some libraries."""
    return {
        "tunefree_hil": __version__,
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in libraries},
    }


class RunFolder:
    """One run on disk. Make it with `create`, find it again with `open_run` or `unfinished`."""

    def __init__(self, path: Path, record: dict[str, Any]) -> None:
        self.path = path
        self.record = record

    @classmethod
    def create(
        cls, root: Path, name: str, record: dict[str, Any], prepare: Callable[[Path], None] = lambda path: None
    ) -> RunFolder:
        """A new folder `<root>/<date>-<name>`; `record` is what run.json holds beside schema and versions.

        `prepare(path)` comes before run.json, by which others find it: what must be there, and held, by then.
        """
        date = datetime.now().strftime("%Y%m%d-%H%M%S")
        path, i = root / f"{date}-{name}", 1
        while not _made(path):
            i += 1
            path = root / f"{date}-{name}-{i}"
        prepare(path)
        run = cls(path, {"schema": SCHEMA, "versions": versions(), "complete": False, **record})
        write_json(path / "run.json", run.record)
        return run

    def finish(self, **more: Any) -> None:
        """Mark the run complete; the last thing that is written."""
        self.record = {**self.record, **more, "complete": True}
        write_json(self.path / "run.json", self.record)

    def note(self, **more: Any) -> None:
        """Add to run.json."""
        self.record = {**self.record, **more}
        write_json(self.path / "run.json", self.record)

    def episode(self, k: int) -> Path:
        """Folder of episode k."""
        folder = self.path / "episodes" / str(k)
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def numbered(self, file: str) -> list[int]:
        """Numbers of the episodes that hold `file`, in order; a folder with another name is a person's own."""
        found = [path.parent.name for path in self.path.glob(f"episodes/*/{file}")]
        return sorted(int(name) for name in found if name.isdecimal() and str(int(name)) == name)

    def bench_file(self) -> Path:
        """The resolved bench file. Raises InputError where the run was cut off before it was written."""
        path = self.path / "bench.toml"
        if not path.is_file():
            raise InputError(
                "has no bench.toml: it was cut off before it began", file=str(self.path), hint="start anew"
            )
        return path

    def words(self) -> Path:
        """Where the nodes' own words go."""
        return self.path / "nodes"

    def figures(self) -> Path:
        """Folder of the figures."""
        folder = self.path / "figures"
        folder.mkdir(exist_ok=True)
        return folder


def _made(path: Path) -> bool:
    """Make a run's folder; False where it is there already, perhaps since a moment ago."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError):
            path.mkdir()
            (path / "episodes").mkdir()
            return True
    except OSError as error:
        raise InputError(f"cannot make the run folder: {error.strerror}", file=str(path), hint="--out DIR") from error
    return False


def read_json(file: Path) -> dict[str, Any]:
    """The object in a JSON file of a run. Raises InputError that names the file."""
    try:
        found = json.loads(file.read_text())
    except ValueError as error:
        raise InputError(
            f"not readable JSON ({error})", file=str(file), hint="this run cannot be used; start anew"
        ) from error
    return found if isinstance(found, dict) else {}


def open_run(path: Path) -> RunFolder:
    """Read a run folder. Raises InputError when it is none, of another version, or cut off before it began."""
    file = path / "run.json"
    if not path.is_dir():
        raise InputError("there is no such run folder", file=str(path), hint="`ls runs` shows the runs")
    if not file.is_file():
        raise InputError("not a run folder: it has no run.json", file=str(path), hint="give the folder of a run")
    record = read_json(file)
    schema = record.get("schema")
    if schema != SCHEMA:
        raise InputError(
            f"schema is {schema!r}, this version reads {SCHEMA!r}",
            file=str(file),
            key="schema",
            hint="use the version of tunefree_hil that wrote it",
        )
    made_with = record.get("versions")
    theirs = str(made_with.get("tunefree_hil", "?") if isinstance(made_with, dict) else "?")
    if theirs.split(".")[:2] != __version__.split(".")[:2]:
        raise InputError(
            f"written by tunefree_hil {theirs}, this is {__version__}",
            file=str(file),
            key="versions.tunefree_hil",
            hint=f"install tunefree_hil {theirs}, or start a new run",
        )
    return RunFolder(path, record)


def unfinished(root: Path, name: str, same: dict[str, Any]) -> RunFolder | None:
    """The newest of `all_unfinished`."""
    return next(all_unfinished(root, name, same), None)


def all_unfinished(root: Path, name: str, same: dict[str, Any]) -> Iterator[RunFolder]:
    """The runs `*-<name>` that are not complete and whose record agrees with `same`, the newest first."""
    for path in sorted(root.glob(f"*-{glob.escape(name)}*"), reverse=True):
        try:
            run = open_run(path)
        except InputError:
            continue
        if not run.record.get("complete") and all(run.record.get(key) == value for key, value in same.items()):
            yield run


def remove_parts(folder: Path) -> None:
    """Take away what an interrupted run left half written."""
    for part in folder.rglob("*.part"):
        part.unlink(missing_ok=True)


def drop_bulk(episode: Path) -> None:
    """Keep an episode's summary, drop its logs and columns."""
    for name in ("vehicle.log", "bench.log", "columns.npz", "timing.npz"):
        (episode / name).unlink(missing_ok=True)
