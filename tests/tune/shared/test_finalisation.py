"""The end of a shared study in a real PostgreSQL: one worker finds who wins, whoever dies at it, and all go by that."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.jobs.ended import ended
from tests.tune.drive_study import bowl
from tests.tune.postgres import Server, needs_server, running
from tests.tune.test_postgres import Worker, joined
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune import tune
from tunefree_hil.jobs.tune.robustness import RobustnessResult
from tunefree_hil.tune.robust_winner import DriveTotals
from tunefree_hil.tune.shared.finalisation import Finalisation
from tunefree_hil.tune.shared.shared_study import SharedStudy

pytestmark = needs_server(200)


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with running() as made:
        yield made


def filled(url: str, folder: Path, trials: int = 2) -> SharedStudy:
    folder.mkdir(exist_ok=True)
    study = joined(url, folder)
    list(study.run_trials(trials, lambda points: [bowl(parameters) for parameters in points.values()]))
    return study


def said_last(worker: Worker) -> list[str]:
    """'last' or 'over', and the folder of who found the winner."""
    (line,) = [line for line in worker.said if line.startswith(("last", "over"))]
    return line.split()


def test_one_of_two_ends_the_study_and_the_other_waits_for_it(server: Server, tmp_path: Path) -> None:
    url = server.url("one")
    workers = [Worker(url, tmp_path / str(i), 4, 0.1, end_s=2.0) for i in range(2)]
    for worker in workers:
        worker.end()
    (first, winner), (second, same) = map(said_last, workers)
    assert {first, second} == {"last", "over"} and winner == same
    (other,) = [worker for worker in workers if "ours" not in worker.said]
    assert any("waiting for the worker that determines the winner" in line for line in other.said)


def test_a_worker_that_dies_at_it_is_followed_by_one_that_waits(server: Server, tmp_path: Path) -> None:
    url = server.url("dies")
    victim = Worker(url, tmp_path / "victim", 2, 0.0, end_s=60.0)
    victim.listen("ours")
    heir = Worker(url, tmp_path / "heir", 2, 0.0)
    heir.listen("said all slots are filled")
    victim.process.kill()
    victim.process.communicate(timeout=30)
    heir.end()
    assert said_last(heir) == ["last", "heir"]
    late = Worker(url, tmp_path / "late", 2, 0.0)
    late.end()
    assert said_last(late) == ["over", "heir"], "what was found is not sought again"


def test_what_dies_between_two_parts_leaves_the_second_to_the_next(server: Server, tmp_path: Path) -> None:
    with filled(server.url("parts"), tmp_path) as study:
        wanted = ("held", "verified")
        with Finalisation(study, "a") as first:
            list(first.wait_for_parts(wanted))
            list(first.store_parts(held=1))
            with joined(server.url("parts"), tmp_path) as beside, Finalisation(beside, "a") as second:
                list(second.wait_for_parts(wanted))
                assert not second.is_ours and second.parts["held"] == 1, "it need not wait for a verification"
        with Finalisation(study, "a") as third:
            list(third.wait_for_parts(wanted))
            assert third.is_ours and third.parts["held"] == 1
            list(third.store_parts(held=2, verified=3))
            assert (third.parts["held"], third.parts["verified"]) == (1, 3), "the first answer counts"
        with Finalisation(study, "more trials") as fourth:
            list(fourth.wait_for_parts(wanted))
            assert fourth.is_ours and fourth.parts == {}


def test_every_worker_uses_the_robustness_result_of_one(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = RobustnessResult(1.5, {"trial 1": DriveTotals(0.3, 2, 0), "trial 2": DriveTotals(0.5, 0, 0)}, "")
    drives = iter([result])

    def check(*_: Any) -> Iterator[Any]:
        yield from ()
        return next(drives)

    monkeypatch.setattr(tune, "check_robustness", check)
    plan: Any = SimpleNamespace(
        bench=SimpleNamespace(spec=SimpleNamespace(verify_model="")), options=SimpleNamespace(verify=True), vectors={}
    )
    for i in range(2):
        with filled(server.url("held"), tmp_path / str(i)) as study, Finalisation(study, "a") as finalisation:
            found, said = ended(tune._share_robustness(plan, RunFolder(tmp_path, {}), study, finalisation))
            assert found == result and finalisation.is_ours == (i == 0)
            assert any("was determined by worker" in event.message for event in said) == (i == 1)
