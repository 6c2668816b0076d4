"""A repaired model drives as the search's graph said: what is folded into constants means the same there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from tests.gap.made_answer import LATE_S, VEHICLE, late_drive, made_kept, made_model
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import ActuatorSpec, EffectSpec, Interval, ModelSpec
from tunefree_hil.gap.measured.chain import MeasuredDrive, build_measured_drive
from tunefree_hil.gap.model.graph import LINKAGE_BEND_KEY, LINKAGE_BEND_PARAM
from tunefree_hil.gap.validation.free_run import assemble_car, simulate_recording
from tunefree_hil.gap.validation.repair import effect_specs, merge_pedal_moves, repair_model, write_repaired_model
from tunefree_hil.learn.model_folder import model_toml_from_spec, write_model_copy

MOVED = {
    "throttle_gain.gain_frac": 0.93,
    "brake_gain.gain_frac": 1.05,
    "steer_gain.gain_frac": 0.97,
    "steer_offset.offset_rad": 0.02,
    "front_stiffness.gain_frac": 1.1,
    "rear_stiffness.gain_frac": 0.9,
    "rolling_resistance.extra_frac": 0.3,
    "aero_drag.drag_area_m2": 0.2,
}


def opened() -> MeasuredDrive:
    return build_measured_drive(late_drive(20.0), VEHICLE)


def free(drive: MeasuredDrive) -> np.ndarray:
    held = np.ones(drive.ticks, dtype=bool)
    held[300:] = False
    return held


@pytest.mark.parametrize("found", [[], [EffectSpec(name="steer_offset", params={"offset_rad": 0.03})]])
def test_constants_that_were_moved_drive_as_the_effects_would(found: list[EffectSpec]) -> None:
    drive, model = opened(), made_model()
    moved = {key: value for key, value in MOVED.items() if not found or not key.startswith("steer_offset")}
    made = repair_model(model, VEHICLE, moved, found)
    effects = [*found]
    for key, value in moved.items():
        name, _, parameter = key.partition(".")
        effects.append(EffectSpec(name=name, params={parameter: value}))
    ours = simulate_recording(assemble_car(made.model, VEHICLE, drive), drive, free(drive))
    effects.sort(key=lambda one: one.name)
    theirs = simulate_recording(assemble_car(model, VEHICLE, drive, effects), drive, free(drive))
    for name in ("report.speed_mps", "report.yaw_rate_radps", "report.lateral_accel_mps2", "ins.x_m"):
        assert ours[name] == pytest.approx(theirs[name], abs=1e-7), name
    assert not np.allclose(
        ours["ins.x_m"], simulate_recording(assemble_car(model, VEHICLE, drive), drive, free(drive))["ins.x_m"]
    )
    names = [one.name for one in made.model.effects]
    assert names == (["steer_gain", "steer_offset"] if found else ["steer_offset"]), "the rest is in the constants"


def test_a_brake_that_pulls_more_than_in_proportion_is_moved_as_its_effect_would() -> None:
    drive, model = opened(), made_model()
    model = replace(model, plant=replace(model.plant, params={**model.plant.params, "brake_rise_per_frac": 3.0}))
    made = repair_model(model, VEHICLE, {"brake_gain.gain_frac": 0.8})
    gain = EffectSpec(name="brake_gain", params={"gain_frac": 0.8})
    ours = simulate_recording(assemble_car(made.model, VEHICLE, drive), drive, free(drive))
    theirs = simulate_recording(assemble_car(model, VEHICLE, drive, [gain]), drive, free(drive))
    assert made.model.plant.params["brake_rise_per_frac"] == pytest.approx(2.4)
    assert ours["report.speed_mps"] == pytest.approx(theirs["report.speed_mps"], abs=1e-7)


def test_the_linkages_bend_is_a_constant_of_the_car() -> None:
    made = repair_model(made_model(), VEHICLE, {LINKAGE_BEND_KEY: 0.2}, [])
    assert made.model.plant.params[LINKAGE_BEND_PARAM] == 0.2 and made.model.effects == [] and made.day_effects == ()
    assert [(one.key, one.after) for one in made.changes] == [(f"plant.params.{LINKAGE_BEND_PARAM}", 0.2)]


def test_what_is_of_the_day_is_not_written() -> None:
    made = repair_model(
        made_model(), VEHICLE, {"grade.grade_rad": 0.001, "accel_bias.bias_mps2": 0.02, "clock.ins_s": 0.1}
    )
    assert [one.name for one in made.day_effects] == ["grade", "accel_bias"]
    assert made.changes == () and made.model.effects == [] and made.model.plant == made_model().plant


def test_numbers_of_a_channel_keep_the_width_of_their_interval() -> None:
    model = made_model()
    steer = replace(model.actuators["steer"], dead_time_s=Interval(value=0.1, low=0.09, high=0.11))
    values = {"actuator.steer.dead_time_s": 0.02, "actuator.steer.lag_s": 0.1, "plant.drive_force_n": -0.1}
    made = repair_model(replace(model, actuators={**model.actuators, "steer": steer}), VEHICLE, values)
    moved = made.model.actuators["steer"]
    assert isinstance(moved.dead_time_s, Interval) and moved.dead_time_s.low == pytest.approx(0.11)
    assert moved.lag_s == pytest.approx(0.09 * np.exp(0.1)) and moved.gain == 1.0
    keys = {one.key: (one.before, one.after) for one in made.changes}
    assert set(keys) == {"plant.params.drive_force_n", "actuators.steer.dead_time_s", "actuators.steer.lag_s"}
    assert keys["plant.params.drive_force_n"] == (6500.0, pytest.approx(6500.0 * np.exp(-0.1)))


def test_the_folder_is_a_normal_model_with_interval_and_provenance(tmp_path: Path) -> None:
    model, kept = made_model(), made_kept()
    made = repair_model(model, VEHICLE, kept.repaired_values, effect_specs(kept, "sha256:1", "0.0.1"))
    written = write_repaired_model(tmp_path / "model", model, made.model, {"logs": ["a"]})
    assert load_model(tmp_path / "model") == written and written.vehicle_hash == model.vehicle_hash
    (effect,) = written.effects
    assert (effect.name, effect.params) == ("steer_dead_time", {"delay_s": LATE_S})
    assert effect.interval == {"delay_s": [LATE_S - 0.001, LATE_S + 0.001]}
    assert effect.provenance == {"log": "sha256:1", "seed": 1, "version": "0.0.1"}
    assert json.loads((tmp_path / "model" / "card.json").read_text())["repair"] == {"logs": ["a"]}
    beside = {path.name for path in Path(model.folder).glob("*.npz")}
    assert beside and beside <= {path.name for path in (tmp_path / "model").iterdir()}
    assert [path.name for path in tmp_path.iterdir()] == ["model"]
    with pytest.raises(InputError, match="exists already"):
        write_repaired_model(tmp_path / "model", model, made.model, {})


def test_what_the_old_model_missed_of_its_own_logs_is_not_the_repaired_ones(tmp_path: Path) -> None:
    made = made_model()
    card = {"seed": 3, "usual": {"missed": {"yaw_rate": 0.5}}, "own_effects": {}}
    write_model_copy(
        tmp_path / "old",
        made,
        "",
        model_toml_from_spec(replace(made, plant=replace(made.plant, card="card.json"))),
        card,
    )
    old = load_model(tmp_path / "old")
    write_repaired_model(tmp_path / "new", old, old, {"logs": []})
    assert json.loads((tmp_path / "new" / "card.json").read_text()) == {"seed": 3, "repair": {"logs": []}}


def by_accel(**accel: float) -> ModelSpec:
    """The made car as one that is asked for an acceleration."""
    made = made_model()
    own = {"accel": ActuatorSpec(**accel), "steer": made.actuators["steer"]}  # pyright: ignore[reportArgumentType]
    return replace(made, actuators=own)


def test_what_was_moved_of_two_pedals_is_moved_of_the_one_channel_of_a_car_that_has_none() -> None:
    values = {
        "actuator.throttle.lag_s": 0.2, "actuator.brake.lag_s": 0.1, "actuator.throttle.offset": 0.004,
        "actuator.brake.offset": 0.001, "actuator.brake.dead_time_s": 0.02, "actuator.steer.lag_s": 0.3,
    }  # fmt: skip
    assert merge_pedal_moves(made_model(), values) is values
    found = repair_model(by_accel(lag_s=0.4), VEHICLE, values).model.actuators
    assert found["accel"].lag_s == pytest.approx(0.4 * np.exp(0.15)) and found["accel"].dead_time_s == 0.01
    assert found["accel"].offset == pytest.approx(10.0 * (0.004 - 0.001))
    assert found["steer"].lag_s == pytest.approx(0.09 * np.exp(0.3))


def test_the_proof_of_a_car_that_is_asked_for_an_acceleration_has_its_dead_time_and_lag() -> None:
    drive = opened()
    said = {
        name: simulate_recording(assemble_car(model, VEHICLE, drive), drive, free(drive))["report.speed_mps"]
        for name, model in {
            "quick": by_accel(), "slow": by_accel(dead_time_s=0.3, lag_s=0.5),
            "deaf": replace(by_accel(), effects=[EffectSpec(name="throttle_lag", params={"tau_s": 0.8})]),
        }.items()
    }  # fmt: skip
    assert np.abs(said["slow"] - said["quick"]).max() > 0.05
    assert np.array_equal(said["deaf"], said["quick"]), "a bench does not hear it either"
