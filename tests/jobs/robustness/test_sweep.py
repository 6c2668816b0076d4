"""The job: its verdict and files; interrupted anywhere, the same command goes on to the same result."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.jobs.robustness.made_sweep import Answer, StandIn, grade, write_tune
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import load
from tunefree_hil.bench.batch import Job
from tunefree_hil.grade.score import ScenarioGrade
from tunefree_hil.jobs.robustness.options import RobustnessOptions
from tunefree_hil.jobs.robustness.sweep import RESULT, sweep_roads
from tunefree_hil.jobs.run_folder import RunFolder, read_json

ROADS = 90  # of six sets and two cars: five chunks


@pytest.fixture
def tune(tmp_path: Path) -> Path:
    return write_tune(tmp_path)


def answer(job: Job) -> ScenarioGrade:
    """Fails where the noise of another car says so; the winner, by its gain, on fewer roads."""
    share = (job.seed or 1) % 100 / 100.0
    return grade(job, lateral_error_peak_m=0.55 * share / (2.0 * job.values["station.kp"]) if job.seed else 0.1)


def sweep(options: RobustnessOptions, driver: StandIn, monkeypatch: pytest.MonkeyPatch) -> list[Event]:
    for place in ("driving.chunk", "worst_roads"):
        monkeypatch.setattr(f"tunefree_hil.jobs.robustness.{place}.open_sweep_batch", lambda _: driver)
    return list(sweep_roads(options))


def options(tune: Path, **more: Any) -> RobustnessOptions:
    return RobustnessOptions(tune, f"families:{ROADS}", cars=5, **more)


def finished(tune: Path, monkeypatch: pytest.MonkeyPatch, how: Answer = answer, **more: Any) -> Event:
    *_, last = sweep(options(tune, **more), StandIn(how), monkeypatch)
    assert last.kind == "result"
    return last


def test_the_winner_that_fails_ends_with_1_and_a_command_that_drives_its_worst_road(
    tune: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    last = finished(tune, monkeypatch)
    data = last.data
    assert (data["exit"], data["verdict"], data["model"]) == (1, "FAILED", load(tune / "bench.toml").spec.model)
    assert set(data["sets"]) >= {"tuned", "as_shipped", "rule_based"} and data["sets"]["tuned"]["roads"]["failed"] > 0
    assert data["sentence"].startswith("FAILED") and len(data["worst"]) == 4
    assert all(Path(figure).is_file() for figure in data["figures"]) and len(data["figures"]) == 6
    [command] = data["next"]
    bench = load(Path(command.split()[2]))
    assert list(bench.scenarios) == [data["worst"][0]["road"]] == bench.spec.scenarios
    assert bench.spec.controller.parameters["station.kp"] == 0.25
    stored = read_json(Path(data["out"]) / RESULT)
    assert stored["sets"] == json.loads(json.dumps(data["sets"])) and Path(data["out"]).parent == tune / "robustness"
    assert read_json(Path(data["out"]) / "run.json")["complete"] is True


def test_a_winner_that_passes_ends_with_0(tune: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert finished(tune, monkeypatch, grade).data["exit"] == 0


def test_more_failures_may_be_allowed(tune: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert finished(tune, monkeypatch, allowed=ROADS).data["exit"] == 0


def test_an_interrupted_sweep_goes_on_to_the_same_result(
    tune: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = finished(tune, monkeypatch, out=tmp_path / "whole").data
    drives = whole["drives"]
    parts = options(tune, out=tmp_path / "parts")
    made = 0
    for end_after in (1, 240, 241):
        driver = StandIn(answer, end_after)
        with pytest.raises(KeyboardInterrupt):
            sweep(parts, driver, monkeypatch)
        made += driver.drives
    driver = StandIn(answer)
    *events, last = sweep(parts, driver, monkeypatch)
    assert made >= 480 and made + driver.drives - 2 * len(last.data["worst"]) == drives == 2 * 6 * ROADS
    for name in (RESULT, "drives.jsonl"):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    progress = [event.data for event in events if event.kind == "progress"]
    assert progress[-1]["done"] == progress[-1]["total"] and progress[0]["eta_s"] >= 0.0
    assert str(tmp_path / "parts") in progress[0]["resume"]


def test_a_finished_sweep_is_told_again_without_a_drive(tune: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = finished(tune, monkeypatch)
    driver = StandIn(answer)
    *_, last = sweep(options(tune), driver, monkeypatch)
    assert last.data == first.data and driver.drives == 2 * len(last.data["worst"])


def test_another_sweep_in_the_same_folder_is_refused(
    tune: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    finished(tune, monkeypatch, out=tmp_path / "o")
    with pytest.raises(InputError) as caught:
        finished(tune, monkeypatch, out=tmp_path / "o", seed=2)
    assert caught.value.code == "changed" and "--out" in caught.value.hint


def test_what_cannot_be_swept_is_refused(tune: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = RunFolder.create(tmp_path, "drive", {"command": "drive"})
    unfinished = tmp_path / "unfinished"
    shutil.copytree(tune, unfinished)
    (unfinished / "best.toml").unlink()
    for path, part in ((drive.path, "run of 'drive'"), (unfinished, "no best.toml"), (tmp_path / "x", "no such run")):
        with pytest.raises(InputError, match=part):
            finished(path, monkeypatch)
    with pytest.raises(InputError, match="robust has 1000 to 10000"):
        sweep(options(tune)._replace(roads="robust:10"), StandIn(), monkeypatch)


def test_a_controller_of_the_users_own_is_not_in_the_batch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tune = write_tune(tmp_path, '[controller]\ncommand = ["my_controller"]\n')
    with pytest.raises(InputError) as caught:
        finished(tune, monkeypatch)
    assert caught.value.code == "not_in_batch"


def test_public_roads_come_after_the_made_ones(tune: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = finished(tune, monkeypatch, public=True).data
    assert data["roads"] == ROADS + 229 and [one["name"] for one in data["road_sets"]] == ["families", "public229"]
