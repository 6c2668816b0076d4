"""Real processes: a study that is killed again and again, one that is interrupted, and the dashboard on its file."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.tune.drive_study import settings
from tests.tune.sampler_cases import CASES
from tunefree_hil.tune.study import Trial, open_study, read_study

ROOT = Path(__file__).resolve().parents[2]
TRIALS, SLEEP_S = 22, 0.1  # asleep for most of a trial: kills mostly fall into an evaluation
pytestmark = pytest.mark.slow


def start(path: Path, sampler: str, sleep_s: float = SLEEP_S) -> subprocess.Popen[str]:
    arguments = [str(path), sampler, str(TRIALS), str(sleep_s)]
    return subprocess.Popen(
        [sys.executable, "-m", "tests.tune.drive_study", *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def facts(path: Path) -> list[Trial]:
    """The trials without Optuna's number, which a kill shifts."""
    with read_study(path) as study:
        return [trial._replace(number=0) for trial in study.trials()]


def failures(path: Path) -> list[Trial]:
    with read_study(path) as study:
        return study.failures()


def finish(path: Path, sampler: str) -> None:
    process = start(path, sampler, sleep_s=0.0)
    _, words = process.communicate(timeout=240)  # torch takes seconds to import
    assert process.returncode == 0, words


def listen(process: subprocess.Popen[str], word: str, times: int) -> None:
    """Wait until it has said `word` so many times."""
    assert process.stdout
    while times:
        said = process.stdout.readline()
        assert said, "it ended"
        times -= said.startswith(word)


def kill_after(process: subprocess.Popen[str], word: str, times: int, rest_s: float = 0.0) -> None:
    """Wait until it has said `word` so many times and a little more, and kill it as the system would."""
    listen(process, word, times)
    time.sleep(rest_s)
    process.kill()
    process.communicate(timeout=60)
    assert process.returncode == -signal.SIGKILL


@pytest.mark.timeout(600)  # five processes, each of which imports torch for a Gaussian process
@pytest.mark.parametrize("sampler", CASES)
def test_a_study_killed_and_resumed_gives_the_same_trials(tmp_path: Path, sampler: str) -> None:
    finish(tmp_path / "whole.db", sampler)
    chance = np.random.default_rng([7, len(sampler)])
    cut = tmp_path / "cut.db"
    kill_after(start(cut, sampler, sleep_s=2.0), "evaluating", 2)  # in an evaluation, however busy the machine is
    for _ in range(2):
        times, rest_s = int(chance.integers(1, 4)), float(chance.uniform(0.0, SLEEP_S))
        kill_after(start(cut, sampler), "filled", times, rest_s)
    assert len(facts(cut)) < TRIALS
    assert failures(cut), "no kill fell into an evaluation"
    finish(cut, sampler)
    assert facts(cut) == facts(tmp_path / "whole.db")
    assert [trial.slot for trial in facts(cut)] == list(range(TRIALS))
    assert {trial.error for trial in failures(cut)} == {"interrupted"}


def test_kills_while_the_file_is_made(tmp_path: Path) -> None:
    path = tmp_path / "study.db"
    chance = np.random.default_rng(8)
    for _ in range(4):
        process = start(path, "random")
        while not (tmp_path / "study.db.part").exists() and not path.exists() and process.poll() is None:
            time.sleep(0.002)
        kill_after(process, "", 0, float(chance.uniform(0.0, 0.4)))
    finish(path, "random")
    finish(tmp_path / "whole.db", "random")
    assert facts(path) == facts(tmp_path / "whole.db")


def test_control_c_tells_fail_and_ends_at_once(tmp_path: Path) -> None:
    path = tmp_path / "study.db"
    process = start(path, "tpe_independent", sleep_s=1.5)
    listen(process, "evaluating", 3)
    process.send_signal(signal.SIGINT)
    _, words = process.communicate(timeout=30)
    assert "KeyboardInterrupt" in words
    assert [(trial.slot, trial.error) for trial in failures(path)] == [(2, "interrupted")]
    assert len(facts(path)) == 2
    finish(path, "tpe_independent")
    finish(tmp_path / "whole.db", "tpe_independent")
    assert facts(path) == facts(tmp_path / "whole.db")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def dashboard(tmp_path: Path) -> Iterator[str]:
    """The address of a dashboard on a study, one trial of which was interrupted."""
    path = tmp_path / "study.db"
    kill_after(start(path, "random", sleep_s=1.5), "evaluating", 3)
    finish(path, "random")
    port = free_port()
    command = [str(Path(sys.executable).with_name("optuna-dashboard")), f"sqlite:///{path}"]
    options = ["--host", "127.0.0.1", "--port", str(port)]
    if not Path(command[0]).is_file():
        pytest.skip("optuna-dashboard is not installed")
    process = subprocess.Popen(
        [*command, *options], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env={**os.environ, "NO_PROXY": "*"}
    )
    yield f"http://127.0.0.1:{port}"
    process.terminate()
    process.wait(timeout=30)


def get(address: str, patience_s: float = 40.0) -> bytes:
    """A page, as soon as the server is up."""
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    end_s = time.monotonic() + patience_s
    while True:
        try:
            with opener.open(address, timeout=10.0) as page:
                return page.read()
        except (ConnectionError, urllib.error.URLError):
            if time.monotonic() > end_s:
                raise
            time.sleep(0.3)


def test_the_dashboard_opens_the_file(dashboard: str, tmp_path: Path) -> None:
    assert b"<html" in get(f"{dashboard}/dashboard").lower()
    (study,) = json.loads(get(f"{dashboard}/api/studies"))["study_summaries"]
    shown = json.loads(get(f"{dashboard}/api/studies/{study['study_id']}?after=0"))
    states = [trial["state"] for trial in shown["trials"]]
    assert states.count("Complete") == TRIALS
    assert states.count("Fail") == 1
    ours = facts(tmp_path / "study.db")
    theirs = [trial for trial in shown["trials"] if trial["state"] == "Complete"]
    assert [trial["values"][0] for trial in theirs] == pytest.approx([np.log(trial.score) for trial in ours])
    with open_study(tmp_path / "study.db", settings("random")) as study:  # and both can have it open
        assert len(study.trials()) == TRIALS
