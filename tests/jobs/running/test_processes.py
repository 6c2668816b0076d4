"""The end of a bench's processes: of each child, and of what it started itself and left behind."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.jobs.command import eventually
from tunefree_hil.jobs.running.processes import STOP_LIMIT_S, Processes

PROGRAM = "sleep 300 & echo $! > pid.part; mv pid.part pid; "


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2][:1] != "Z"
    except OSError:
        return False


@contextmanager
def grandchild(folder: Path, after: str) -> Iterator[tuple[Processes, int]]:
    """A shell as a controller, and the id of the program that it started."""
    processes = Processes(folder / "nodes")
    processes.run("controller", ["sh", "-c", f"cd '{folder}'; {after.format(program=PROGRAM)}"])
    pid = int(eventually(lambda: (folder / "pid").exists() and (folder / "pid").read_text(), what="the program"))
    try:
        yield processes, pid
    finally:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


@pytest.mark.parametrize(
    ("after", "asked"),
    [
        ("{program} wait; true", True),
        ("{program}", True),  # the shell has ended, what it started has not
        ("trap '' TERM; {program} wait; true", False),
    ],
)
def test_the_program_of_a_shell_ends_with_it(tmp_path: Path, after: str, asked: bool) -> None:
    with grandchild(tmp_path, after) as (processes, pid):
        assert alive(pid)
        began_s = time.monotonic()
        processes.stop()
        eventually(lambda: not alive(pid), 2.0, "the end of the program")
        assert asked or time.monotonic() - began_s >= STOP_LIMIT_S, "it is asked before it is killed"
    assert processes.children == []


def test_a_stopped_child_ends_and_one_that_has_ended_is_no_trouble(tmp_path: Path) -> None:
    processes = Processes(tmp_path)
    stopped, _ = processes.run("hub", ["sleep", "300"]), processes.run("ecu", ["true"])
    os.kill(stopped, signal.SIGSTOP)
    processes.stop()
    assert not alive(stopped)
    processes.stop()
