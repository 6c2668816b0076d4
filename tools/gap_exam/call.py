"""Calls of the examined program: a command line, a time limit, and nothing that outlives it."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import NamedTuple

LAST_WORDS = 2000
NOT_STARTED = "setpriv: failed to execute"  # a program whose interpreter is gone is found, and does not run
_running: set[subprocess.Popen[str]] = set()
_guard = threading.Lock()


class Done(NamedTuple):
    """What a call came to: exit status (None: out of time), seconds, stdout and the end of stderr."""

    status: int | None
    seconds: float
    stdout: str
    stderr: str


def _path() -> str:
    """Where programs are looked for: beside the interpreter that runs the exam first."""
    return f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"


def found(name: str) -> str | None:
    """The executable that a call of this name runs; None where there is none."""
    return shutil.which(name, path=_path())


def call(command: str, limit_s: float, **places: str | list[str]) -> Done:
    """Run a command line with its places filled in; all that it started ends with it.

    Programs of the interpreter that runs the exam are found before those of the path. Raises FileNotFoundError where
    there is no such program: nobody was asked then, and nothing was answered.
    """
    words: list[str] = []
    for word in shlex.split(command):
        value = places.get(word[1:-1]) if word.startswith("{") else None
        words += [word] if value is None else [value] if isinstance(value, str) else value
    if found(words[0]) is None:
        raise FileNotFoundError(f"there is no program {words[0]}: install it beside {sys.executable}, or name another")
    if shutil.which("setpriv"):
        words = ["setpriv", "--pdeathsig", "KILL", *words]
    started = time.monotonic()
    with _guard:
        process = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, errors="replace",
            env={**os.environ, "PATH": _path()},
        )  # fmt: skip
        _running.add(process)
    try:
        stdout, stderr = process.communicate(timeout=limit_s)
        status: int | None = process.returncode
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        stdout, stderr = process.communicate()
        status = None
    finally:
        with _guard:
            _running.discard(process)
    if stderr.startswith(NOT_STARTED):
        raise FileNotFoundError(f"{command.split()[0]} does not start: {stderr.strip()}")
    return Done(status, time.monotonic() - started, stdout, stderr[-LAST_WORDS:])


def end_all() -> None:
    """End every call that is under way, with all that it started."""
    with _guard:
        for process in _running:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
