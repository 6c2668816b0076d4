"""`tune --backend batch` over real processes: its best are the bus's to confirm; killed in the middle it goes on."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import Ended, eventually, new_session, no_orphans, start, tunefree_alone
from tunefree_hil.tune.study import read_study

pytestmark = [pytest.mark.compiled, pytest.mark.timeout(300)]
TRIALS, IN_FLIGHT, BASELINES = 24, 8, 5
COMPILES_S = 200.0  # patience: on a machine that never compiled this bench, under load


class BatchTune:
    """One command on a bench of a few seconds, with `more` options."""

    def __init__(self, folder: Path, *more: str, duration_s: float = 2.0) -> None:
        options = ("--backend", "batch", "--trials", TRIALS, "--confirm", 2, "--no-verify", "--json")
        self.out = folder / "runs"
        bench = write_bench(folder, duration_s=duration_s)
        bench.write_text(bench.read_text().replace("slower = 1.0", "slower = 1.5"))
        self.words = ("tune", bench, *options, *more, "--out", self.out)

    @property
    def run(self) -> Path:
        (found,) = self.out.glob("*")
        return found

    def lines(self) -> list[dict[str, Any]]:
        """The list of generations, as far as it is written."""
        found = list(self.out.glob("*/trials.jsonl"))
        whole = found[0].read_bytes().rpartition(b"\n")[0] if found else b""
        return [json.loads(line) for line in whole.split(b"\n")] if whole else []

    def trials(self) -> list[dict[str, Any]]:
        return [one for line in self.lines() for one in line.get("trials", [])]

    def best_that_hold(self, number: int) -> list[str]:
        """Of the trials that do not re-plan in the slower car those of the lowest mean grade of both cars."""
        slower = json.loads((self.run / "held.json").read_text())["came"]
        names = {f"trial {one['slot'] + 1}": one["score"] for one in self.trials()}
        means = {key: names[key] + one["score"] for key, one in slower.items() if key in names and not one["replans"]}
        assert len(means) >= number
        return sorted(means, key=lambda key: means[key])[:number]

    def end(self) -> Ended:
        return tunefree_alone(*self.words, patience_s=COMPILES_S)

    def killed_after(self, trials: int) -> None:
        """Started, and killed by signal 9 when it has told so many trials; its children end with it."""
        session = new_session()
        with no_orphans(session):
            process = start(*self.words, "--session", session)
            try:
                eventually(lambda: len(self.trials()) >= trials, COMPILES_S, "a generation")
                children = children_of(process.pid)
                assert children
            finally:
                os.kill(process.pid, signal.SIGKILL)
                process.communicate(timeout=30)
            eventually(lambda: not any(alive(one) for one in children), 10.0, "the end of the batch's process")


def stat_of(pid: int) -> list[str]:
    """State, parent, ... of a process; [] where there is none."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].split()
    except OSError:
        return []


def alive(pid: int) -> bool:
    return stat_of(pid)[:1] not in ([], ["Z"])


def children_of(pid: int) -> list[int]:
    known = [int(folder.name) for folder in Path("/proc").glob("[0-9]*")]
    return [one for one in known if stat_of(one)[1:2] == [str(pid)]]


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> tuple[BatchTune, Ended]:
    """Nobody disturbed this one."""
    tune = BatchTune(tmp_path_factory.mktemp("calm"))
    done = tune.end()
    assert done.status == 0, done.words
    return tune, done


def test_it_asks_by_generation_and_the_bus_confirms_the_best(calm: tuple[BatchTune, Ended]) -> None:
    tune, done = calm
    generations = [[one["slot"] for one in line["trials"]] for line in tune.lines() if line.get("trials")]
    assert generations == [list(range(i, i + IN_FLIGHT)) for i in range(0, TRIALS, IN_FLIGHT)]
    confirmed = done.data["confirmed"]
    holding = tune.best_that_hold(2)
    best = [one for one in tune.trials() if f"trial {one['slot'] + 1}" in holding]
    assert {key for key in confirmed if key.startswith("trial ")} == {f"trial {one['slot'] + 1}" for one in best}
    assert done.data["best"]["slot"] == done.data["held"]["winner"]["slot"] and done.data["held"]["winner"]["holds"]
    assert len(confirmed) == 2 + 1 and all(one["equal"] for one in confirmed.values()), confirmed
    assert (done.data["over"], done.data["trials_over"]) == ("bus", "batch")
    assert "in the batch" in done.words and "equal, the winner" in done.words
    driven = {int(path.name) for path in (tune.run / "episodes").iterdir()}
    (manual,) = (group for group in driven if group < BASELINES)
    assert driven == {manual, *(BASELINES + one["slot"] for one in best)}, "what the bus drove has its logs"
    with read_study(tune.run / "study.db") as study:
        assert [trial.score for trial in study.trials()] == [one["score"] for one in tune.trials()]


def test_killed_and_resumed_it_has_the_same_trials(calm: tuple[BatchTune, Ended], tmp_path: Path) -> None:
    tune = BatchTune(tmp_path)
    tune.killed_after(IN_FLIGHT)
    done = tune.end()
    assert done.status == 0, done.words
    assert "resuming" in done.words
    assert tune.trials() == calm[0].trials()
    assert done.data["confirmed"] == calm[1].data["confirmed"]
    assert done.data["held"] == calm[1].data["held"]


def test_a_run_that_goes_on_does_so_in_the_batch_without_being_told(calm: tuple[BatchTune, Ended]) -> None:
    tune, before = calm
    done = tunefree_alone("tune", "--resume", tune.run, "--trials", TRIALS, "--confirm", 2, "--no-verify", "--json")
    assert done.status == 0, done.words
    assert {key: done.data[key] for key in ("confirmed", "held", "best")} == {
        key: before.data[key] for key in ("confirmed", "held", "best")
    }
    assert "robustness check of" not in done.words, "its result is stored"
