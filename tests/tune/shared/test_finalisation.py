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
from tunefree_hil.jobs.tune.robustness import Held
from tunefree_hil.tune.robust_winner import Came
from tunefree_hil.tune.shared.finalisation import Ending
from tunefree_hil.tune.shared.shared_study import SharedStudy

pytestmark = needs_server(200)


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with running() as made:
        yield made


def filled(url: str, folder: Path, trials: int = 2) -> SharedStudy:
    folder.mkdir(exist_ok=True)
    study = joined(url, folder)
    list(study.run_all(trials, lambda points: [bowl(parameters) for parameters in points.values()]))
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
    assert any("waiting for the worker that finds out who wins" in line for line in other.said)


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
        with Ending(study, "a") as first:
            list(first.look(wanted))
            list(first.keep(held=1))
            with joined(server.url("parts"), tmp_path) as beside, Ending(beside, "a") as second:
                list(second.look(wanted))
                assert not second.ours and second.kept["held"] == 1, "it need not wait for a verification"
        with Ending(study, "a") as third:
            list(third.look(wanted))
            assert third.ours and third.kept["held"] == 1
            list(third.keep(held=2, verified=3))
            assert (third.kept["held"], third.kept["verified"]) == (1, 3), "the first answer counts"
        with Ending(study, "more trials") as fourth:
            list(fourth.look(wanted))
            assert fourth.ours and fourth.kept == {}


def test_every_worker_goes_by_the_slower_car_that_one_drove(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = Held(1.5, {"trial 1": Came(0.3, 2, 0), "trial 2": Came(0.5, 0, 0)}, "")
    drives = iter([held])

    def hold(*_: Any) -> Iterator[Any]:
        yield from ()
        return next(drives)

    monkeypatch.setattr(tune, "hold", hold)
    wish: Any = SimpleNamespace(
        bench=SimpleNamespace(spec=SimpleNamespace(verify_model="")), asked=SimpleNamespace(verify=True), vectors={}
    )
    for i in range(2):
        with filled(server.url("held"), tmp_path / str(i)) as study, Ending(study, "a") as ending:
            found, said = ended(tune._held_for_all(wish, RunFolder(tmp_path, {}), study, ending))
            assert found == held and ending.ours == (i == 0)
            assert any("was found by worker" in event.message for event in said) == (i == 1)
