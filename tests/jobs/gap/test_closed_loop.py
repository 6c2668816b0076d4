"""Closed loop again: the repaired model tracks as the measured car did, a drive that fails on a model is told, and who
drove a foreign log is not known.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.gap.made_answer import VEHICLE, answer, made_kept
from tests.jobs.ended import ended
from tests.jobs.made_runs import made_drive
from tunefree_hil.base.events import Event
from tunefree_hil.bench import load
from tunefree_hil.bench.simulator import Job, SimulatedDrive, Simulator
from tunefree_hil.bus.bench_channel import ErrorCode, error_text
from tunefree_hil.config.load import load_model
from tunefree_hil.gap.validation.repair import effect_specs, repair_model, write_repaired_model
from tunefree_hil.jobs.gap.closed_loop import (
    DRIVE_KEY,
    MEASURED,
    SIGNALS,
    UNKNOWN_CONTROLLER,
    DriveEnd,
    SquareSum,
    compare_drives,
    name_end,
    replay_drives,
)
from tunefree_hil.jobs.gap.options import GapInputs
from tunefree_hil.jobs.gap.repair import RepairOutcome

DELAY_S = 0.12
IN_LANE, OFF_LANE = 1.35, 2.5  # times the true delay, on which the controller keeps its lane, and does not
pytestmark = pytest.mark.slow
BENCH = """
schema = "tunefree.bench/1"
vehicle = "mkz_bywire"
model = "mkz_nominal"
scenarios = ["{scenario}"]
[[effects]]
name = "steer_dead_time"
params = {{ delay_s = {delay_s} }}
"""


def asked(logs: list[Path], delay_s: float, place: Path) -> tuple[dict[str, Any] | None, str]:
    """With a model that was repaired by so much."""
    return told(logs, delay_s, place)[0]


def told(logs: list[Path], delay_s: float, place: Path) -> tuple[tuple[dict[str, Any] | None, str], list[Event]]:
    """The same, and what was said."""
    model = load_model("mkz_nominal")
    value = {"value": delay_s, "low": delay_s, "high": delay_s, "unit": "s"}
    effects = [{"name": "steer_dead_time", "params": {"delay_s": value}, "evidence": 9.0}]
    kept = made_kept()._replace(answer=answer(effects=effects))
    made = repair_model(model, VEHICLE, {}, effect_specs(kept, "", ""))
    written = write_repaired_model(place, model, made.model, {})
    mended = RepairOutcome(repair_model(model, VEHICLE, {}), made, written)
    return ended(replay_drives(logs, GapInputs(VEHICLE, model, model, [], []), mended))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive on the nominal car with a steering that answers later."""
    root = tmp_path_factory.mktemp("runs")
    own = load("bench_configs/mkz_steer.toml")
    name = min(own.spec.scenarios, key=lambda one: own.scenarios[one].speed.t_s[-1])
    (root / "b.toml").write_text(BENCH.format(scenario=name, delay_s=DELAY_S))
    episode = made_drive(root / "b.toml", root, "late", {}) / "episodes" / "0"
    said = json.loads((episode / "episode.json").read_text())  # a bench writes down the seed that it drove with
    (episode / "episode.json").write_text(json.dumps({**said, "seed": own.scenarios[name].noise_seed}))
    return episode / "vehicle.log"


def test_the_true_repair_tracks_as_the_measured_car_did(log: Path, tmp_path: Path) -> None:
    found, why = asked([log], DELAY_S, tmp_path / "right")
    assert why == "" and found is not None and found["drives"] == 1
    assert found["down_frac"] == 1.0 and found["worst_frac"] == -1.0, "the batch drives what the bench did, bit by bit"
    lateral = found["signals"]["lateral_error_m"]
    assert lateral["before"] == lateral["recalibrated"] > 0.02 and lateral["after"] == 0.0
    assert found["ended"] == {} and "early" not in found["words"]


def test_a_wrong_one_does_not(log: Path, tmp_path: Path) -> None:
    found, why = asked([log], IN_LANE * DELAY_S, tmp_path / "wrong")
    assert why == "" and found is not None and found["ended"] == {}
    assert found["down_frac"] < 0.0 and found["worst_frac"] > 0.0 and found["worst"] in SIGNALS


def test_one_that_leaves_the_lane_is_told_and_is_the_worst(log: Path, tmp_path: Path) -> None:
    (found, why), events = told([log], OFF_LANE * DELAY_S, tmp_path / "off")
    assert why == "" and found is not None and set(found["ended"]) == {"after"}
    [one] = found["ended"]["after"]
    assert one["log"] == str(log) and one["how"] == "left_lane" and 2.0 < one["t_s"] < 9.0
    assert found["down_frac"] < 0.0 and found["worst"] == DRIVE_KEY and found["worst_frac"] > 999.0
    assert "the repaired model fails where the measured vehicle did not" in found["words"]
    assert (
        f"on the repaired model (left_lane after {one['t_s']:.4g} s); compared are the rows that all have"
        in found["words"]
    )
    assert [event.message for event in events if event.kind == "warning"] == [f"closed loop: {found['words']}"]


def test_all_are_compared_over_the_rows_that_all_have(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The model as it was, driven on to where it is far off, would make any repair that fails early look good."""
    whole, _ = asked([log], IN_LANE * DELAY_S, tmp_path / "whole")
    rows = 700
    fails_on(monkeypatch, {"recalibrated": rows})
    found, why = asked([log], IN_LANE * DELAY_S, tmp_path / "cut")
    assert why == "" and found is not None and whole is not None
    lateral, before = found["signals"]["lateral_error_m"], whole["signals"]["lateral_error_m"]
    assert all(lateral[key] != before[key] for key in (MEASURED, "before", "after"))
    assert lateral["before"] == lateral["recalibrated"], "the same model, the same rows"
    assert found["ended"] == {"recalibrated": [{"log": str(log), "how": "left_lane", "t_s": rows / 100.0}]}
    assert found["worst"] in SIGNALS, "only the repair is judged"


def test_a_repair_that_fails_at_once_leaves_nothing_to_compare_and_is_told(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fails_on(monkeypatch, {"made": 1})
    found, why = asked([log], DELAY_S, tmp_path / "made")
    assert why == "" and found is not None
    assert (found["down_frac"], found["worst"]) == (None, DRIVE_KEY) and found["worst_frac"] > 1900.0
    assert found["words"].startswith(
        "the tracking's difference from the measured drive is none in the rows that all drives have"
    )


def test_what_no_model_is_driven_on_cannot_be_repeated(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fails_on(monkeypatch, {"": 3}, "not_enabled")
    found, why = asked([log], DELAY_S, tmp_path / "model")
    assert found is None and "cannot be driven again: no model drives for 1 s, the drives end with not_enabled" in why
    fails_on(monkeypatch, {"": 3}, "diverged")
    found, why = asked([log], DELAY_S, tmp_path / "again")
    assert why == "" and found is not None and set(found["ended"]) == {"before", "recalibrated", "after"}


def fails_on(monkeypatch: pytest.MonkeyPatch, models: dict[str, int], error: str = "left_lane") -> None:
    """Drives on models whose folder's name has this in it end after so many rows."""
    drive = Simulator.drive

    def cut(self: Simulator, job: Job) -> SimulatedDrive:
        made = drive(self, job)
        rows = next((rows for name, rows in models.items() if name in Path(self.model).name), None)
        if rows is None:
            return made
        columns = {name: values[:rows] for name, values in made.recording.columns.items()}
        return SimulatedDrive(made.recording._replace(columns=columns), rows, error)

    monkeypatch.setattr(Simulator, "drive", cut)


def test_who_drove_a_foreign_log_is_not_known(log: Path, tmp_path: Path) -> None:
    other = tmp_path / "some.log"
    other.write_bytes(log.read_bytes())
    assert asked([other], DELAY_S, tmp_path / "model") == (None, UNKNOWN_CONTROLLER)


@pytest.mark.parametrize("joined", [True, False])
def test_what_a_controller_that_is_not_ours_drove_is_not_done_again(log: Path, tmp_path: Path, joined: bool) -> None:
    run = tmp_path / "run"
    shutil.copytree(log.parents[2], run)
    if joined:
        record = json.loads((run / "run.json").read_text())
        (run / "run.json").write_text(json.dumps({**record, "joined": "pursuit"}))
    else:
        bench = run / "bench.toml"
        lines = [
            "command = ['./mine']" if line.startswith("command = ") else line for line in bench.read_text().split("\n")
        ]
        bench.write_text("\n".join(lines))
    found, why = asked([run / "episodes" / "0" / "vehicle.log"], DELAY_S, tmp_path / "model")
    assert found is None and "the batch has only our controller, not" in why


def test_a_drive_on_the_vehicle_is_the_tunes_own(log: Path, tmp_path: Path) -> None:
    run = log.parent.parent.parent
    place = tmp_path / "tune"
    shutil.copytree(run / "episodes", place / "verify" / "episodes")  # as `verify` leaves it: all else is beside it
    for name in ("run.json", "bench.toml"):
        shutil.copyfile(run / name, place / name)
    found, why = asked([place / "verify" / "episodes" / "0" / "vehicle.log"], DELAY_S, tmp_path / "model")
    assert why == "" and found is not None and found["down_frac"] == 1.0


def summed(**rms: tuple[float, float, float]) -> dict[str, dict[str, list[SquareSum]]]:
    """RMS (measured, before, after) by signal, over ten rows."""
    keys = (MEASURED, "before", "after")
    return {
        name: {key: [SquareSum(10.0 * one * one, 10)] for key, one in zip(keys, some, strict=True)}
        for name, some in rms.items()
    }


@pytest.mark.parametrize("number", [*(int(error) for error in ErrorCode if error), 1001, 4711])
def test_an_end_has_the_name_that_a_simulated_drive_gives_it(number: int) -> None:
    assert error_text(number).split(" ")[0] == name_end(number)
    assert name_end(0) == "" and name_end(4711) == name_end(1000) == "controller_own"


def test_an_error_that_was_next_to_none_before_decides_nothing() -> None:
    large = {"lateral_error_m": (0.2, 0.1, 0.01)}
    assert compare_drives(summed(**large), 1)["down_frac"] == pytest.approx(0.9)
    both = compare_drives(summed(**large, heading_error_rad=(0.02, 1e-6, 1e-5)), 1)
    assert both["down_frac"] == pytest.approx(0.9, abs=1e-3) and both["worst"] == "lateral_error_m"
    assert "down by 90 %, lateral_error_m least, down by 90 %" in both["words"]


def test_squares_are_pooled_over_drives_by_their_rows() -> None:
    short, long = summed(speed_error_mps=(1.0, 1.0, 1.0)), summed(speed_error_mps=(1.0, 1.0, 0.0))
    pooled = {
        name: {key: [*some[key], SquareSum(9 * long[name][key][0].squares, 90)] for key in some}
        for name, some in short.items()
    }
    assert compare_drives(pooled, 2)["down_frac"] == pytest.approx(1.0 - 0.1**0.5)


def test_a_difference_that_was_none_and_is_one_now_counts_as_worse() -> None:
    found = compare_drives(summed(lateral_error_m=(0.2, 0.1, 0.05), speed_mps=(10.0, 0.0, 1.0)), 1)
    assert found["worst"] == "speed_mps" and found["worst_frac"] > 10.0 and "speed_mps is up" in found["words"]
    nothing = compare_drives(summed(**{name: (1.0, 0.0, 0.0) for name in SIGNALS}), 1)
    assert nothing["down_frac"] is None and nothing["words"] == "no difference"


def ends(measured: DriveEnd, **models: DriveEnd) -> dict[str, DriveEnd]:
    return {MEASURED: measured, "recalibrated": WHOLE, "before": WHOLE, "after": WHOLE, **models}


WHOLE, LEFT, LATER = (
    DriveEnd("a", 1000, 0.01),
    DriveEnd("a", 400, 0.01, "left_lane"),
    DriveEnd("a", 410, 0.01, "left_lane"),
)
BETTER = {"lateral_error_m": (0.2, 0.1, 0.01)}


@pytest.mark.parametrize(
    ("drives", "worst_frac"),
    [
        (ends(WHOLE, after=LEFT), 1599.0),
        (ends(WHOLE, after=LEFT._replace(ticks=1000)), 999.0),  # in the last row
        (ends(WHOLE, after=LEFT, before=LATER), 0.01 / 1.59),  # sooner
        (ends(WHOLE, after=LATER, before=LEFT), -0.9),  # later
        (ends(WHOLE, before=LEFT), -0.9),
        (ends(LATER, after=LEFT), -0.9),  # as the car did
        (ends(LEFT, after=LATER._replace(error="diverged")), -0.9),  # nobody knows how the car would have gone on
        (ends(LEFT), -0.9),
    ],
)
def test_what_fails_on_the_repaired_model_and_not_in_the_car_counts(
    drives: dict[str, DriveEnd], worst_frac: float
) -> None:
    found = compare_drives(summed(**BETTER), 1, [drives])
    assert found["worst_frac"] == pytest.approx(worst_frac) and found["down_frac"] == pytest.approx(0.9)
    assert (
        ("fails where the measured vehicle did not" in found["words"])
        == (found["worst"] == DRIVE_KEY)
        == (worst_frac > 0.0)
    )
    assert set(found["ended"]) == {name for name, one in drives.items() if one.error}
    assert "the drive ends early" in found["words"]


def test_a_failure_in_one_log_is_not_made_good_by_another() -> None:
    found = compare_drives(summed(**BETTER), 2, [ends(WHOLE, before=LEFT), ends(WHOLE, after=LATER)])
    assert found["worst"] == DRIVE_KEY and found["worst_frac"] > 999.0
    assert "on the original model (1 of 2 drives, first left_lane after 4 s) and on the repaired" in found["words"]
    assert "compared are the rows that all have, 40 % of the measured ones" in found["words"]
