"""The C controller of tools/: compiled, met over the hub's TCP, driven and tuned by the runner as any other."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import Ended, eventually, finish, new_session, no_orphans, start, tunefree
from tunefree_hil.base.errors import BenchError
from tunefree_hil.bus.tfhub import address
from tunefree_hil.tune.study import read_study

ROOT = Path(__file__).resolve().parents[2]
BENCH = ROOT / "bench_configs" / "mkz_steer.toml"
PATIENCE_S = 100.0
HELD_S = 0.08  # less than the vehicle's patience with a command (0.1 s)
COMMAND_IDS = (0x060, 0x062, 0x064, 0x066, 0x068)
ORPHANS_S = 15.0  # a hub that nobody came to own ends after 10 s, and its nodes with it
OWN = """[controller]
command = ["{build}/controller", "{{bus}}", "{{bench}}", "{{paths}}", "{{token_file}}"]
[controller.parameters]
"pursuit.look_ahead_s" = 0.8
"pi.kp" = 1.0
"""
SEARCHED = """parameters = [
  {{ name = "pursuit.look_ahead_s", low = 0.2, high = 2.0 }},
  {{ name = "{second}", low = 0.1, high = 5.0 }},
]"""

pytestmark = [
    pytest.mark.foreign,
    pytest.mark.timeout(400),
    pytest.mark.skipif(
        shutil.which("cc") is None or shutil.which("make") is None, reason="needs make and a C compiler"
    ),
]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("foreign")
    words = ["make", "-C", str(ROOT / "tools" / "foreign_controller"), f"OUT={folder}", f"PYTHON={sys.executable}"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


@contextmanager
def joined(built: Path, folder: Path) -> Iterator[str]:
    """A session with a hub over TCP, the ECU and the C controller, each started by hand."""
    session = new_session()
    exported = tunefree("scenarios", "--vehicle", ROOT / "dbc" / "mkz_bywire", "--export", folder / "paths")
    assert exported.status == 0, exported.words
    running: list[subprocess.Popen[str]] = []
    with no_orphans(session):
        try:
            running.append(start("hub", "--session", session, "--transport", "tcp"))
            info = _hub_of(session)
            own = [str(built / "controller"), info.addresses["vehicle"], info.addresses["bench"], str(folder / "paths")]
            running.append(start("ecu", BENCH, "--session", session))
            running.append(subprocess.Popen([*own, info.token_file], stderr=subprocess.PIPE, text=True))
            yield session
        finally:
            for process in reversed(running):
                process.kill()
                process.communicate()


def _hub_of(session: str) -> address.HubInfo:
    limit = time.monotonic() + 20.0
    while True:
        try:
            return address.read_hub(session)
        except BenchError:
            if time.monotonic() > limit:
                raise
            time.sleep(0.1)


def test_it_joins_a_bench_of_four_terminals(built: Path, tmp_path: Path) -> None:
    with joined(built, tmp_path) as session:
        words = ("drive", BENCH, "--scenario", "stop_and_go", "--session", session, "--join", "--json")
        done = tunefree(*words, "--out", tmp_path / "runs", patience_s=PATIENCE_S)
    assert done.status == 0, done.words
    graded = done.data["scenarios"]["stop_and_go"]
    assert graded["outcome"] == "finished"
    assert graded["score"] < 2.0
    log = next((tmp_path / "runs").rglob("bench.log")).read_text()
    assert len(re.findall(r"6E1#", log)) == 2 * len(re.findall(r"6E0#", log))  # each tick has the DONE of both


class Realtime(NamedTuple):
    """A bench file with the C program, and what a drive of it in lockstep came to."""

    bench: Path
    lockstep: Ended

    def start(self, folder: Path, *more: str) -> subprocess.Popen[str]:
        """The same drive in real time."""
        return start("drive", self.bench, "--realtime", "--out", folder, "--json", *more)


@pytest.fixture(scope="module")
def realtime(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Realtime:
    folder = tmp_path_factory.mktemp("realtime")
    bench = write_bench(folder, duration_s=4.0, more=OWN.format(build=built))
    done = tunefree("drive", bench, "--out", folder / "lockstep", "--json", patience_s=PATIENCE_S)
    assert done.status == 0, done.words
    return Realtime(bench, done)


def test_in_real_time_it_drives_as_in_lockstep(realtime: Realtime, tmp_path: Path) -> None:
    done = finish(realtime.start(tmp_path), PATIENCE_S)
    verdict, graded = done.data["realtime"], done.data["scenarios"]["tiny"]
    assert done.status == (0 if verdict["valid"] else 4), done.words
    assert graded["outcome"] == "finished"
    peak_m = graded["metrics"]["lateral_err_peak"]
    assert peak_m == pytest.approx(realtime.lockstep.data["scenarios"]["tiny"]["metrics"]["lateral_err_peak"], abs=0.05)
    assert set(verdict["nodes"]) == {"ecu", "bus"}, "it says nothing of its cycles: its frames are judged"
    logs = [next(folder.rglob("vehicle.log")) for folder in (tmp_path, realtime.bench.parent / "lockstep")]
    sent, before = ({one: log.read_text().count(f" {one:03X}#") for one in COMMAND_IDS} for log in logs)
    assert all(count > 0 for count in before.values())
    assert sent == before, "each command frame, once"


def test_held_up_in_real_time_it_is_noticed(realtime: Realtime, built: Path, tmp_path: Path) -> None:
    process = realtime.start(tmp_path)
    try:
        eventually(lambda: any(log.stat().st_size for log in tmp_path.rglob("vehicle.log.part")), PATIENCE_S, "a drive")
        (pid,) = living(built / "controller")
        os.kill(pid, signal.SIGSTOP)
        time.sleep(HELD_S)
        os.kill(pid, signal.SIGCONT)
    except BaseException:
        process.kill()
        raise
    done = finish(process, PATIENCE_S)
    assert done.status == 4, done.words
    assert "NOT real time" in done.data["sentence"]
    assert done.data["realtime"]["nodes"]["bus"]["max_ms"] > 1e3 * HELD_S - 20.0


def test_it_says_what_is_wrong(built: Path) -> None:
    controller = str(built / "controller")
    assert subprocess.run([controller], capture_output=True, check=False).returncode == 2
    for where, status in (("tcp:127.0.0.1:9", 3), ("socketcan:nothing0", 1), ("pigeon:1", 1)):
        done = subprocess.run([controller, where, where, "."], capture_output=True, text=True, check=False)
        assert done.returncode == status
        assert "controller: " in done.stderr


def living(program: Path) -> list[int]:
    """Processes that run this file."""
    found = []
    for path in Path("/proc").glob("[0-9]*/exe"):
        try:
            if os.readlink(path) == str(program):
                found.append(int(path.parent.name))
        except OSError:  # it ended while we looked
            continue
    return found


class Tune:
    """A tune of two of its parameters over a scenario of 3 s, to be run again and again on the same folder."""

    def __init__(self, built: Path, folder: Path, second: str = "pi.kp") -> None:
        self.built = built
        path = write_bench(folder, duration_s=3.0, more=OWN.format(build=built))
        path.write_text(path.read_text().replace('set = "mrac"', SEARCHED.format(second=second)))
        self.out = folder / "runs"
        self.words = ("tune", path, "--out", self.out, "--json")

    def run(self, *more: str, kill_after: str = "") -> Ended:
        """Run it; killed once a file of the run that fits `kill_after` is there. Nothing of it may stay."""
        session = new_session()
        with no_orphans(session, ORPHANS_S):
            process = start(*self.words, *more, "--session", session)
            if kill_after:
                eventually(lambda: list(self.out.glob(kill_after)), PATIENCE_S, kill_after)
                process.send_signal(signal.SIGKILL)
            done = finish(process, PATIENCE_S)
        eventually(lambda: not self.controllers(), ORPHANS_S, "the end of the C controllers")
        return done

    def controllers(self) -> list[int]:
        """Living processes of the C program."""
        return living(self.built / "controller")

    @property
    def folder(self) -> Path:
        (run,) = self.out.glob("*")
        return run

    def trials(self) -> list[tuple[int, dict[str, float], float]]:
        with read_study(self.folder / "study.db") as study:
            return [(trial.slot, trial.parameters, trial.score) for trial in study.trials()]


@pytest.fixture(scope="module")
def calm(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Tune:
    """Three trials that nobody disturbed, verified."""
    tune = Tune(built, tmp_path_factory.mktemp("calm"))
    done = tune.run()
    assert done.status == 0, done.words
    assert set(done.data["baselines"]) == {"given"} and done.data["ratio"] <= 1.0
    assert done.data["verify"]["scores"]["tuned"] == done.data["best"]["score"], "here it verifies on the same model"
    return tune


def test_its_own_parameters_are_tuned(calm: Tune) -> None:
    trials = calm.trials()
    assert [set(parameters) for _, parameters, _ in trials] == 3 * [{"pursuit.look_ahead_s", "pi.kp"}]
    first = trials[0][1]
    assert first == pytest.approx({"pursuit.look_ahead_s": 0.8, "pi.kp": 1.0}), "it begins with the given values"
    assert len({score for _, _, score in trials}) == 3, "the values arrive at the controller"
    best = tomllib.loads((calm.folder / "best.toml").read_text())
    assert best["tuned"] == min(trials, key=lambda trial: trial[2])[1]
    assert best["tuned"].items() <= best["parameters"].items()


def test_the_winner_is_driven_again_to_the_bit(calm: Tune) -> None:
    again = tunefree("replay", calm.folder, "--verify", "--json", patience_s=PATIENCE_S)
    assert again.status == 0 and again.data["episodes"] >= 2, again.words
    verified = tunefree("verify", calm.folder, "--json", patience_s=PATIENCE_S)
    assert verified.data["scores"]["tuned"] == pytest.approx(min(score for _, _, score in calm.trials()), abs=0.0)


def test_killed_it_goes_on_to_the_same_trials(calm: Tune, tmp_path: Path) -> None:
    tune = Tune(calm.built, tmp_path)
    assert tune.run("--no-verify", kill_after="*/episodes/1/episode.json").status == -signal.SIGKILL
    done = tune.run("--no-verify")
    assert done.status == 0, done.words
    assert tune.trials() == calm.trials()


def test_a_parameter_that_it_does_not_have_is_refused(built: Path, tmp_path: Path) -> None:
    done = Tune(built, tmp_path, second="pi.kd").run()
    assert done.status == 2
    assert "did not announce the parameter pi.kd" in done.words and "pi.station_kp" in done.words
