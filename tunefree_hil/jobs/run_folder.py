"""The run folder (docs/reference/files.md): written atomically, readable and resumable after any interruption."""

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
JOINED = "joined"  # key of run.json: name announced by the controller of a joined bench
DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT)
LIBRARIES = ("python-can", "cantools", "numpy", "optuna", "msgspec")


def write_text(path: Path, text: str) -> None:
    """Write a file atomically. Raises BenchError where the disk is full or the folder is not writable."""
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text)
        os.replace(part, path)
    except OSError as error:
        with contextlib.suppress(OSError):  # the part may not exist
            part.unlink(missing_ok=True)
        hint = "free some space" if error.errno in DISK_FULL_ERRORS else "check the folder and its permissions"
        hint += ", then run the same command"
        raise BenchError(f"cannot write: {error.strerror}", code="disk", file=str(path), hint=hint) from error


def write_json(path: Path, data: Any) -> None:
    """Write `data` as indented JSON, atomically."""
    write_text(path, json.dumps(data, indent=1, sort_keys=True) + "\n")


def library_versions(libraries: Iterable[str] = LIBRARIES) -> dict[str, str]:
    """Versions of this package, Python and some libraries."""
    return {
        "tunefree_hil": __version__,
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in libraries},
    }


class RunFolder:
    """One run on disk. Created by `create`, opened by `open_run` or `find_unfinished`."""

    def __init__(self, path: Path, record: dict[str, Any]) -> None:
        self.path = path
        self.record = record

    @classmethod
    def create(
        cls, root: Path, name: str, record: dict[str, Any], prepare: Callable[[Path], None] = lambda path: None
    ) -> RunFolder:
        """Create the folder `<root>/<date>-<name>`; record: content of run.json beside schema and versions.

        prepare: called with the path before run.json is written, by which other processes find the run.
        """
        date = datetime.now().strftime("%Y%m%d-%H%M%S")
        path, i = root / f"{date}-{name}", 1
        while not _make_folder(path):
            i += 1
            path = root / f"{date}-{name}-{i}"
        prepare(path)
        return cls.begin(path, record)

    @classmethod
    def begin(cls, path: Path, record: dict[str, Any]) -> RunFolder:
        """Make a run of an existing folder, as `create` does."""
        run = cls(path, {"schema": SCHEMA, "versions": library_versions(), "complete": False, **record})
        write_json(path / "run.json", run.record)
        return run

    def finish(self, **more: Any) -> None:
        """Mark the run complete, as the last write."""
        self.record = {**self.record, **more, "complete": True}
        write_json(self.path / "run.json", self.record)

    def add_to_record(self, **more: Any) -> None:
        """Add to run.json."""
        self.record = {**self.record, **more}
        write_json(self.path / "run.json", self.record)

    def episode(self, k: int) -> Path:
        """Folder of episode k."""
        folder = self.path / "episodes" / str(k)
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def episodes_with(self, file: str) -> list[int]:
        """Sorted numbers of the episodes that contain `file`; folders with other names are ignored."""
        names = [path.parent.name for path in self.path.glob(f"episodes/*/{file}")]
        return sorted(int(name) for name in names if name.isdecimal() and str(int(name)) == name)

    def bench_file(self) -> Path:
        """The resolved bench file. Raises InputError where the run was interrupted before it was written."""
        path = self.path / "bench.toml"
        if not path.is_file():
            raise InputError(
                "has no bench.toml: it was interrupted at the start", file=str(self.path), hint="start a new run"
            )
        return path

    def node_output(self) -> Path:
        """Folder for the output of the nodes."""
        return self.path / "nodes"

    def figures(self) -> Path:
        """Folder of the figures."""
        folder = self.path / "figures"
        folder.mkdir(exist_ok=True)
        return folder


def _make_folder(path: Path) -> bool:
    """Make a run's folder; False where it already exists (another process may have made it)."""
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
    """Read a JSON object of a run. Raises InputError that names the file."""
    try:
        data = json.loads(file.read_text())
    except ValueError as error:
        raise InputError(
            f"not readable JSON ({error})", file=str(file), hint="this run cannot be used; start a new one"
        ) from error
    return data if isinstance(data, dict) else {}


def open_run(path: Path) -> RunFolder:
    """Open a run folder. Raises InputError when it is not one, or of another version."""
    file = path / "run.json"
    if not path.is_dir():
        raise InputError("no such run folder", file=str(path), hint="`ls runs` shows the runs")
    if not file.is_file():
        raise InputError("not a run folder: it has no run.json", file=str(path), hint="give the folder of a run")
    record = read_json(file)
    schema = record.get("schema")
    if schema != SCHEMA:
        message = f"schema is {schema!r}, this version reads {SCHEMA!r}"
        raise InputError(message, file=str(file), key="schema", hint="use the version of tunefree_hil that wrote it")
    made_with = record.get("versions")
    theirs = str(made_with.get("tunefree_hil", "?") if isinstance(made_with, dict) else "?")
    if theirs.split(".")[:2] != __version__.split(".")[:2]:
        message = f"written by tunefree_hil {theirs}, this is {__version__}"
        hint = f"install tunefree_hil {theirs}, or start a new run"
        raise InputError(message, file=str(file), key="versions.tunefree_hil", hint=hint)
    return RunFolder(path, record)


def find_unfinished(root: Path, name: str, same: dict[str, Any]) -> RunFolder | None:
    """The newest of `iterate_unfinished`, or None."""
    return next(iterate_unfinished(root, name, same), None)


def iterate_unfinished(root: Path, name: str, same: dict[str, Any]) -> Iterator[RunFolder]:
    """The incomplete runs `*-<name>` whose record agrees with `same`, newest first."""
    for path in sorted(root.glob(f"*-{glob.escape(name)}*"), reverse=True):
        try:
            run = open_run(path)
        except InputError:
            continue
        if not run.record.get("complete") and all(run.record.get(key) == value for key, value in same.items()):
            yield run


def remove_partial_files(folder: Path) -> None:
    """Delete the partial files of an interrupted run."""
    for part in folder.rglob("*.part"):
        part.unlink(missing_ok=True)


def delete_logs(episode: Path) -> None:
    """Delete an episode's logs and columns, and keep its summary."""
    for name in ("vehicle.log", "bench.log", "columns.npz", "timing.npz"):
        (episode / name).unlink(missing_ok=True)
