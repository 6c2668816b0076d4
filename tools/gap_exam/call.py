"""Calls of the examined program: a command line, a time limit, and nothing that outlives it."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import time
from typing import NamedTuple

LAST_WORDS = 2000


class Done(NamedTuple):
    """What a call came to: exit status (None: out of time), seconds, stdout and the end of stderr."""

    status: int | None
    seconds: float
    stdout: str
    stderr: str


def call(command: str, limit_s: float, **places: str | list[str]) -> Done:
    """Run a command line with its places filled in; all that it started ends with it."""
    words: list[str] = []
    for word in shlex.split(command):
        value = places.get(word[1:-1]) if word.startswith("{") else None
        words += [word] if value is None else [value] if isinstance(value, str) else value
    if shutil.which("setpriv"):
        words = ["setpriv", "--pdeathsig", "KILL", *words]
    started = time.monotonic()
    process = subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, errors="replace"
    )
    try:
        stdout, stderr = process.communicate(timeout=limit_s)
        status: int | None = process.returncode
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        stdout, stderr = process.communicate()
        status = None
    return Done(status, time.monotonic() - started, stdout, stderr[-LAST_WORDS:])
