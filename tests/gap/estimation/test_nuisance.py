"""What recalibration may move, and how far."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.gap.estimation.least_squares import FreeParameter, LeastSquaresProblem
from tunefree_hil.gap.estimation.nuisance import (
    BRAKE_RISE,
    CONSTANT_SIGMAS,
    CRITERIA,
    DAILY_EFFECTS,
    DRIFT_SIGMAS,
    Nuisance,
    build_nuisances,
    prior_correlation,
    read_constant_correlations,
    read_constant_sigmas,
    read_drift_share,
)
from tunefree_hil.gap.model.card import load_model_card
from tunefree_hil.gap.model.graph import LINKAGE_BEND_KEY, LINKAGE_BEND_PARAM, EffectGraph


@pytest.mark.parametrize("text", ["no json", "[1, 2]", '{"constants": 3}'])
def test_an_invalid_card_is_an_input_error_for_every_reader(tmp_path: Path, text: str) -> None:
    model = load_model("mkz_nominal")
    model = replace(model, folder=str(tmp_path), plant=replace(model.plant, card="card.json"))
    assert load_model_card(replace(model, plant=replace(model.plant, card=""))) == {}, "none is named"
    with pytest.raises(InputError, match="is not there") as missing:
        load_model_card(model)
    assert missing.value.key == "plant.card" and missing.value.file == f"{tmp_path}/model.toml"
    (tmp_path / "card.json").write_text(text)
    with pytest.raises(InputError) as refused:
        read_constant_sigmas(model)
    assert refused.value.code == "bad_card" and "card.json" in str(refused.value.file)


def test_the_doubt_of_a_calibration_may_be_recalibrated_up_to_a_limit(tmp_path: Path) -> None:
    model, vehicle = load_model("mkz_nominal"), load_vehicle("mkz_bywire")
    model = replace(model, folder=str(tmp_path), plant=replace(model.plant, card="card.json"))
    ends = {"brake_force_n_per_frac": 0.04, "yaw_inertia_kgm2": 2.0, "drive_force_n": 0.5}  # logarithms, 95 %
    said = {name: {"low": math.exp(-by), "high": math.exp(by)} for name, by in ends.items()}
    (tmp_path / "card.json").write_text(json.dumps({"constants": said}))
    found = {
        one.key: one.sigma
        for one in build_nuisances(EffectGraph(model, vehicle, 0.01), model, read_constant_sigmas(model))
    }
    assert 0.04 / 1.96 < found["brake_gain.gain_frac"] < 2.0 * 0.04 / 1.96
    assert found["plant.yaw_inertia_kgm2"] == math.hypot(
        CRITERIA.max_constant_sigma, CONSTANT_SIGMAS["yaw_inertia_kgm2"]
    )
    assert found["plant.drive_force_n"] == CONSTANT_SIGMAS["drive_force_n"], (
        "only its combination with the knee is known"
    )


def calibrated(speed_mps: float, known: bool = True) -> dict[str, Any]:
    """A card of `calibrate` with this speed error of its free runs."""
    fitted = {"training": {"fitted": {"speed_mps": speed_mps}}}
    return {"constants": {"steer_ratio": {"known": known}, "rolling_frac": {"known": False}}, "free_run_rms": fitted}


def learned(*speeds_mps: float) -> dict[str, Any]:
    """A card of `learn`, of drives on the level and on hills."""
    runs = {str(i): {"starts": 9, "10": {"speed_mps": {"mean": by}}} for i, by in enumerate(speeds_mps)}
    return {"kind": "hybrid", "free_run": {"hybrid": {"kind": "hybrid", "one_step": {}, "hills": None, **runs}}}


@pytest.mark.parametrize(
    ("card", "pace", "held"),
    [
        (calibrated(0.2 * CRITERIA.exact_speed_rms_mps), 1.0, CRITERIA.min_drift_share),
        (calibrated(CRITERIA.exact_speed_rms_mps), 1.0, CRITERIA.min_drift_share),
        (calibrated(2.0 * CRITERIA.exact_speed_rms_mps), 1.0, 2.0 * CRITERIA.min_drift_share),
        (calibrated(20.0 * CRITERIA.exact_speed_rms_mps), 1.0, 1.0),
        (calibrated(0.2 * CRITERIA.exact_speed_rms_mps, known=False), 1.0, 1.0),
        (calibrated(CRITERIA.exact_speed_rms_mps), 0.1, 1.0),
        (
            learned(0.2 * CRITERIA.exact_speed_rms_mps, 3.0 * CRITERIA.exact_speed_rms_mps),
            1.0,
            3.0 * CRITERIA.min_drift_share,
        ),
        (learned(0.5 * CRITERIA.exact_speed_rms_mps), 1.0, CRITERIA.min_drift_share),
        (learned(), 1.0, 1.0),
        ({}, 1.0, 1.0),
    ],
)
def test_the_drift_share_follows_from_the_free_run_error(
    tmp_path: Path, card: dict[str, Any], pace: float, held: float
) -> None:
    model = load_model("mkz_nominal")
    assert read_drift_share(model) == 1.0, "no card"
    model = replace(model, folder=str(tmp_path), plant=replace(model.plant, card="card.json"))
    (tmp_path / "card.json").write_text(json.dumps(card))
    assert read_drift_share(model, pace) == pytest.approx(held)


@pytest.mark.parametrize("card", [{"free_run_rms": {}}, {"free_run": 3}, {"kind": "hybrid", "free_run": {"hybrid": 3}}])
def test_a_card_without_valid_free_runs_is_an_input_error(tmp_path: Path, card: dict[str, Any]) -> None:
    model = load_model("mkz_nominal")
    model = replace(model, folder=str(tmp_path), plant=replace(model.plant, card="card.json"))
    (tmp_path / "card.json").write_text(json.dumps(card))
    with pytest.raises(InputError, match="card"):
        read_drift_share(model)


def test_the_drift_share_reduces_the_drift_and_not_the_doubt_of_the_calibration(tmp_path: Path) -> None:
    model, vehicle = load_model("mkz_nominal"), load_vehicle("mkz_bywire")
    model = replace(model, folder=str(tmp_path), plant=replace(model.plant, card="card.json"))
    (tmp_path / "card.json").write_text(json.dumps({"constants": {"steer_ratio": {"low": 0.8, "high": 1.25}}}))
    graph, doubts = EffectGraph(model, vehicle, 0.01), read_constant_sigmas(model)
    free, held = (
        {one.key: one.sigma for one in build_nuisances(graph, model, doubts, by)}
        for by in (1.0, CRITERIA.min_drift_share)
    )
    for key in (one for one in DRIFT_SIGMAS if one.partition(".")[0] in DAILY_EFFECTS and one in free):
        assert held[key] == free[key], "no calibration removes an effect of the day"
    for key in ("throttle_gain.gain_frac", "rolling_resistance.extra_frac", "yaw_rate_scale.scale_frac"):
        assert held[key] == pytest.approx(CRITERIA.min_drift_share * free[key]) and free[key] == DRIFT_SIGMAS[key]
    assert held["steer_gain.gain_frac"] == pytest.approx(free["steer_gain.gain_frac"], rel=0.02)
    assert held["clock.ins_s"] == free["clock.ins_s"] and held[LINKAGE_BEND_KEY] == free[LINKAGE_BEND_KEY]


def test_side_wind_on_a_model_car_scales_with_its_mass() -> None:
    model, vehicle = load_model("mkz_nominal"), load_vehicle("mkz_bywire")
    light = replace(model, plant=replace(model.plant, params={**model.plant.params, "mass_kg": 1.8}))
    (heavy_n, light_n) = (
        next(n for n in build_nuisances(EffectGraph(one, vehicle, 0.01), one, {}) if n.key == "side_wind.force_n")
        for one in (model, light)
    )
    assert light_n.sigma == light_n.drift_sigma == pytest.approx(0.008) and 8.0 < heavy_n.sigma < 10.0


def test_correlated_constants_are_recalibrated_together(tmp_path: Path) -> None:
    model, vehicle = load_model("mkz_nominal"), load_vehicle("mkz_bywire")
    model = replace(model, folder=str(tmp_path), plant=replace(model.plant, card="card.json"))
    names = ("drive_force_n", "drive_knee_frac", "steer_ratio", "front_stiffness_n_per_rad")
    said = {name: {"low": math.exp(-0.2), "high": math.exp(0.2)} for name in names}
    rows = np.eye(4)
    rows[0, 1] = rows[1, 0] = rows[2, 3] = rows[3, 2] = 0.95
    together = {"names": names, "correlation": rows.tolist()}
    (tmp_path / "card.json").write_text(json.dumps({"constants": said, "constants_together": together}))
    found = build_nuisances(EffectGraph(model, vehicle, 0.01), model, read_constant_sigmas(model))
    r = prior_correlation(found, read_constant_correlations(model))
    place = {one.key: i for i, one in enumerate(found)}
    force, knee = place["plant.drive_force_n"], place["plant.drive_knee_frac"]
    assert found[force].sigma > 5.0 * CONSTANT_SIGMAS["drive_force_n"] and 0.85 < r[force, knee] < 0.95
    steer, front = place["steer_gain.gain_frac"], place["front_stiffness.gain_frac"]
    assert -0.95 < r[steer, front] < -0.85, "more steering gain is a lesser ratio"
    assert np.linalg.eigvalsh(r).min() > 0.0 and np.array_equal(r, r.T)
    assert np.array_equal(r[place["grade.grade_rad"]], np.eye(len(found))[place["grade.grade_rad"]])

    problem = LeastSquaresProblem(None, found, r)  # pyright: ignore[reportArgumentType]
    keys = [one.key for one in found]
    whole = problem.prior_precision(keys, ())
    along, across = np.zeros(len(keys)), np.zeros(len(keys))
    along[[force, knee]], across[[force, knee]] = (1.0, 1.0), (1.0, -1.0)
    assert across @ whole @ across > 5.0 * (along @ whole @ along), "moving one alone costs"
    loose = FreeParameter("plant.drive_knee_frac", 0.0, 1.0, False, 0.0, 0.0, 1.0)
    assert abs(problem.prior_precision(keys, (loose,))[force, force] - 1.0) < 1e-9, (
        "the price without the other: its own"
    )
    assert not problem.prior_precision(keys, (loose,))[knee].any()


@pytest.mark.parametrize("said", [{"names": ["a"], "correlation": []}, {"names": ["a"]}, [1], {"names": "a"}])
def test_a_card_with_invalid_correlations_is_an_input_error(tmp_path: Path, said: Any) -> None:
    model = load_model("mkz_nominal")
    model = replace(model, folder=str(tmp_path), plant=replace(model.plant, card="card.json"))
    (tmp_path / "card.json").write_text(json.dumps({"constants": {}, "constants_together": said}))
    with pytest.raises(InputError) as refused:
        read_constant_correlations(model)
    assert refused.value.code == "bad_card"


@pytest.mark.parametrize(("said", "least", "most"), [((-0.4, 0.4), 0.2, 0.2), ((0.24, 0.26), 0.08, 0.09)])
def test_the_linkage_is_recalibrated_within_the_doubt_of_the_calibration(
    tmp_path: Path, said: tuple[float, float], least: float, most: float
) -> None:
    model, vehicle = load_model("mkz_nominal"), load_vehicle("mkz_bywire")
    alone = {
        one.key: one.sigma
        for one in build_nuisances(EffectGraph(model, vehicle, 0.01), model, read_constant_sigmas(model))
    }
    model = replace(model, folder=str(tmp_path), plant=replace(model.plant, card="card.json"))
    graph = EffectGraph(model, vehicle, 0.01)
    (tmp_path / "card.json").write_text(
        json.dumps({"constants": {LINKAGE_BEND_PARAM: dict(zip(("low", "high"), said, strict=True))}})
    )
    found = {one.key: one.sigma for one in build_nuisances(graph, model, read_constant_sigmas(model))}
    assert alone[LINKAGE_BEND_KEY] == CRITERIA.max_bend_sigma and least <= found[LINKAGE_BEND_KEY] <= most


@pytest.mark.parametrize(("said", "sigma"), [((-0.02, 0.02), 0.0144), ((-3.0, 3.0), 0.15), (None, 0.0)])
def test_a_constant_that_may_be_zero_is_recalibrated_in_its_own_unit(
    tmp_path: Path, said: tuple[float, float] | None, sigma: float
) -> None:
    model, vehicle = load_model("mkz_nominal"), load_vehicle("mkz_bywire")
    model = replace(model, folder=str(tmp_path), plant=replace(model.plant, card="card.json"))
    constants = {} if said is None else {BRAKE_RISE: dict(zip(("low", "high"), said, strict=True))}
    (tmp_path / "card.json").write_text(json.dumps({"constants": constants}))
    found = {
        one.key: one.sigma
        for one in build_nuisances(EffectGraph(model, vehicle, 0.01), model, read_constant_sigmas(model))
    }
    assert found.get(f"plant.{BRAKE_RISE}", 0.0) == pytest.approx(sigma, rel=0.01)
    assert "plant.overrun_force_n" not in found, "this car has none, and a share of it is zero"


def test_drifts_are_not_correlated() -> None:
    one, other = (Nuisance(key, 0.0, 0.05, 0.03, key) for key in "ab")
    related = {"a": {"a": 1.0, "b": 0.8}, "b": {"a": 0.8, "b": 1.0}}
    assert abs(prior_correlation((one, other), related)[0, 1] - 0.8 * 0.36) < 1e-12
    assert prior_correlation((one, other._replace(constant="")), related)[0, 1] == 0.0


def test_the_linkage_is_recalibrated_where_a_model_can_be_written_with_it() -> None:
    model = load_model("mkz_nominal")
    graph = EffectGraph(model, load_vehicle("mkz_bywire"), 0.01)
    assert LINKAGE_BEND_KEY in {one.key for one in build_nuisances(graph, model, {})}
    others = {key: value for key, value in graph.plant.defaults.items() if key != LINKAGE_BEND_PARAM}
    graph.plant = graph.plant._replace(defaults=others)
    assert LINKAGE_BEND_KEY not in {one.key for one in build_nuisances(graph, model, {})}
