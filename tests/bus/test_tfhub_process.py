"""A hub as a process: it starts, says what is wrong, ends with its owner and leaves no orphan."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.bus.tfhub_help import PATIENCE_S, ROOT, child, eventually, frame
from tools.measures._hub_members import measure_hub
from tools.measures._hub_process import start_hub
from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bus.tfhub import address
from tunefree_hil.bus.tfhub.owner import Owner
from tunefree_hil.bus.tfhub.plugin import HubBus

pytestmark = pytest.mark.slow


@contextmanager
def hub_program(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "tunefree_hil.bus.tfhub", *arguments]
    process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("tcp", [False, True])
def test_a_standalone_hub_lives_until_a_signal(tmp_path: Path, number: signal.Signals, tcp: bool) -> None:
    session = str(tmp_path / "hub")
    more = ["--tcp"] if tcp else []
    with hub_program("--session", session, "--standalone", "--vehicle-log-name", "can7", *more) as process:
        assert process.stderr is not None
        first = process.stderr.readline()
        assert f"{session} runs, pid {process.pid}: vehicle" in first
        with HubBus(f"{session}/veh?role=member") as bus:
            assert bus.welcome.log_name == "can7"
            bus.send_frames([frame(1)])
        process.send_signal(number)
        assert process.wait(PATIENCE_S) == 0
        assert f"{session} ends: it was stopped by a signal ({number.name})" in process.stderr.read()
    assert not Path(session).exists()


def test_a_hub_with_an_owner_leaves_ctrl_c_to_it(tmp_path: Path) -> None:
    hub = start_hub(str(tmp_path / "hub"))
    hub.process.send_signal(signal.SIGINT)
    hub.owner.start_log({"vehicle": tmp_path / "x.log"})
    assert hub.owner.stop_log() == {"vehicle": 0}  # it is still there, and its log can be finished
    hub.close()
    assert hub.process.returncode == 0


def test_the_second_hub_says_how_to_go_on(tmp_path: Path) -> None:
    session = str(tmp_path / "hub")
    with start_hub(session) as hub:
        with hub_program("--session", session) as process:
            assert process.wait(PATIENCE_S) == 2
            assert process.stderr is not None
            said = process.stderr.read()
        assert f"a hub named {session} already runs here, pid {hub.process.pid}" in said
        assert "--session OTHER" in said and "Traceback" not in said
        with pytest.raises(InputError, match=f"already runs here, pid {hub.process.pid}"):
            start_hub(session)
        assert hub.owner.stats().peers  # unharmed


def test_a_hub_that_cannot_start_is_told(tmp_path: Path) -> None:
    folder = tmp_path / "open"
    folder.mkdir()
    folder.chmod(0o755)
    with pytest.raises(InputError, match="yours alone"):
        start_hub(str(folder))


def test_a_killed_hub_is_replaced(tmp_path: Path) -> None:
    session = str(tmp_path / "hub")
    transports: tuple[address.Transport, ...] = ("unix", "tcp", "unix")
    for transport in transports:
        hub = start_hub(session, transport=transport)
        hub.process.kill()
        hub.process.wait()
        assert (Path(session) / address.HUB_FILE).exists()
        with pytest.raises(BenchError, match="no hub listens") as raised:
            Owner(session)
        assert raised.value.code == "no_hub"
        hub.close()
    with start_hub(session), HubBus(f"{session}/veh"):
        assert not (Path(session) / address.TOKEN_FILE).exists(), "the token of a hub that is gone"


OWN = """
import sys, time
from tools.measures._hub_process import start_hub
hub = start_hub(sys.argv[1])
hub.owner.start_log({"vehicle": sys.argv[2]})
print(hub.process.pid, flush=True)
time.sleep(60)
"""


def test_a_killed_owner_leaves_no_orphan_and_a_readable_log(tmp_path: Path) -> None:
    session, log = str(tmp_path / "hub"), tmp_path / "x.log"
    with child(OWN, session, str(log)) as process:
        assert process.stdout is not None
        pid = int(process.stdout.readline())
        with HubBus(f"{session}/veh?role=member", name="a") as bus:
            bus.send_frames([frame(number) for number in range(10)])
            with HubBus(f"{session}/veh") as watcher:  # the frames are routed when this one is let in
                assert watcher.state.name == "ACTIVE"
            process.kill()
            with pytest.raises(BenchError, match=r"its owner owner-\d+ is gone"):
                bus.recv(PATIENCE_S)
    eventually(lambda: not _runs(pid))
    assert not Path(session).exists() and not log.exists()
    assert len(Path(f"{log}.part").read_text().splitlines()) == 10


def _runs(pid: int) -> bool:
    """True while a process is more than a corpse that nobody has buried."""
    try:
        os.kill(pid, 0)
        state = Path(f"/proc/{pid}/stat")
        return not state.exists() or state.read_text().rpartition(")")[2].split()[0] != "Z"
    except (ProcessLookupError, FileNotFoundError):
        return False


def test_a_hub_imports_neither_python_can_nor_cantools() -> None:
    names = ("can", "cantools", "numpy")
    code = f"import sys, tunefree_hil.bus.tfhub.server.serve; print([name for name in {names} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "[]", done.stderr


def test_the_plugin_does_not_import_cantools() -> None:
    code = "import sys, can; can.Bus; from tunefree_hil.bus import HubBus; print('cantools' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "False", done.stderr


@pytest.mark.parametrize("transport", ["unix", "tcp"])
def test_measure(transport: address.Transport) -> None:
    found = measure_hub(rounds=100, transport=transport)
    assert set(found) == {
        "rounds",
        "round_trip_p50_us",
        "round_trip_p99_us",
        "burst_frames_per_s",
        "lockstep_tick_p50_us",
        "lockstep_tick_p99_us",
    }
    assert 0.0 < found["round_trip_p50_us"] <= found["round_trip_p99_us"]
    assert 0.0 < found["lockstep_tick_p50_us"] <= found["lockstep_tick_p99_us"]
    assert found["burst_frames_per_s"] > 0.0


def test_hubs_beside_each_other(tmp_path: Path) -> None:
    """Parallel trials have hubs of their own, which share nothing."""
    with start_hub(str(tmp_path / "one")) as one, start_hub(str(tmp_path / "two")) as two:
        a, b = HubBus(f"{one.vehicle}?role=member&name=a"), HubBus(f"{two.vehicle}?role=member&name=a")
        with a, b:
            a.send_frames([frame(1)])
            time.sleep(0.05)
            assert b.recv(0.0) is None and two.owner.stats().frames["vehicle"] == 0
