"""Workers on one study in a real PostgreSQL: no slot twice, none lost, whoever is killed (docs/reference/design.md)."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import optuna
import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import finish, new_session, no_orphans, one_message
from tests.jobs.command import start as start_command
from tests.tune.drive_study import bowl, settings
from tests.tune.postgres import PASSWORD, USER, Server, needs_server, running
from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.tune.shared.server import open_storage, parse_address
from tunefree_hil.tune.shared.shared_study import SharedStudy, join_study
from tunefree_hil.tune.study import read_study
from tunefree_hil.tune.trial import Evaluation, Trial

pytestmark = needs_server(300)
ROOT = Path(__file__).resolve().parents[2]
GRACE_S = 2.0


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with running() as made:
        yield made


class Worker:
    """One worker of a fast fake objective, in a process of its own."""

    def __init__(
        self, url: str, folder: Path, trials: int, sleep_s: float, patience_s: float = 30.0, end_s: float = 0.0
    ) -> None:
        words = [url, str(folder), str(trials), str(sleep_s), str(GRACE_S), str(patience_s), str(end_s)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.tune.drive_worker", *words],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.said: list[str] = []

    def listen(self, word: str, times: int = 1) -> None:
        """Wait until it has said `word` so many times."""
        assert self.process.stdout
        while times:
            line = self.process.stdout.readline()
            assert line, f"it ended; it said {self.said}"
            self.said.append(line.strip())
            times -= line.startswith(word)

    def end(self, status: int = 0) -> str:
        """Wait for its end; what it said on stderr."""
        out, words = self.process.communicate(timeout=120)
        self.said += out.split("\n")
        assert self.process.returncode == status, words
        assert PASSWORD not in words + "".join(self.said)
        return words

    def filled(self) -> list[int]:
        return [int(line.split()[1]) for line in self.said if line.startswith("filled")]


def joined(url: str, folder: Path, patience_s: float = 5.0) -> SharedStudy:
    asked = settings("tpe_independent")._replace(in_flight=0)
    return join_study(url, asked, folder, grace_s=GRACE_S, patience_s=patience_s)


def failures(url: str, folder: Path) -> list[Trial]:
    with joined(url, folder) as study:
        return study.shared_trials.stored.failures()


def whole(url: str, folder: Path, trials: int) -> list[Trial]:
    """The trials of a study, which must be whole: each slot once, each score that of its parameters."""
    with joined(url, folder) as study:
        found = study.trials()
        assert [trial.slot for trial in found] == list(range(trials))
        assert all(trial.score == bowl(trial.parameters).score for trial in found)
        complete = [one for one in study.shared_trials.stored.optuna_study.get_trials() if one.state.name == "COMPLETE"]
        assert len(complete) == trials, "a slot was filled twice"
        assert not study.shared_trials._running()
        return found


def test_two_workers_share_the_slots(server: Server, tmp_path: Path) -> None:
    url = server.url("two")
    workers = [Worker(url, tmp_path / str(i), 16, 0.1) for i in range(2)]
    for worker in workers:
        worker.end()
    assert sorted(workers[0].filled() + workers[1].filled()) == list(range(16))
    assert min(len(worker.filled()) for worker in workers) >= 3
    assert sum("ours" in worker.said for worker in workers) == 1
    found = whole(url, tmp_path, 16)
    assert found[0].parameters == settings("random").first
    assert failures(url, tmp_path) == []


def test_the_slot_of_a_killed_worker_is_repeated(server: Server, tmp_path: Path) -> None:
    url = server.url("killed")
    victim = Worker(url, tmp_path / "victim", 8, 60.0)
    victim.listen("evaluating")
    heir = Worker(url, tmp_path / "heir", 8, 0.1)
    heir.listen("filled")  # as long as the victim lives, its slot is not the heir's
    victim.process.kill()
    victim.process.communicate(timeout=30)
    heir.end()
    found = whole(url, tmp_path, 8)
    (failed,) = failures(url, tmp_path)
    assert (failed.slot, failed.error) == (0, "interrupted")
    assert failed.parameters == found[0].parameters
    assert sorted(heir.filled()) == list(range(8)) and heir.filled()[0] != 0


def test_an_interrupted_worker_gives_its_slot_back_at_once(server: Server, tmp_path: Path) -> None:
    url = server.url("interrupted")
    worker = Worker(url, tmp_path / "a", 4, 30.0)
    worker.listen("evaluating")
    worker.process.send_signal(signal.SIGINT)
    worker.process.communicate(timeout=30)
    assert [(trial.slot, trial.error) for trial in failures(url, tmp_path)] == [(0, "interrupted")]
    with joined(url, tmp_path) as study:
        assert study.leases.acquire(0)


def test_a_worker_taken_for_dead_is_still_heard(server: Server, tmp_path: Path) -> None:
    url = server.url("slow")
    with joined(url, tmp_path) as slow, joined(url, tmp_path) as quick:
        begun = slow.shared_trials.begin(0, "slow")
        again = quick.shared_trials.begin(0, "quick")  # it looked as if slow were gone
        assert again.parameters == begun.parameters
        assert slow.shared_trials.complete(begun, bowl(begun.parameters)) is not None
        assert quick.shared_trials.complete(again, bowl(again.parameters)) is None
        assert (
            slow.shared_trials.complete(begun, bowl(begun.parameters)) is not None
            or len(slow.shared_trials.stored.trials()) == 1
        )
    whole(url, tmp_path, 1)


def test_what_is_kept_for_a_study_that_was_lost_is_told_nobody_elses_trial(server: Server, tmp_path: Path) -> None:
    with joined(server.url("lost"), tmp_path) as lost:
        kept = [lost.shared_trials.begin(slot, "us") for slot in (0, 1)]
    url = server.url("made-anew")
    with joined(url, tmp_path) as study:
        theirs = study.shared_trials.begin(1, "another")  # number 0, as ours of slot 0 was in the study that is gone
        assert theirs.number == kept[0].number
        told = [study.shared_trials.complete(one, bowl(one.parameters)) for one in kept]
        assert [one and one.slot for one in told] == [0, 1]
        assert study.shared_trials.complete(theirs, bowl(theirs.parameters)) is None, "it was filled meanwhile"
    whole(url, tmp_path, 2)


def test_a_server_that_restarts_in_the_middle_costs_nothing(server: Server, tmp_path: Path) -> None:
    url = server.url("restarted")
    workers = [Worker(url, tmp_path / str(i), 8, 0.5) for i in range(2)]
    for worker in workers:
        worker.listen("filled", 1)
    server.stop()
    time.sleep(2.0)
    server.start()
    for worker in workers:
        worker.end()
    assert any("does not answer" in line for worker in workers for line in worker.said)
    whole(url, tmp_path, 8)


def test_a_server_that_stays_away_ends_the_worker_and_keeps_its_trial(server: Server, tmp_path: Path) -> None:
    url = server.url("away")
    worker = Worker(url, tmp_path / "a", 3, 1.0, patience_s=2.0)
    worker.listen("evaluating")
    server.stop()
    try:
        words = worker.end(status=3)
        assert "does not answer" in words and "the finished trial is in" in words
        assert (tmp_path / "a" / "kept.json").is_file()
        with pytest.raises(BenchError, match="does not answer"):
            joined(url, tmp_path)
    finally:
        server.start()
    again = Worker(url, tmp_path / "a", 3, 0.0)
    again.end()
    assert again.filled() == [0, 1, 2] and "evaluating" not in again.said[: again.said.index("filled 0")]
    assert not (tmp_path / "a" / "kept.json").exists()
    whole(url, tmp_path, 3)
    assert [trial.error for trial in failures(url, tmp_path)] == []


def test_other_settings_and_wrong_passwords_are_refused(server: Server, tmp_path: Path) -> None:
    url = server.url("settings")
    joined(url, tmp_path).close()
    other = settings("random")._replace(in_flight=0, seed=9)
    with pytest.raises(InputError, match="seed was 3, now 9") as caught:
        join_study(url, other, tmp_path)
    assert "sampler was tpe_independent, now random" in caught.value.message
    with pytest.raises(InputError, match="password authentication failed") as caught:
        joined(server.url("settings", password="wrong-secret"), tmp_path)
    assert "wrong-secret" not in str(caught.value)
    with pytest.raises(InputError, match="does not exist"):
        joined(url.replace("/postgres#", "/nowhere#"), tmp_path)


def test_a_bench_that_fails_is_told_and_asked_again(server: Server, tmp_path: Path) -> None:
    answers = iter([BenchError("the ecu is gone", code="node_lost"), None])

    def evaluate(points: Mapping[int, dict[str, float]]) -> list[Evaluation]:
        problem = next(answers)
        if problem:
            raise problem
        return [bowl(parameters) for parameters in points.values()]

    with joined(server.url("fails"), tmp_path) as study:
        told = [one for one in study.run_trials(1, evaluate) if isinstance(one, Trial)]
        assert [bool(one.error) for one in told] == [True, False]
        assert told[0].parameters == told[1].parameters
        with pytest.raises(BenchError, match="for good"):
            lost = BenchError("lost for good", code="node_lost")
            list(study.run_trials(2, lambda _: [Evaluation(0.0, {}, error=lost.message)]))
        assert study.leases.acquire(1)


def test_two_workers_of_tune_one_of_them_killed(server: Server, tmp_path: Path) -> None:
    bench = write_bench(tmp_path)
    url = server.url("real")
    words = ("tune", bench, "--no-verify", "--json", "--plain", "--trials", 6, "--study", url)
    sessions = [new_session(), new_session()]
    with no_orphans(sessions[0], 20.0), no_orphans(sessions[1], 20.0):
        processes = [start_command(*words, "--session", session, "--out", tmp_path / session) for session in sessions]
        deadline_s = time.monotonic() + 90.0
        while True:
            with join_any(url, tmp_path) as count:
                if count >= 1:
                    break
            assert time.monotonic() < deadline_s
            time.sleep(0.3)
        os.kill(processes[0].pid, signal.SIGKILL)
        processes[0].communicate(timeout=60)
        done = finish(processes[1], 200.0)
    assert done.status == 0, done.words
    assert PASSWORD not in done.words + str(done.data)
    assert done.data["best"]["score"] > 0.0
    slots = [trial.user_attrs["slot"] for trial in complete(url)]
    assert sorted(slots) == list(range(6))
    with read_study(Path(done.data["run"]) / "study.db") as copy:
        assert [trial.slot for trial in copy.trials()] == list(range(6)) and len(copy.baselines()) == 5
    for path in tmp_path.rglob("*"):
        if path.is_file():
            assert PASSWORD.encode() not in path.read_bytes(), path
    other = finish(start_command(*words, "--seed", 5, "--session", new_session(), "--out", tmp_path / "other"), 60.0)
    assert other.status == 2
    one_message(other, "seed was 1, now 5", f"{USER}@")


def complete(url: str) -> list[optuna.trial.FrozenTrial]:
    """The trials that Optuna itself counts as complete."""
    address = parse_address(url)
    storage = open_storage(address)
    try:
        study = optuna.load_study(study_name=address.name, storage=storage)
        return study.get_trials(states=(optuna.trial.TrialState.COMPLETE,))
    finally:
        storage.remove_session()
        storage.engine.dispose()


class join_any:
    """How many trials a study holds, whatever its settings."""

    def __init__(self, url: str, folder: Path) -> None:
        self.url = url

    def __enter__(self) -> int:
        import psycopg

        name = re.search(r"#(\w+)$", self.url)
        assert name
        with psycopg.connect(self.url.partition("#")[0], connect_timeout=5) as connection:
            found = connection.execute("SELECT to_regclass('trials')").fetchone()
            if not found or not found[0]:
                return 0
            row = connection.execute(
                "SELECT count(*) FROM trials JOIN studies USING (study_id) "
                "WHERE study_name = %s AND trials.state = 'COMPLETE'",
                (name[1],),
            ).fetchone()
            return int(row[0]) if row else 0

    def __exit__(self, *error: object) -> None:
        """Nothing stays open."""
