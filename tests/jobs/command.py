"""Runs `tunefree-hil` as a person would, in a process of its own, and looks for what it leaves behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

PATIENCE_S = 40.0
ORPHANS_S = 8.0  # until the last process of a session has ended


class Ended(NamedTuple):
    """How a command ended; `words` is its stderr, `data`, `errors` what --json said."""

    status: int
    words: str
    data: dict[str, Any]
    errors: list[dict[str, str]]
    wall_s: float


def environment(**more: str) -> dict[str, str]:
    """Of a command: nodes un-jitted, colourless, few threads."""
    return {**os.environ, "TERM": "dumb", "OMP_NUM_THREADS": "1", **more}


def start(*arguments: Any, cwd: Path | None = None, **options: Any) -> subprocess.Popen[str]:
    """Start a command; read it with `finish`."""
    return subprocess.Popen(
        [sys.executable, "-m", "tunefree_hil", *map(str, arguments)],
        cwd=cwd,
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **options,
    )


def finish(process: subprocess.Popen[str], patience_s: float = PATIENCE_S) -> Ended:
    """Wait for a command; it is killed, and an AssertionError raised, when it does not end."""
    started = time.monotonic()
    try:
        out, words = process.communicate(timeout=patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        out, words = process.communicate()
        raise AssertionError(f"it did not end within {patience_s:g} s; it said:\n{words}") from None
    last = json.loads(out.splitlines()[-1]) if out.strip().endswith("}") else {}
    wall_s = time.monotonic() - started
    return Ended(process.returncode, words, last.get("data", {}), last.get("errors", []), wall_s)


def tunefree(*arguments: Any, patience_s: float = PATIENCE_S, cwd: Path | None = None, **options: Any) -> Ended:
    """Run a command to its end."""
    return finish(start(*arguments, cwd=cwd, **options), patience_s)


def tunefree_alone(*arguments: Any, within_s: float = ORPHANS_S, **options: Any) -> Ended:
    """Run a command to its end in a session of its own, of which nothing is left `within_s` later."""
    session = new_session()
    with no_orphans(session, within_s):
        return tunefree(*arguments, "--session", session, **options)


def new_session() -> str:
    """A session name of its own, by which its processes are found."""
    return f"test-{uuid.uuid4().hex[:10]}"


class Running(NamedTuple):
    """A process of a bench: its id and what it is (hub, ecu, controller, drive ...)."""

    pid: int
    command: str


def processes_of(session: str) -> list[Running]:
    """Living processes whose command line names the session (also '<session>-verify' and the like)."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
            state = (folder / "stat").read_text().rpartition(") ")[2][:1]
        except OSError:  # it ended while we looked
            continue
        if state != "Z" and "tunefree_hil" in words and any(word.startswith(session) for word in words):
            found.append(Running(int(folder.name), words[words.index("tunefree_hil") + 1]))
    return found


def nodes_of(session: str) -> dict[str, int]:
    """Process ids of hub, ecu and controller."""
    return {one.command: one.pid for one in processes_of(session) if one.command in ("hub", "ecu", "controller")}


def eventually(true: Callable[[], Any], patience_s: float = 20.0, what: str = "it") -> Any:
    """Wait until something holds, and give it; an AssertionError when it never does."""
    deadline_s = time.monotonic() + patience_s
    while not (found := true()):
        assert time.monotonic() < deadline_s, f"{what} never came true"
        time.sleep(0.01)
    return found


@contextmanager
def no_orphans(session: str, within_s: float = ORPHANS_S) -> Iterator[None]:
    """Asserts that soon after the `with` no process of the session is alive; kills what is, by id."""
    try:
        yield
        eventually(lambda: not processes_of(session), within_s, f"the end of all processes of {session}")
    finally:
        for left in processes_of(session):
            os.kill(left.pid, signal.SIGKILL)


def one_message(ended: Ended, *parts: str) -> None:
    """Assert that the command gave exactly one error, without a traceback, that names all of `parts`."""
    assert "Traceback" not in ended.words, ended.words
    lines = [line for line in ended.words.splitlines() if line.startswith("error:")]
    assert len(lines) == 1, ended.words
    for part in parts:
        assert part in ended.words, f"{part!r} is not in:\n{ended.words}"
