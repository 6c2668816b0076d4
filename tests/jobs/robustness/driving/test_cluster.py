"""A real scheduler and real workers on loopback give the result of one machine, also where one of them ends."""

from __future__ import annotations

import builtins
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.jobs.command import Ended, environment, eventually, finish, one_message, start, tunefree
from tests.jobs.robustness.made_sweep import plan_of, write_tune
from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.jobs.robustness.driving import cluster
from tunefree_hil.jobs.robustness.driving.cluster import drive_on_cluster, import_distributed, require_address

SCHEDULER_S, COMPILED_S = 40.0, 300.0


@contextmanager
def program(*words: Any) -> Iterator[subprocess.Popen[bytes]]:
    """A process of dask, which is killed at the end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *map(str, words)],
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Cluster:
    """A scheduler and workers on loopback."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack, self._port = stack, free_port()
        self.address = f"tcp://127.0.0.1:{self._port}"
        words = ("scheduler", "--host", "127.0.0.1", "--port", self._port, "--no-dashboard", "--no-show")
        self.scheduler = stack.enter_context(program(*words))
        eventually(self._answers, SCHEDULER_S, "the scheduler's port")

    def add_worker(self) -> subprocess.Popen[bytes]:
        words = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1")
        return self._stack.enter_context(program("worker", self.address, *words))

    def _answers(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self._port)) == 0


@pytest.fixture
def loopback() -> Iterator[Cluster]:
    with ExitStack() as stack:
        yield Cluster(stack)


@pytest.fixture(scope="module")
def tune(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tune(tmp_path_factory.mktemp("tune"))


def words(tune: Path, out: Path, *more: Any) -> tuple[Any, ...]:
    return ("robustness", tune, "--roads", "families:140", "--cars", "4", "--out", out, "--json", *more)


@pytest.fixture(scope="module")
def local(tune: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep on this machine that nothing disturbed."""
    out = tmp_path_factory.mktemp("local") / "sweep"
    ended = tunefree(*words(tune, out), patience_s=COMPILED_S)
    assert ended.status in (0, 1), ended.words
    return out


def finished_chunks(out: Path) -> int:
    file = out / "drives.jsonl"
    return len(file.read_text().splitlines()) - 1 if file.is_file() else 0


def drives_by_chunk(out: Path) -> dict[int, Any]:
    chunks = [json.loads(line) for line in (out / "drives.jsonl").read_text().splitlines()[1:]]
    assert len({chunk["chunk"] for chunk in chunks}) == len(chunks)
    return {chunk["chunk"]: chunk["drives"] for chunk in chunks}


def same_result(out: Path, local: Path, ended: Ended) -> None:
    assert ended.status in (0, 1), ended.words
    assert drives_by_chunk(out) == drives_by_chunk(local)
    assert (out / "robustness.json").read_bytes() == (local / "robustness.json").read_bytes()


@pytest.mark.compiled
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_killed_worker_costs_its_chunk_some_time_and_nothing_else(
    tune: Path, local: Path, tmp_path: Path, loopback: Cluster
) -> None:
    first, second = loopback.add_worker(), loopback.add_worker()
    process = start(*words(tune, tmp_path / "o", "--scheduler", loopback.address))
    eventually(lambda: finished_chunks(tmp_path / "o") >= 1, COMPILED_S, "a chunk")
    first.kill()
    same_result(tmp_path / "o", local, finish(process, COMPILED_S))
    assert second.poll() is None and loopback.scheduler.poll() is None


@pytest.mark.compiled
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_killed_scheduler_is_said_and_the_same_command_goes_on_without_it(
    tune: Path, local: Path, tmp_path: Path, loopback: Cluster
) -> None:
    loopback.add_worker()
    out = tmp_path / "o"
    process = start(*words(tune, out, "--scheduler", loopback.address))
    eventually(lambda: finished_chunks(out) >= 1, COMPILED_S, "a chunk")
    loopback.scheduler.kill()
    ended = finish(process, COMPILED_S)
    assert ended.status == 3
    one_message(ended, "the scheduler is lost", "the same command goes on")
    made = finished_chunks(out)
    assert 1 <= made < len(drives_by_chunk(local))
    again = tunefree(*words(tune, out), patience_s=COMPILED_S)
    assert f"{made} of {len(drives_by_chunk(local))} chunks are driven already" in again.words
    same_result(out, local, again)


@pytest.mark.compiled
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_sweep_that_was_killed_goes_on_to_the_same_result(tune: Path, local: Path, tmp_path: Path) -> None:
    out = tmp_path / "o"
    for chunks in (1, 3):
        process = start(*words(tune, out))
        eventually(lambda wanted=chunks: finished_chunks(out) >= wanted, COMPILED_S, "a chunk")  # type: ignore[misc]
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
    same_result(out, local, tunefree(*words(tune, out), patience_s=COMPILED_S))


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_said(tune: Path, tmp_path: Path) -> None:
    address = f"tcp://127.0.0.1:{free_port()}"
    ended = tunefree(*words(tune, tmp_path / "o", "--scheduler", address), patience_s=SCHEDULER_S)
    assert ended.status == 3
    one_message(ended, f"no scheduler answers at {address}", "dask scheduler --host 127.0.0.1")


@pytest.mark.slow
def test_a_scheduler_without_workers_is_said(
    tmp_path: Path, loopback: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "CRITERIA", cluster.CRITERIA._replace(worker_s=1.0, count_s=0.2))
    plan = plan_of(tmp_path, 3)
    with pytest.raises(BenchError) as caught:
        list(drive_on_cluster(plan, [0], loopback.address))
    assert caught.value.code == "no_workers" and f"dask worker {loopback.address}" in caught.value.hint


@pytest.mark.parametrize("address", ["", "host", "host:1", "tcp://host", "http://host:1", "tcp://:1", "tcp://h:1/x"])
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(InputError) as caught:
        require_address(address)
    assert caught.value.key == "--scheduler"


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:8786", "tls://bench-7.local:1", "tcp://[::1]:8786"])
def test_addresses_of_schedulers(address: str) -> None:
    require_address(address)


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def lacking(name: str, *more: Any) -> Any:
        if name == "distributed":
            raise ImportError(name)
        return real(name, *more)

    monkeypatch.setattr(builtins, "__import__", lacking)
    with pytest.raises(InputError) as caught:
        import_distributed()
    assert caught.value.code == "no_distributed" and "[cluster]" in caught.value.hint
