"""calibrate: a log in, a model folder out that can be driven; and what it says where the logs cannot do."""

from __future__ import annotations

import json
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.jobs.ended import ended
from tests.learn.made_drives import made_drive, whole
from tests.learn.test_model_folder import FIT
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench.vehicle import VehicleFor
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.control.calibration_map import load, lookup
from tunefree_hil.jobs.gap.calibration_logs import ANALYSED_KEY
from tunefree_hil.jobs.learn import calibrate as job
from tunefree_hil.jobs.learn.calibration import (
    build_card,
    effect_entry,
    fit_calibration,
    split_drives_for_fit,
    write_calibrated_model,
)
from tunefree_hil.jobs.learn.options import CalibrateOptions
from tunefree_hil.jobs.learn.report_text import describe_channel, find_benches, summarise_calibration
from tunefree_hil.learn.compiled_process import CompiledProcess
from tunefree_hil.learn.drives.drive import Drive, DriveSplit
from tunefree_hil.learn.estimate import Estimate, make_unidentified_estimate
from tunefree_hil.learn.model_folder import CARD_FILE, write_card
from tunefree_hil.learn.physics.fit import is_significant
from tunefree_hil.learn.physics.unknowns import BRAKE_DEAD_BAND, FITTED_EFFECTS, POWERTRAIN_LAG, STEER_OFFSET

VEHICLE = load_vehicle("mkz_bywire")
OFF_CENTRE = 0.04


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """A calibration of two made drives on a car whose steering is off centre, written; events and folder."""
    drives = [off_centre(made_drive(110.0, seed=seed, name=f"made-{seed}")) for seed in (1, 2)]
    split = DriveSplit((whole(drives[0]),), (whole(drives[1]),), "one of two")
    out = tmp_path_factory.mktemp("models") / "made"
    with CompiledProcess() as worker:
        fitted, events = ended(fit_calibration(worker, split, VEHICLE))
    write_calibrated_model(out, VEHICLE, fitted, split, build_card(drives, split, VEHICLE, fitted, 1))
    yield {"out": out, "events": events, "fitted": fitted, "split": split}


def off_centre(drive: Drive) -> Drive:
    """The steering's report says less than the road wheels do."""
    fields = dict(drive.fields)
    for name in ("report.steer_rad", "report.steer_command_rad", "command.steer_rad"):
        fields[name] = fields[name] - OFF_CENTRE
    return drive._replace(fields=fields)


@pytest.mark.slow
def test_the_model_is_that_of_the_car(made: dict[str, Any]) -> None:
    model = load_model(made["out"])
    assert model.plant.kind == "physics" and model.vehicle_hash == f"sha256:{VEHICLE.hash}"
    steer: Any = model.actuators["steer"]
    assert steer.dead_time_s.value == pytest.approx(0.115, abs=0.003)
    assert steer.dead_time_s.low < steer.dead_time_s.value < steer.dead_time_s.high
    assert model.noise["report.yaw_rate_radps"] == pytest.approx(0.001, rel=0.2)
    assert model.valid.speed_mps is not None and model.valid.speed_mps[1] > 8.0
    assert [effect.name for effect in model.effects] == ["steer_offset"]
    assert model.effects[0].params["offset_rad"] == pytest.approx(OFF_CENTRE, abs=0.006)


@pytest.mark.slow
def test_its_map_and_its_bench_work(made: dict[str, Any]) -> None:
    table = load(made["out"] / "calibration.npz")
    assert lookup(table, 8.0, 1.0) > 0.2 and lookup(table, 8.0, -2.0) < -0.17
    from tunefree_hil.bench import load as load_bench

    bench = load_bench(find_benches(VEHICLE)[0])
    vehicle = VehicleFor(bench, str(made["out"]))
    scenario = next(iter(bench.scenarios.values()))
    assert vehicle(bytes.fromhex(scenario.hash)[:6], 1).dt_s == 0.01


@pytest.mark.slow
def test_the_card_says_what_it_is_made_of(made: dict[str, Any]) -> None:
    card = json.loads((made["out"] / "card.json").read_text())
    assert [log["name"] for log in card["logs"]] == ["made-1", "made-2"] and card["seed"] == 1
    assert (
        card["free_run_rms"]["held_out"]["fitted"]["speed_mps"]
        < card["free_run_rms"]["held_out"]["data_sheet"]["speed_mps"]
    )
    assert card["actuators"]["throttle"]["dead_time_s"]["known"] is True
    assert {"value", "low", "high", "known", "why"} == set(card["constants"]["drag_area_m2"])


@pytest.mark.slow
def test_it_says_what_it_found_and_draws_it(made: dict[str, Any], tmp_path: Path) -> None:
    notes = [event.message for event in made["events"] if event.kind == "note"]
    assert any(text.startswith("steer: dead time 11") for text in notes)
    (plain,) = (text for text in notes if text.startswith("not needed to reproduce these logs: "))
    warned = [event.message for event in made["events"] if event.kind == "warning"]
    assert "overrun_force_n" in plain and not any(text.startswith("overrun_force_n") for text in warned)
    steps = [event.data for event in made["events"] if event.kind == "progress"]
    assert all(0 <= one["done"] <= one["total"] for one in steps) and len({one["label"] for one in steps}) == 4
    pictures = job.draw_figures(tmp_path, made["fitted"], made["split"])
    assert [path.name for path in pictures] == ["actuators.png", "free_run.png"]
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in pictures)


def test_a_folder_that_is_there_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("kept")
    with pytest.raises(InputError, match="exists already"):
        list(job.calibrate(CalibrateOptions([tmp_path / "no.log"], "mkz_bywire", tmp_path)))


class Cut(NamedTuple):
    """A calibration whose own logs are asked until `dies`; what was fitted, asked, and given a steering map."""

    made: list[str]
    asked: list[Path]
    dies: list[bool]
    steered: list[Path]


@pytest.fixture
def cut(monkeypatch: pytest.MonkeyPatch) -> Cut:
    """In the place of reading, fitting and asking, which take minutes."""
    found = Cut([], [], [True], [])
    drive = made_drive(4.0, name="a.log")._replace(log_hash="sha256:a")
    value = {"value": 1.0, "known": True}

    def read(*_: Any, **__: Any) -> Generator[Event, None, list[Drive]]:
        yield Event("note", "reading")
        return [drive]

    def fit(out: Path, spec: Any, drives: list[Drive], seed: int) -> Generator[Event, None, Any]:
        yield Event("note", "fitting")
        found.made.append(out.name)
        card = {
            "kind": "physics", "vehicle_hash": f"sha256:{VEHICLE.hash}", "seed": seed,
            "logs": [{"hash": one.log_hash} for one in drives], "actuators": {"steer": {"dead_time_s": value}},
            "constants": {"mass_kg": value}, "windows": {"held_out": 0}, "free_run_rms": {"held_out": None},
        }  # fmt: skip
        out.mkdir()
        write_card(out, card)
        return None, None

    def steer(folder: Path, *_: Any) -> Generator[Event, None, None]:
        yield Event("note", "steering map")
        found.steered.append(folder)

    def ask(folder: Path, *_: Any) -> Iterator[Event]:
        yield Event("progress", "suspects", {"label": "own logs"})
        found.asked.append(folder)
        if found.dies:
            raise KeyboardInterrupt
        write_card(folder, {**json.loads((folder / CARD_FILE).read_text()), ANALYSED_KEY: True})

    for name, stand_in in (
        ("read_logs", read),
        ("_fit_and_write", fit),
        ("learn_steering_of_folder", steer),
        ("analyse_calibration_logs", ask),
        ("draw_figures", lambda *_: []),
    ):
        monkeypatch.setattr(job, name, stand_in)
    return found


def test_cut_off_while_it_asks_its_own_logs_the_same_command_finishes_it(cut: Cut, tmp_path: Path) -> None:
    out, events = tmp_path / "new", list[Event]()
    asked = CalibrateOptions([Path("a.log")], VEHICLE.folder, out, 3)
    with pytest.raises(KeyboardInterrupt):
        for event in job.calibrate(asked):
            events.append(event)
    (resume,) = {one.data["resume"] for one in events if "resume" in one.data}
    assert resume == f"tunefree-hil calibrate a.log --vehicle {VEHICLE.folder} --out {out} --seed 3"
    with pytest.raises(InputError, match="exists already"):
        list(job.calibrate(asked._replace(seed=4)))  # another split's
    cut.dies.clear()
    data = list(job.calibrate(asked))[-1].data
    assert cut.made == ["new"] and cut.asked == [out, out] and data[ANALYSED_KEY] is True
    assert cut.steered == [out, out], "a map that is there is not learned again (tests/jobs/learn/test_steering.py)"
    assert data["sentence"] == f"{out}: 1 of 1 channels and 1 of 1 constants from the logs"
    with pytest.raises(InputError, match="exists already"):
        next(iter(job.calibrate(asked)))  # it is whole


@pytest.mark.parametrize(("missed", "says"), [({}, False), ({"speed": 0.02, "rate_of_speed": 0.46}, True)])
def test_the_closing_sentence_says_what_a_poor_model_misses_of_its_own_logs(
    missed: dict[str, float], says: bool
) -> None:
    card = {"actuators": {}, "constants": {}, "free_run_rms": {"held_out": None}}
    more = {"usual": {"missed": missed, "broken": [], "effects": {}}} if missed else {}
    sentence = summarise_calibration(Path("m"), VEHICLE, [Path("a.log")], card | more)["sentence"]
    assert ("the model misses rate_of_speed by 46% of the signal in its own calibration logs" in sentence) is says


def test_no_log_and_another_vehicles_log(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no log"):
        list(job.calibrate(CalibrateOptions([], "mkz_bywire", tmp_path / "new")))
    log = tmp_path / "a.log"
    log.write_text("".join(f"({0.01 * k:.6f}) can0 7FF#00\n" for k in range(500)))
    with pytest.raises(InputError, match="not one frame of vehicle 'mkz_bywire'"):
        list(job.calibrate(CalibrateOptions([log], "mkz_bywire", tmp_path / "new")))
    assert not (tmp_path / "new").exists()


def still() -> Drive:
    """Nobody touched anything."""
    n = 3000
    names = {"throttle_frac": 0.15, "brake_frac": 0.15, "steer_rad": 0.0}
    fields = {"report.speed_mps": np.full(n, 5.0)}
    for name, value in names.items():
        echo = name.replace("_", "_command_", 1)
        fields |= {key: np.full(n, value) for key in (f"command.{name}", f"report.{name}", f"report.{echo}")}
    ones = np.ones(n, dtype=bool)
    return Drive("still.log", "sha256:0", 0.01, fields, dict.fromkeys(fields, ones), ones)


@pytest.mark.slow
def test_commands_that_never_move_are_one_clear_message() -> None:
    split = DriveSplit((whole(still()),), (), "")
    with CompiledProcess() as worker, pytest.raises(InputError, match="no by-wire channel") as caught:
        list(fit_calibration(worker, split, VEHICLE))
    assert "constant" in caught.value.message and caught.value.file == "still.log" and "collect" in caught.value.hint


def test_a_short_drive_is_fitted_on_as_a_whole() -> None:
    split, events = ended(split_drives_for_fit([made_drive(8.0)], VEHICLE, 1))
    assert split.held_out == () and len(split.training) == 1
    assert events[0].kind == "warning" and "too short" in events[0].message


def test_an_effect_is_there_only_where_it_is_clear() -> None:
    assert is_significant(STEER_OFFSET, Estimate(0.03, 0.02, 0.04)) and not is_significant(
        STEER_OFFSET, Estimate(0.03, -0.01, 0.07)
    )
    assert not is_significant(STEER_OFFSET, Estimate(0.002, 0.001, 0.003)), "a trifle"
    assert not is_significant(BRAKE_DEAD_BAND, make_unidentified_estimate(0.05, "not shown"))
    assert effect_entry(BRAKE_DEAD_BAND, Estimate(0.05, 0.04, 0.06)) == {
        "name": "brake_dead_band",
        "params": {"half_width_frac": 0.05},
        "interval": {"half_width_frac": [0.04, 0.06]},
    }
    assert is_significant(POWERTRAIN_LAG, Estimate(0.2, 0.1, 0.3)) and not is_significant(
        POWERTRAIN_LAG, Estimate(0.2, 0.0, 0.4)
    )
    assert not is_significant(POWERTRAIN_LAG, Estimate(0.015, 0.01, 0.02)), "a trifle"
    made = effect_entry(POWERTRAIN_LAG, Estimate(0.2, 0.1, 0.3))
    assert made == {"name": "powertrain_lag", "params": {"tau_s": 0.2}, "interval": {"tau_s": [0.1, 0.3]}}
    assert set(FITTED_EFFECTS) == {STEER_OFFSET, BRAKE_DEAD_BAND, POWERTRAIN_LAG}


def test_a_channel_in_words() -> None:
    assert describe_channel(FIT).startswith("dead time 100.0 ms (90.0 to 110.0), second-order lag, 63 % in")
    taken = FIT._replace(dead_time_s=make_unidentified_estimate(0.1, "never moved"))
    assert "not from these logs" in describe_channel(taken)
