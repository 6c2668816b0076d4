"""A tune over real processes that is killed at random moments and started again has the trials of one that was not."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import (
    Ended,
    eventually,
    finish,
    new_session,
    no_orphans,
    processes_of,
    start,
    tunefree,
    tunefree_alone,
)
from tunefree_hil.jobs.run_folder import read_json
from tunefree_hil.tune.study import read_study

pytestmark = pytest.mark.slow
OWNER_PATIENCE_S = 15.0  # a hub that nobody came to own ends after 10 s, and its nodes with it


class Tune:
    """One tune command, to be run again and again on the same folder."""

    def __init__(self, bench: Path, out: Path) -> None:
        self.words = ("tune", bench, "--no-verify", "--out", out, "--json")
        self.out = out

    def run(self, number: int = 0, after_s: float = 0.0) -> Ended:
        """Run it, with a signal after a while where there is a number; nothing of it may stay."""
        session = new_session()
        with no_orphans(session, OWNER_PATIENCE_S):
            process = start(*self.words, "--session", session)
            if number:
                time.sleep(after_s)
                process.send_signal(number)
            return finish(process)

    @property
    def study(self) -> Path:
        """Of the last run. None may be left unfinished: there is a second one only where a signal came before the first
        had begun, or in the moments after it was complete.
        """
        *_, last = runs = sorted(file.parent for file in self.out.glob("*/run.json"))
        assert all(read_json(run / "run.json")["complete"] for run in runs)
        return last / "study.db"

    def trials(self) -> list[tuple[int, dict[str, float], float]]:
        with read_study(self.study) as study:
            return [(trial.slot, trial.parameters, trial.score) for trial in study.trials()]

    def baselines(self) -> dict[str, Any]:
        with read_study(self.study) as study:
            return {name: baseline.score for name, baseline in study.baselines().items()}

    def failures(self) -> list[str]:
        with read_study(self.study) as study:
            return [trial.error for trial in study.failures()]


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> Tune:
    """Three trials of two seconds that nobody disturbed."""
    folder = tmp_path_factory.mktemp("calm")
    tune = Tune(write_bench(folder), folder / "runs")
    done = tune.run()
    assert done.status == 0, done.words
    assert len(tune.trials()) == 3 and tune.failures() == []
    return tune


def test_killed_and_interrupted_at_random_it_ends_the_same(calm: Tune, tmp_path: Path) -> None:
    tune = Tune(write_bench(tmp_path), tmp_path / "runs")
    chance = random.Random(5)
    for number in (signal.SIGKILL, signal.SIGINT, signal.SIGKILL):
        done = tune.run(number, chance.uniform(2.0, 6.0))
        assert done.status in (0, 130 if number == signal.SIGINT else -number), done.words
        if done.status == 0:
            break
        if done.status == 130:
            assert "state saved" in done.words and "tunefree-hil tune" in done.words
    else:
        done = tune.run()
    assert done.status == 0, done.words
    assert tune.trials() == calm.trials()
    assert tune.baselines() == calm.baselines()
    assert set(tune.failures()) <= {"interrupted"}


def test_a_node_that_is_killed_costs_an_attempt_and_nothing_else(calm: Tune, tmp_path: Path) -> None:
    tune = Tune(write_bench(tmp_path), tmp_path / "runs")
    session = new_session()
    with no_orphans(session, OWNER_PATIENCE_S):
        process = start(*tune.words, "--session", session)
        eventually(lambda: list(tmp_path.glob("runs/*/episodes/1/episode.json")), what="the second drive")
        for one in processes_of(session):
            if one.command == "controller":  # of each bench that runs side by side
                os.kill(one.pid, signal.SIGKILL)
        done = finish(process)
    assert done.status == 0, done.words
    assert "was killed by signal 9" in done.words and "again" in done.words
    assert tune.trials() == calm.trials() and tune.baselines() == calm.baselines()


def test_the_command_that_was_finished_starts_anew_and_resume_does_not(calm: Tune) -> None:
    before = calm.trials()
    run = calm.study.parent
    done = tunefree_alone("tune", "--resume", run, "--trials", 3, "--no-verify", "--json")
    assert done.status == 0, done.words
    assert done.data["run"] == str(run) and calm.trials() == before
    given = [command.split() for command in done.data["next"]]
    assert all(words[0].endswith("tunefree-hil") for words in given)  # what installation brings, and nothing else
    for words in given:
        if "verify" not in words:  # that one drives for a minute
            pasted = tunefree(*words[1:], *["--no-slices"] * ("explain" in words))
            assert pasted.status == 0, pasted.words
