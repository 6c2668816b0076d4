"""The examined program: the command lines by which it is called, and what stands behind them on this machine.

An exam is of one program. What it was begun with lies in its exam.json; a later call is compared with that.
"""

from __future__ import annotations

import json
import shlex
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tools.gap_exam.call import found

PACKAGE = "tunefree_hil"  # what is examined; looked for by the interpreter of its executable, never imported here
COMMANDS = ("gap", "calibrate", "learn")
PLACES = ("path", "package")  # of an executable what a later call must find the same
LOOKED_FOR_S = 60.0
LOOK = f"""
import importlib.metadata, importlib.util, json
spec = importlib.util.find_spec({PACKAGE!r})
try: version = importlib.metadata.version({PACKAGE!r})
except importlib.metadata.PackageNotFoundError: version = None
print(json.dumps([spec and spec.origin, version]))
"""


class Program(NamedTuple):
    """How the examined program is called. {log}, {vehicle}, {model}, {out}, {logs}, {physics} are put in."""

    gap: str = "tunefree-hil gap {log} --vehicle {vehicle} --model {model} --out {out} --workers 1 --json"
    calibrate: str = "tunefree-hil calibrate {logs} --vehicle {vehicle} --out {out} --json"
    learn: str = "tunefree-hil learn {logs} --vehicle {vehicle} --physics {physics} --out {out} --minutes 4 --json"
    limit_s: float = 900.0
    learn_limit_s: float = 3600.0


def said_of(program: Program) -> dict[str, Any]:
    """For exam.json: the words of the calls, and by executable where it and its package lie.

    Of an executable that is not there (an exam without learned models needs no `learn`) all is None.
    """
    words = {name: getattr(program, name) for name in COMMANDS}
    names = sorted({shlex.split(line)[0] for line in words.values()})
    return {**words, "limit_s": program.limit_s, "executables": {name: _place_of(name) for name in names}}


def differences(was: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """In what a call differs from what its exam was begun with, in words; what was not there is not compared."""
    names = [(name.replace("_", "-"), was.get(name), now.get(name)) for name in (*COMMANDS, "limit_s")]
    some = [f"--{name} was {before!r}, is {after!r}" for name, before, after in names if before != after]
    before, after = was.get("executables", {}), now.get("executables", {})
    for name in sorted(set(before) & set(after)):
        for place in PLACES:
            old, new = before[name].get(place), after[name].get(place)
            if old and new and old != new:
                some.append(f"{name} ({place}) was {old}, is {new}")
    return some


def _place_of(name: str) -> dict[str, str | None]:
    """path: of the executable; package, version: as its interpreter finds them; commit: checked out where that lies."""
    path = found(name)
    if path is None:
        return dict.fromkeys(("path", "package", "version", "commit"))
    package, version = _package_of(Path(path))
    folder = Path(package or path).resolve().parent
    return {"path": path, "package": package, "version": version, "commit": _commit_of(folder)}


def _package_of(executable: Path) -> tuple[str | None, str | None]:
    """(folder's __init__.py, version) of the package that a Python script would import; None of anything else."""
    with executable.open("rb") as file:
        first = file.readline().decode(errors="replace").strip()
    words = shlex.split(first.removeprefix("#!")) if first.startswith("#!") else [str(executable)]
    if not any(Path(word).name.startswith("python") for word in words):
        return None, None
    # -P: a checkout that happens to be the working directory is not what a script of an environment imports
    asked = [*words, "-P", "-c", LOOK]
    done = subprocess.run(asked, capture_output=True, text=True, check=False, timeout=LOOKED_FOR_S)
    if done.returncode != 0:
        return None, None
    package, version = json.loads(done.stdout)
    return package, version


def _commit_of(folder: Path) -> str | None:
    words = ["git", "-C", str(folder), "rev-parse", "HEAD"]
    return subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip() or None
