"""A task on a worker: plain data both ways, its bench kept between chunks, other files or another version refused."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.jobs.robustness.made_sweep import StandIn, plan_of
from tunefree_hil.base.errors import PeerGone
from tunefree_hil.bench.batch import Job
from tunefree_hil.jobs.robustness.driving import worker
from tunefree_hil.jobs.robustness.driving.chunk import chunk_from_data, drive_chunk
from tunefree_hil.jobs.robustness.driving.pack import CODE
from tunefree_hil.jobs.robustness.driving.worker import close_rig, drive_task, make_task_order
from tunefree_hil.jobs.robustness.plan import SweepPlan

PLAIN = (dict, list, tuple, str, bytes, int, float, bool, type(None))


class CountedBatches:
    """Makes stand-ins, and notes how often and with which plan."""

    def __init__(self) -> None:
        self.plans: list[SweepPlan] = []
        self.closed = 0
        self.error: Exception | None = None

    def open(self, plan: SweepPlan) -> Any:
        self.plans.append(plan)
        outer = self

        class Batch(StandIn):
            def close(self) -> None:
                outer.closed += 1

            def _driven(self, job: Job, columns: bool) -> Any:
                if outer.error is not None:
                    raise outer.error
                return super()._driven(job, columns)

        return Batch()


@pytest.fixture
def batches(monkeypatch: pytest.MonkeyPatch) -> Iterator[CountedBatches]:
    made = CountedBatches()
    monkeypatch.setattr(worker, "open_sweep_batch", made.open)
    yield made
    close_rig()


def is_plain(value: Any) -> bool:
    if isinstance(value, dict):
        return all(is_plain(key) and is_plain(one) for key, one in value.items())
    return (
        all(map(is_plain, value)) if isinstance(value, list | tuple) and type(value) in PLAIN else type(value) in PLAIN
    )


def test_a_worker_drives_the_chunks_of_the_plan_with_one_bench(tmp_path: Path, batches: CountedBatches) -> None:
    plan = plan_of(tmp_path, 70)
    task = make_task_order(plan)
    assert is_plain(task) and len(pickle.dumps(task)) < 300_000
    for number in (1, 0):
        answer = drive_task(task, number)
        assert is_plain(answer) and chunk_from_data(answer) == drive_chunk(StandIn(), plan, number)
    assert len(batches.plans) == 1 and batches.plans[0].roads == plan.roads and batches.closed == 0
    assert Path(batches.plans[0].bench.file).parent != tmp_path
    drive_task(make_task_order(plan_of(tmp_path, 71)), 0)
    assert len(batches.plans) == 2 and batches.closed == 1
    folder = Path(batches.plans[1].bench.file).parent
    assert folder.is_dir()
    close_rig()
    assert batches.closed == 2 and not folder.exists()


@pytest.mark.parametrize("name", [CODE, "vehicle", "model", "roads", "cars"])
def test_a_worker_that_would_drive_something_else_says_in_what(
    tmp_path: Path, batches: CountedBatches, name: str
) -> None:
    task = make_task_order(plan_of(tmp_path, 3))
    task["hashes"] = {**task["hashes"], name: "0.9 other"}
    error = drive_task(task, 0)["error"]
    assert (error["code"], error["status"], batches.plans) == ("other_worker", 2, [])
    assert name in error["message"] and "restart the worker" in error["hint"]


def test_an_error_of_a_worker_is_data_and_its_bench_is_made_anew(tmp_path: Path, batches: CountedBatches) -> None:
    task = make_task_order(plan_of(tmp_path, 3))
    batches.error = PeerGone("batch", "the batch's process has ended", code="batch_lost")
    error = drive_task(task, 0)["error"]
    assert is_plain(error) and (error["code"], error["status"]) == ("batch_lost", 3)
    batches.error = None
    assert "drives" in drive_task(task, 0) and len(batches.plans) == 2
