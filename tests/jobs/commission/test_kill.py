"""A real commission that is killed -9 in every stage, the report too: it goes on, leaves no process, ends the same."""

from __future__ import annotations

import hashlib
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import Ended, environment, eventually, finish, start
from tunefree_hil.jobs.commission.plan import NAMES
from tunefree_hil.tune.study import read_study

pytestmark = [pytest.mark.slow, pytest.mark.learning, pytest.mark.timeout(3600)]
PATIENCE_S = 900.0  # of a whole commission: its kernels may have to be compiled
ORPHANS_S = 15.0  # a hub that nobody came to own ends after 10 s, and its nodes with it
# A short and slow collection, somewhat faster than the drive, one step of training, two trials over the bus.
SMALL = ("--quota-s", 3, "--top-mps", 5, "--area-m", 120, "--minutes", 0.001, "--trials", 2, "--backend", "bus")
DIES_IN_REPORT = """
import os, signal, sys
from tunefree_hil.cli.entry import run
from tunefree_hil.jobs.commission import report as commission_report
commission_report.write_text = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
run(sys.argv[1:])
"""


class Commission:
    """One command, to be run again and again on the same folder."""

    def __init__(self, folder: Path) -> None:
        self.out = folder / "c"
        bench = write_bench(folder)
        self.words = ("commission", "mkz_bywire", "--bench", bench, "--out", self.out, *SMALL, "--json")

    def whole(self) -> Ended:
        """Run it to its end."""
        return finish(start(*self.words), PATIENCE_S)

    def killed(self, at_work: Callable[[], Any]) -> None:
        """Run it until it is at work, kill it, and see that all it had started ends by itself."""
        process = start(*self.words)
        try:
            eventually(lambda: process.poll() is not None or at_work(), PATIENCE_S, "the work")
            started = descendants(process.pid)
        finally:
            process.kill()
        assert finish(process).status == -signal.SIGKILL
        eventually(lambda: not [one for one in started if alive(one)], ORPHANS_S, "the end of all that it had started")

    def killed_in_its_report(self) -> None:
        """Run it to the moment in which it would write its page."""
        words = [sys.executable, "-c", DIES_IN_REPORT, *map(str, self.words)]
        process = subprocess.Popen(words, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert finish(process, PATIENCE_S).status == -signal.SIGKILL

    @property
    def record(self) -> dict[str, Any]:
        path = self.out / "commission.json"
        return json.loads(path.read_text()) if path.is_file() else {"spent_s": {}, "stages": {}}

    @property
    def logs(self) -> dict[str, str]:
        logs = sorted((self.out / "collect" / "logs").glob("*.log"))
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in logs}

    @property
    def models(self) -> dict[str, str]:
        return {name: (self.out / name / "model.toml").read_text() for name in ("physics", "model")}

    @property
    def trials(self) -> list[tuple[int, dict[str, float], float]]:
        (path,) = self.out.glob("tune/*/study.db")
        with read_study(path) as study:
            return [(trial.slot, trial.parameters, trial.score) for trial in study.trials()]

    def arrays(self, name: str) -> dict[str, Any]:
        """Of a .npz, but for texts about it."""
        with np.load(self.out / name) as archive:
            return {key: archive[key] for key in archive.files if archive[key].dtype.kind == "f"}


class Started(tuple[int, str]):
    """A process: its id, and when the kernel started it, so that another one of the same id is not taken for it."""


def descendants(pid: int) -> list[Started]:
    """All that a process has started, and all that those have."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = path.read_text().rpartition(") ")[2].split()
        except OSError:  # it ended while we looked
            continue
        found[int(path.parent.name)] = int(words[1]), words[19]
    below, some = [], {pid}
    while some:
        some = {one for one, (parent, _) in found.items() if parent in some}
        below += [Started((one, found[one][1])) for one in some]
    return below


def alive(one: Started) -> bool:
    """Whether a process still runs."""
    try:
        words = Path(f"/proc/{one[0]}/stat").read_text().rpartition(") ")[2].split()
    except OSError:
        return False
    return words[0] != "Z" and words[19] == one[1]


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> Commission:
    """One that nobody disturbed."""
    commission = Commission(tmp_path_factory.mktemp("calm"))
    done = commission.whole()
    assert done.status in (0, 1) and set(done.data["stages"]) == set(NAMES), done.words
    return commission


def test_killed_in_every_stage_it_ends_the_same(calm: Commission, tmp_path: Path) -> None:
    commission = Commission(tmp_path)
    for name in NAMES:
        commission.killed(at_work(commission, name))
        assert list(commission.record["stages"]) == sorted(NAMES[: NAMES.index(name)])
    commission.killed_in_its_report()
    assert set(commission.record["stages"]) == set(NAMES) and not (commission.out / "report.md").exists()
    done = commission.whole()
    assert done.status in (0, 1) and done.words.count("done before") == len(NAMES), done.words
    assert set(commission.record["sessions"].values()) == {2}
    assert commission.logs == calm.logs and commission.models == calm.models
    for name in ("model/plant.npz", "map/calibration.npz"):
        mine, its = commission.arrays(name), calm.arrays(name)
        assert mine.keys() == its.keys() and all(np.array_equal(mine[key], its[key]) for key in mine)
    assert commission.trials == calm.trials
    verified = [one.record["stages"]["verify"]["result"] for one in (commission, calm)]
    assert verified[0]["scores"] == verified[1]["scores"]
    assert not list(commission.out.glob("part-*"))
    pictures = [line for line in (commission.out / "report.md").read_text().splitlines() if line.startswith("![")]
    assert len(pictures) == sum(line.startswith("![") for line in (calm.out / "report.md").read_text().splitlines())
    assert len(pictures) >= 8


def at_work(commission: Commission, name: str) -> Callable[[], Any]:
    """Whether a stage is in the middle of it, by what it has written; else a second after it was entered."""
    written = {
        "collect": "collect/episodes/1/*",
        "tune": "tune/*/episodes/*/vehicle.log*",
        "verify": "tune/*/verify/episodes/*/vehicle.log*",
    }
    entered_s: list[float] = []

    def look() -> bool:
        if name not in commission.record["spent_s"]:
            return False
        entered_s.append(time.monotonic())
        if name in written:
            return bool(list(commission.out.glob(written[name])))
        return time.monotonic() - entered_s[0] > 1.0

    return look
