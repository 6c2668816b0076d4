"""What a model misses of its own logs: nothing is kept of one that comes near them, and of another all of it."""

from __future__ import annotations

import json
from collections.abc import Generator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from msgspec.structs import replace

from tests.gap.estimation.test_intervals import ALL, fitted
from tests.gap.made_answer import LATE_S, SECONDS, VEHICLE, late_drive, made_model
from tests.learn.actuators.test_samples import without
from tests.learn.made_drives import made_drive
from tunefree_hil.base.errors import PeerGone
from tunefree_hil.base.events import Event
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import EffectSpec, ModelSpec
from tunefree_hil.gap.calibration_logs import CalibrationLogs, named_vehicle_limits
from tunefree_hil.gap.estimation.calibration_priors import CalibrationPrior, read_calibration_prior
from tunefree_hil.gap.estimation.least_squares import FreeParameter
from tunefree_hil.gap.estimation.nuisance import CRITERIA as NUISANCE_CRITERIA
from tunefree_hil.gap.pipeline import FoundEffect
from tunefree_hil.gap.progress import SearchProgress, SearchStage
from tunefree_hil.gap.selection.baseline_misfit import BASELINE_KEY, INCONSISTENT_KEY, NO_BASELINE, baseline_of_model
from tunefree_hil.jobs.gap.calibration_logs import ANALYSED_KEY, analyse_calibration_logs, is_analysed, sample_drives
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.model_folder import (
    CALIBRATION_EFFECTS,
    CALIBRATION_LOGS,
    CARD_FILE,
    model_toml_from_spec,
    write_card,
    write_effects,
    write_model_copy,
)
from tunefree_hil.plant.data_sheet import DEFAULTS

NUMBERS = CalibrationPrior(("plant.drive_force_n",), np.array([0.03]), np.array([[1e-4]]))
YAW = "report.yaw_rate_radps"


def folder_of(folder: Path) -> Path:
    """The made car's model, with a card."""
    model = made_model()
    write_model_copy(
        folder, model, "", model_toml_from_spec(replace(model, plant=replace(model.plant, card=CARD_FILE))), {"seed": 1}
    )
    return folder


def asked(folder: Path, *drives: Drive) -> list[Event]:
    return list(analyse_calibration_logs(folder, VEHICLE, list(drives)))


def swinging(drive: Drive) -> Drive:
    """Its yaw rate is reported half as large again, and half as large, by turns: no effect of the catalogue does so."""
    by = 1.0 + 0.5 * np.sin(2.0 * np.pi * np.arange(drive.n_rows) * drive.dt_s / 9.0)
    return drive._replace(fields={**drive.fields, YAW: by * drive.fields[YAW]})


def test_logs_that_are_too_short_leave_the_model_as_it_is_and_say_so(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "model")
    events = asked(folder, made_drive(20.0, seed=3))
    assert [one.kind for one in events] == ["note"] and "not analysed" in events[0].message
    assert json.loads((folder / CARD_FILE).read_text()) == {"seed": 1, ANALYSED_KEY: True}
    assert is_analysed(folder)


def test_what_a_search_that_was_cut_off_had_written_is_forgotten_when_they_are_asked_again(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "model")
    mine = EffectSpec(name="grade", params={"grade_rad": 0.01}, provenance={"by": "a person"})
    write_effects(
        folder, load_model(folder), [mine, replace(mine, name="accel_bias", provenance={"by": CALIBRATION_LOGS})]
    )
    card = {
        "seed": 1,
        BASELINE_KEY: {"missed": {"yaw_rate": 0.5}, "broken": [], "effects": {}},
        CALIBRATION_EFFECTS: {},
    }
    card[INCONSISTENT_KEY] = {"brake_gain.gain_frac": 3.0}
    write_card(folder, card)
    asked(folder, made_drive(20.0, seed=3))
    assert json.loads((folder / CARD_FILE).read_text()) == {"seed": 1, ANALYSED_KEY: True}
    assert [one.name for one in load_model(folder).effects] == ["grade"]
    write_effects(folder, load_model(folder), [])
    assert load_model(folder).effects == []


def test_a_log_that_says_no_speed_is_left_out_and_leaves_a_whole_model(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "model")
    assert not is_analysed(folder)
    drive = made_drive(20.0, seed=3)
    dumb = without(drive, *(name for name in drive.fields if "speed" in name or name.startswith("ins.")))
    assert asked(folder, dumb) == [] and is_analysed(folder)
    assert "not analysed" in asked(folder, dumb, made_drive(20.0, seed=4))[0].message


def test_whatever_is_lost_while_they_are_asked_the_model_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(*_: object) -> None:
        raise PeerGone("the process that fits was killed")

    monkeypatch.setattr("tunefree_hil.gap.pipeline.locate", lost)
    folder = folder_of(tmp_path / "model")
    (event,) = asked(folder, made_drive(SECONDS, seed=5))
    assert "was killed" in event.message and is_analysed(folder)


@pytest.mark.parametrize(
    ("lengths_s", "some"),
    [
        ((20.0, 30.0), (0, 1)),
        ((500.0,) * 4, (1,)),
        ((60.0,) * 30, tuple(range(0, 30, 2))),
        ((2000.0,), (0,)),
        ((8.0, 1000.0), (1,)),
        ((5.0, 400.0, 5.0, 400.0, 5.0, 400.0), (1, 3, 5)),
        ((), ()),
    ],
)
def test_of_many_logs_some_are_asked_from_all_over_them(lengths_s: tuple[float, ...], some: tuple[int, ...]) -> None:
    short = made_drive(4.0)
    drives = [short._replace(dt_s=one / short.n_rows, name=str(i)) for i, one in enumerate(lengths_s)]
    assert [one.name for one in sample_drives(drives)] == [str(i) for i in some]


LIMIT = EffectSpec(
    name="power_limit",
    params={"power_w": 9e4},
    interval={"power_w": [8.8e4, 9.2e4]},
    provenance={"by": CALIBRATION_LOGS},
)


@pytest.mark.parametrize("broken", [True, False])
def test_a_limit_of_the_car_is_its_models_and_what_is_missed_beside_it_is_asked(
    broken: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The searches are made up: what they say of a car whose power is capped, and then beside the cap."""
    folder, seen = folder_of(tmp_path / "model"), list[int]()

    def looked(model: ModelSpec, *_: Any) -> Generator[SearchProgress, None, Any]:
        yield SearchProgress(SearchStage.RECALIBRATION, "all links")
        seen.append(len(model.effects))
        one = SimpleNamespace(is_broken=broken and not model.effects, text="rate_of_speed is missed by 19 %")
        return SimpleNamespace(links_before=[one], problem=None)

    def alone(one: CalibrationLogs) -> Generator[SearchProgress, None, list[EffectSpec]]:
        yield SearchProgress(SearchStage.CANDIDATES, "limits of the car")
        return [] if one.model.effects else [LIMIT]

    def named(*_: Any) -> Generator[SearchProgress, None, Any]:
        yield SearchProgress(SearchStage.CANDIDATES, "candidates")
        return SimpleNamespace(links_after=())

    monkeypatch.setattr("tunefree_hil.gap.pipeline.locate", looked)
    monkeypatch.setattr("tunefree_hil.gap.pipeline.diagnose", named)
    monkeypatch.setattr("tunefree_hil.gap.pipeline.find_inconsistent_gains", lambda _: {"brake_gain.gain_frac": 2.0})
    monkeypatch.setattr("tunefree_hil.gap.calibration_logs.find_vehicle_limits", alone)
    monkeypatch.setattr("tunefree_hil.gap.calibration_logs.prior_from_problem", lambda _: NUMBERS)
    monkeypatch.setattr("tunefree_hil.gap.calibration_logs.named_vehicle_limits", lambda *_: [LIMIT])
    for _ in range(2):  # asked again, it is found again and not added to itself
        events = asked(folder, made_drive(20.0, seed=3))
        assert load_model(folder).effects == [LIMIT]
        assert any("power_limit (power_w 9e+04)" in one.message for one in events)
        assert baseline_of_model(load_model(folder)).inconsistent_gains == {"brake_gain.gain_frac": 2.0}
        assert read_calibration_prior(load_model(folder)).keys == NUMBERS.keys
    assert seen == [0, 1, 0, 1]


@pytest.mark.parametrize(
    ("evidence", "faint", "has"),
    [(352.0, False, False), (50.0, False, False), (352.0, False, True), (90.0, True, False)],
)
def test_only_a_limit_that_is_plain_and_new_is_taken(evidence: float, faint: bool, has: bool) -> None:
    free = FreeParameter("power_limit.power_w", 1e4, 2e5, True, np.inf, -0.35, 1.35)
    model = made_model()
    found = SimpleNamespace(
        effects=[FoundEffect("power_limit", {}, evidence, faint), FoundEffect("grade", {}, 500.0)],
        repaired=SimpleNamespace(fit=fitted(free, curve=1e4, z=free.u_from_value(9e4))),
        problem=SimpleNamespace(blocks=SimpleNamespace(roles=np.zeros(len(ALL), dtype=int))),
    )
    own = named_vehicle_limits(cast(Any, found), replace(model, effects=[LIMIT]) if has else model)
    assert [one.name for one in own] == (["power_limit"] if evidence > 60.0 and not faint and not has else [])
    for one in own:
        low, high = one.interval["power_w"]
        assert low < one.params["power_w"] < high and one.params["power_w"] == pytest.approx(9e4)


def test_of_a_model_that_stays_poor_its_tyres_are_told_beside_its_sensors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The searches are made up: each is asked of the model with what the one before it found."""
    folder, seen, forces = folder_of(tmp_path / "model"), list[list[str]](), list[float]()
    tyres = replace(LIMIT, name="tyre_relaxation", params={"length_m": 0.3}, interval={"length_m": [0.28, 0.32]})
    bias = replace(LIMIT, name="accel_bias", params={"bias_mps2": 0.2}, interval={"bias_mps2": [0.19, 0.21]})

    def poor(*_: Any) -> Generator[SearchProgress, None, Any]:
        yield SearchProgress(SearchStage.CANDIDATES, "candidates")
        one = SimpleNamespace(is_broken=True, text="rate_of_speed is missed by 19 %")
        return SimpleNamespace(links_before=[one], links_after=[one], problem=None)

    def told(found: Any) -> Any:
        def search(one: CalibrationLogs) -> Generator[SearchProgress, None, Any]:
            yield SearchProgress(SearchStage.CANDIDATES, "asked")
            seen.append([effect.name for effect in one.model.effects])
            forces.append({**DEFAULTS, **one.model.plant.params}["drive_force_n"])
            return found

        return search

    monkeypatch.setattr("tunefree_hil.gap.pipeline.locate", poor)
    monkeypatch.setattr("tunefree_hil.gap.pipeline.diagnose", poor)
    monkeypatch.setattr("tunefree_hil.gap.pipeline.find_inconsistent_gains", lambda _: {})
    monkeypatch.setattr("tunefree_hil.gap.calibration_logs.prior_from_problem", lambda _: NUMBERS)
    for name, found in (
        ("find_sensor_effects", [bias]),
        ("find_tyre_effects", [tyres]),
        ("measure_baseline_misfit", NO_BASELINE),
    ):
        monkeypatch.setattr(f"tunefree_hil.gap.calibration_logs.{name}", told(found))
    events = asked(folder, made_drive(20.0, seed=3))
    assert load_model(folder).effects == [bias, tyres]
    assert seen == [[], ["accel_bias"], ["accel_bias", "tyre_relaxation"]]
    assert forces[-1] == pytest.approx(np.exp(0.03) * forces[-2]), "what is usual is so of the model that `gap` has"
    assert read_calibration_prior(load_model(folder)).keys == NUMBERS.keys
    assert any("tyres, from the calibration logs: tyre_relaxation (length_m 0.3)" in one.message for one in events)


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.timeout(900)
def test_a_model_that_comes_near_its_logs_keeps_nothing(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "model")
    events = asked(folder, made_drive(SECONDS, seed=5))
    assert {one.kind for one in events} == {"progress"} and all(one.data["label"] for one in events)
    assert baseline_of_model(load_model(folder)) == NO_BASELINE
    own = read_calibration_prior(load_model(folder))
    bend = own.keys.index("linkage.bend")
    assert np.sqrt(own.covariance[bend, bend]) < 0.75 * NUISANCE_CRITERIA.max_bend_sigma, (
        "more than anybody knew before"
    )


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.timeout(900)
def test_of_a_model_that_misses_its_logs_what_it_misses_is_kept_and_its_sensors_are_told(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "model")
    drive = swinging(made_drive(SECONDS, seed=5))
    accel = "report.accel_mps2"
    events = asked(folder, drive._replace(fields={**drive.fields, accel: drive.fields[accel] + 0.4}))
    (bias,) = (one for one in load_model(folder).effects if one.name == "accel_bias")
    low, high = bias.interval["bias_mps2"]
    assert low < bias.params["bias_mps2"] < high and bias.params["bias_mps2"] == pytest.approx(0.4, abs=0.02)
    assert any("accel_bias (bias_mps2 0.4" in one.message for one in events if one.kind == "note")
    assert any(one.kind == "warning" and "for no reason in the catalogue" in one.message for one in events)
    usual = baseline_of_model(load_model(folder))
    assert max(usual.misfit.values()) > 0.1 and {"speed_scale", "steer_gain", "grade"} <= set(usual.effects)
    assert json.loads((folder / CARD_FILE).read_text())["seed"] == 1
    assert usual.effects["accel_bias"]["bias_mps2"][0] == pytest.approx(0.0, abs=0.02), "beside what the model has now"


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.timeout(900)
def test_what_explains_the_own_logs_is_kept_and_said(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "model")
    events = asked(folder, late_drive())
    usual = baseline_of_model(load_model(folder))
    assert not usual.misfit and usual.explaining["steer_dead_time"]["delay_s"][0] == pytest.approx(LATE_S, abs=0.01)
    assert load_model(folder).effects == []
    assert events[-1].kind == "warning" and "steer_dead_time; `gap` on these logs adds it if" in events[-1].message
    drive, accel = made_drive(SECONDS, seed=5), "report.accel_mps2"
    off = drive._replace(fields={**drive.fields, accel: drive.fields[accel] - 0.06})
    events = asked(folder_of(tmp_path / "tilted"), off)
    assert "accel_bias may also be a grade that is common to all of them" in events[-1].message
