"""The C controller of tools/: compiled, met over the hub's TCP, driven by the runner as any other."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tunefree_hil.base.errors import BenchError
from tunefree_hil.bus.tfhub import address

ROOT = Path(__file__).resolve().parents[2]
BENCH = ROOT / "bench_configs" / "mkz_steer.toml"
COMMAND = [sys.executable, "-m", "tunefree_hil"]

pytestmark = [
    pytest.mark.foreign,
    pytest.mark.skipif(
        shutil.which("cc") is None or shutil.which("make") is None, reason="needs make and a C compiler"
    ),
]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("foreign")
    words = ["make", "-C", str(ROOT / "tools" / "foreign_controller"), f"OUT={folder}", f"PYTHON={sys.executable}"]
    subprocess.run(words, check=True, capture_output=True)
    paths = ["scenarios", "--vehicle", str(ROOT / "dbc" / "mkz_bywire"), "--export", str(folder / "paths")]
    subprocess.run([*COMMAND, *paths], check=True, capture_output=True)
    return folder


@pytest.fixture
def bench(built: Path) -> Iterator[str]:
    """A session with a hub over TCP, the ECU and the C controller."""
    session = f"test-foreign-{os.getpid()}"
    hub = [*COMMAND, "hub", "--session", session, "--transport", "tcp"]
    running = [subprocess.Popen(hub, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)]
    try:
        info = _hub_of(session)
        own = [str(built / "controller"), info.addresses["vehicle"], info.addresses["bench"], str(built / "paths")]
        ecu = [*COMMAND, "ecu", str(BENCH), "--session", session]
        for words in (ecu, [*own, info.token_file]):
            running.append(subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
        yield session
    finally:
        for process in reversed(running):
            process.kill()
            process.wait()


def _hub_of(session: str) -> address.HubInfo:
    limit = time.monotonic() + 20.0
    while True:
        try:
            return address.read_hub(session)
        except BenchError:
            if time.monotonic() > limit:
                raise
            time.sleep(0.1)


def test_it_drives_a_scenario(bench: str, tmp_path: Path) -> None:
    words = ["drive", str(BENCH), "--scenario", "stop_and_go", "--session", bench, "--join", "--json"]
    done = subprocess.run([*COMMAND, *words, "--out", str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    graded = answer["data"]["scenarios"]["stop_and_go"]
    assert graded["outcome"] == "finished"
    assert graded["score"] < 2.0
    log = next(tmp_path.rglob("bench.log")).read_text()
    assert len(re.findall(r"6E1#", log)) == 2 * len(re.findall(r"6E0#", log))  # each tick has the DONE of both


def test_it_says_what_is_wrong(built: Path) -> None:
    controller = str(built / "controller")
    assert subprocess.run([controller], capture_output=True, check=False).returncode == 2
    for where in ("tcp:127.0.0.1:9", "socketcan:nothing0", "pigeon:1"):
        done = subprocess.run([controller, where, where, "."], capture_output=True, text=True, check=False)
        assert done.returncode == 3
        assert "controller: " in done.stderr
