"""Real processes that are killed, stopped, doubled or run out of disk: one named error soon, nothing left running."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import (
    Ended,
    eventually,
    finish,
    new_session,
    no_orphans,
    nodes_of,
    one_message,
    start,
    tunefree,
    tunefree_alone,
)
from tunefree_hil.jobs.running.session import SLOW_VARIABLE

pytestmark = pytest.mark.slow
HARD_LIMIT_S = 5.0  # of one that does not answer; a test that waits for ever ends by the patience of `finish`


class Bench:
    """A drive under way in a session of its own."""

    def __init__(self, folder: Path, duration_s: float = 60.0) -> None:
        self.session = new_session()
        self.folder = folder
        self.process = start(
            "drive",
            write_bench(folder, duration_s=duration_s),
            "--session",
            self.session,
            "--out",
            folder / "runs",
            "--json",
        )

    def under_way(self) -> dict[str, int]:
        """Wait until frames are being recorded; the process ids of the nodes."""
        eventually(lambda: list(self.folder.glob("runs/*/episodes/0/*")), what="a log that is being written")
        return nodes_of(self.session)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    one = Bench(tmp_path)
    with no_orphans(one.session):
        yield one
        if one.process.poll() is None:
            one.process.kill()


@pytest.mark.parametrize("victim", ["hub", "ecu", "controller"])
def test_a_killed_process_is_named(bench: Bench, victim: str) -> None:
    os.kill(bench.under_way()[victim], signal.SIGKILL)
    done = finish(bench.process)
    assert done.status == 3
    one_message(done, f"the {victim} process was killed by signal 9", f"{victim}.txt")
    assert [error["code"] for error in done.errors] == ["node_lost"]


@pytest.mark.parametrize("victim", ["ecu", "controller"])
def test_a_process_that_does_not_answer_is_named_at_the_hard_limit(bench: Bench, victim: str) -> None:
    os.kill(bench.under_way()[victim], signal.SIGSTOP)
    done = finish(bench.process)
    assert done.status == 3
    assert done.wall_s > HARD_LIMIT_S - 1.0, "not before its time: the bench had that long to answer"
    assert "Traceback" not in done.words
    assert f"the {victim} did not answer within 5 s" in done.words
    assert len(done.errors) == 1


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 130), (signal.SIGKILL, -9)])
def test_a_drive_that_is_ended_leaves_nothing(bench: Bench, number: int, status: int) -> None:
    bench.under_way()
    bench.process.send_signal(number)
    done = finish(bench.process)
    assert done.status == status and "Traceback" not in done.words


def test_a_full_disk_is_said_with_the_file(tmp_path: Path) -> None:
    """The hub, which writes the logs, may write no file beyond 100 kB from now on."""
    bench = Bench(tmp_path, 15.0)
    with no_orphans(bench.session):
        hub = bench.under_way()["hub"]
        resource.prlimit(hub, resource.RLIMIT_FSIZE, (100_000, 100_000))
        done = finish(bench.process, patience_s=60.0)
    assert done.status == 3
    one_message(done, "vehicle.log")
    assert not list(bench.folder.glob("runs/*/episodes/0/vehicle.log")), "no log that looks whole"


def test_a_disk_that_is_full_from_the_start(tmp_path: Path) -> None:
    """No process of this drive may write a file beyond 1 kB."""
    done = tunefree_alone(
        *("drive", write_bench(tmp_path), "--out", tmp_path / "runs"),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000)),
    )
    assert done.status == 3
    one_message(done, str(tmp_path / "runs"))


class Terminals:
    """Hub, ECU and controller in terminals of their own."""

    def __init__(self, folder: Path) -> None:
        self.session = new_session()
        self.file = write_bench(folder)
        self.out = folder / "runs"
        self.open = {"hub": start("hub", "--session", self.session)}
        for name in ("ecu", "controller"):
            self.open[name] = start(name, self.file, "--session", self.session)

    def drive(self, *more: str) -> Ended:
        return tunefree("drive", self.file, "--session", self.session, "--out", self.out, "--json", *more)

    def interrupt(self, name: str) -> Ended:
        self.open[name].send_signal(signal.SIGINT)
        return finish(self.open[name])


@pytest.fixture
def terminals(tmp_path: Path) -> Iterator[Terminals]:
    one = Terminals(tmp_path)
    with no_orphans(one.session):
        try:
            eventually(lambda: len(nodes_of(one.session)) == 3)
            yield one
        finally:
            for process in one.open.values():
                with contextlib.suppress(ProcessLookupError):
                    process.kill()
                process.communicate()


def closed(process: subprocess.Popen[str]) -> bool:
    return process.poll() is not None


def test_four_terminals(terminals: Terminals) -> None:
    """Two drives one after the other on one bench; then Ctrl-C in each terminal."""
    first, second = terminals.drive("--join"), terminals.drive("--join")
    assert first.status == second.status == 0, first.words + second.words
    assert first.data["hashes"] == second.data["hashes"]

    doubled = tunefree("controller", terminals.file, "--session", terminals.session)
    assert doubled.status == 2
    one_message(doubled, "controller is on the bus already", "another --session")
    doubled = tunefree("hub", "--session", terminals.session)
    assert doubled.status == 2
    one_message(doubled, terminals.session, "already runs here", "--session OTHER")
    taken = terminals.drive()
    assert taken.status == 2
    one_message(taken, "in use by another hub", "--join")
    other = terminals.drive("--join", "--model", "mkz_reference")
    assert other.status == 2
    one_message(other, "simulates mkz_nominal, but mkz_reference is wanted", "start it with --model mkz_reference")
    assert not any(closed(process) for process in terminals.open.values()), "nobody was disturbed"
    assert terminals.drive("--join").data["hashes"] == first.data["hashes"]

    assert [terminals.interrupt(name).status for name in ("controller", "ecu", "hub")] == [130, 130, 0]


def test_nodes_end_when_their_hub_is_gone(terminals: Terminals) -> None:
    assert terminals.drive("--join").status == 0
    assert terminals.interrupt("hub").status == 0
    for name in ("ecu", "controller"):
        done = finish(terminals.open[name])
        assert done.status == 3
        one_message(done, "hub")


def test_a_joined_bench_without_a_controller_is_named(terminals: Terminals, monkeypatch: pytest.MonkeyPatch) -> None:
    assert terminals.drive("--join").status == 0
    terminals.interrupt("controller")
    monkeypatch.setenv(SLOW_VARIABLE, "3")
    done = terminals.drive("--join")
    assert done.status == 3
    one_message(done, "no hello from controller", "tunefree-hil controller")


def test_a_bench_that_is_not_there_cannot_be_joined(tmp_path: Path) -> None:
    session = new_session()
    done = tunefree("drive", write_bench(tmp_path), "--session", session, "--join", "--out", tmp_path / "runs")
    assert done.status == 3
    one_message(done, session, f"tunefree-hil hub --session {session}")
