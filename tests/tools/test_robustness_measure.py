"""The measure `robustness`: its number is the winner's share, and a finished tune of the bench is used again."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.jobs.robustness.made_sweep import StandIn, grade, write_tune
from tools.measures import robustness
from tunefree_hil.base.events import Event
from tunefree_hil.bench.batch import Job
from tunefree_hil.grade.score import ScenarioGrade
from tunefree_hil.jobs.options.records import TuneOptions
from tunefree_hil.jobs.run_folder import RunFolder

ROADS = 20


def answer(job: Job) -> ScenarioGrade:
    """The winner of `write_tune` re-plans in every other car."""
    return grade(job, replans=float(job.values["station.kp"] == 0.25 and job.seed is not None))


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> StandIn:
    made = StandIn(answer)
    for place in ("driving.chunk", "worst_roads"):
        monkeypatch.setattr(f"tunefree_hil.jobs.robustness.{place}.open_sweep_batch", lambda _: made)
    return made


def test_the_value_is_the_share_of_roads_that_the_winner_fails(tmp_path: Path, driver: StandIn) -> None:
    run = write_tune(tmp_path)
    result = robustness.measure(run=str(run), roads=f"families:{ROADS}", cars=3)
    assert (result["value"], result["unit"], result["n"]) == (100.0, "%", ROADS)
    assert 80.0 < result["low"] < result["high"] == 100.0
    detail = result["detail"]
    assert detail["sets"]["mrac_on"]["roads"]["failed"] == 0 and detail["drives_per_s"] > 0.0
    assert robustness.measure(run=str(run), roads=f"families:{ROADS}", cars=3)["detail"]["drives_per_s"] is None


def test_without_a_run_one_is_made_and_found_again(
    tmp_path: Path, driver: StandIn, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = write_tune(tmp_path / "made")
    orders: list[TuneOptions] = []

    def tune(options: TuneOptions) -> Iterator[Event]:
        orders.append(options)
        assert options.out is not None and options.bench == Path("b.toml") and options.verify is False
        run = RunFolder.create(options.out, "tune", {"command": "tune", "bench": str(options.bench)})
        for name in ("bench.toml", "best.toml"):
            (run.path / name).write_bytes((made / name).read_bytes())
        run.finish(options={"trials": options.trials})
        yield Event("result", "", {"run": str(run.path)})

    monkeypatch.setattr(robustness, "tune", tune)
    monkeypatch.setattr(robustness, "load_bench", lambda path: SimpleNamespace(tune=SimpleNamespace(trials=8)))
    for trials in (7, 7, 8, 0):
        robustness.measure(
            bench="b.toml", trials=trials, roads=f"families:{ROADS}", cars=3, folder=str(tmp_path / "folder")
        )
    assert [options.trials for options in orders] == [7, 8]
