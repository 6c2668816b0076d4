"""A car that is asked for an acceleration and has no gyro: tracks, channels, free run beside the plainest guess."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.learn.made_bare import ACCEL, MASS_KG, accel_drive
from tests.learn.made_drives import whole
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.config.schema import ActuatorSpec, ModelSpec, NominalSpec, PlantSpec, VehicleSpec
from tunefree_hil.learn.actuators.identify import model_channels
from tunefree_hil.learn.data_sheet import make_constant_priors, make_fixed_params
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.evaluation.motion import MotionTrack, make_motion_track, simulate_actuators
from tunefree_hil.learn.evaluation.velocity_free_run import CONSTANT_SPEED, VelocityErrors, evaluate_velocities
from tunefree_hil.plant.actuation.acceleration_interface import FULL_MPS2
from tunefree_hil.plant.data_sheet import DEFAULTS


@pytest.fixture(scope="module")
def vehicle(repo: Path) -> VehicleSpec:
    """A folder of such a car, with the tick of the drives here."""
    spec = load_vehicle(repo / "dbc" / "rav4_2017", check=False)
    nominal = NominalSpec(
        mass_kg=MASS_KG, wheelbase_m=DEFAULTS["wheelbase_m"], front_axle_m=DEFAULTS["front_axle_m"],
        wheel_radius_m=DEFAULTS["wheel_radius_m"], track_m=DEFAULTS["track_m"], steer_ratio=16.0,
    )  # fmt: skip
    return msgspec.structs.replace(spec, nominal=nominal, tick_ms=10)


@pytest.fixture(scope="module")
def drive() -> Drive:
    return accel_drive(40.0)


@pytest.fixture(scope="module")
def track(drive: Drive, vehicle: VehicleSpec) -> MotionTrack:
    return make_motion_track(whole(drive), vehicle)


def model_of(vehicle: VehicleSpec) -> ModelSpec:
    channel = ActuatorSpec(dead_time_s=ACCEL.dead_time_s, lag_s=ACCEL.lag_s, gain=ACCEL.gain)
    params = make_fixed_params(vehicle) | {name: one.value for name, one in make_constant_priors(vehicle).items()}
    params |= {name: DEFAULTS[name] for name in ("yaw_inertia_kgm2",)}
    return ModelSpec(
        schema="tunefree.model/1", vehicle=vehicle.name, actuators={"accel": channel, "steer": ActuatorSpec()},
        plant=PlantSpec(kind="physics", params=params),
    )  # fmt: skip


def run(models: dict[str, ModelSpec], vehicle: VehicleSpec, tracks: list[MotionTrack]) -> VelocityErrors:
    steps = evaluate_velocities(models, vehicle, tracks, 4.0)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def test_a_car_without_pedals_has_other_channels_and_no_drive_to_fit(vehicle: VehicleSpec) -> None:
    assert model_channels(vehicle) == ["steer", "accel", "steer_torque"]
    assert set(make_constant_priors(vehicle)) == {
        "front_stiffness_n_per_rad", "rear_stiffness_n_per_rad", "yaw_inertia_kgm2", "steer_ratio", "linkage_bend",
    }  # fmt: skip
    assert make_fixed_params(vehicle)["brake_force_n_per_frac"] == FULL_MPS2 * MASS_KG


def test_the_yaw_rate_is_that_of_the_rear_wheels(track: MotionTrack, drive: Drive, vehicle: VehicleSpec) -> None:
    rolling = track.speed_mps * np.tan(drive.fields["report.steer_rad"] / 16.0) / DEFAULTS["wheelbase_m"]
    middle = slice(100, 3900)
    assert np.corrcoef(track.yaw_rate_radps[middle], rolling[middle])[0, 1] > 0.97
    assert track.is_good[50:3950].all() and track.accel_demand_mps2 is not None
    nameless = msgspec.structs.replace(vehicle, nominal=msgspec.structs.replace(vehicle.nominal, track_m=None))
    with pytest.raises(InputError, match="yaw_rate"):
        make_motion_track(whole(drive), nameless)


def test_pedals_are_what_the_channel_makes_of_the_acceleration(track: MotionTrack, vehicle: VehicleSpec) -> None:
    outputs = simulate_actuators(track, model_of(vehicle), 0.0)
    accel = FULL_MPS2 * (outputs[:, 0] - outputs[:, 1])
    assert (np.minimum(outputs[3:, 0], outputs[3:, 1]) == 0.0).all()
    assert np.abs(accel[300:3900] - track.accel_mps2[300:3900]).mean() < 0.1
    static = FULL_MPS2 * (track.commands[:, 0] - track.commands[:, 1])
    assert np.allclose(static[3:], track.accel_demand_mps2[3:])  # type: ignore[index]


def test_free_run_beats_keeping_the_speed(track: MotionTrack, vehicle: VehicleSpec) -> None:
    ahead = run({"physics": model_of(vehicle)}, vehicle, [track])
    assert (
        set(ahead.speed_mps) == {"physics", CONSTANT_SPEED}
        and len(ahead.drive_names) == len(ahead.speed_mps[CONSTANT_SPEED]) >= 7
    )
    last = ahead.speed_mps["physics"][:, 2]
    assert np.isnan(last).any() and np.nanmax(last) < 0.5, "near the end there is no room for 10 s"
    assert np.nanmean(ahead.speed_mps[CONSTANT_SPEED][:, 2]) > 5.0 * np.nanmean(last)
    assert np.nanmean(ahead.yaw_rate_radps["physics"][:, 1]) < np.nanmean(ahead.yaw_rate_radps[CONSTANT_SPEED][:, 1])
    (trace,) = ahead.traces
    assert (
        len(trace.speeds["physics"]) == len(trace.time_s) == 1001
        and trace.speeds[CONSTANT_SPEED][5] == trace.speed_mps[0]
    )


def test_where_nobody_obeyed_no_start_is_taken(drive: Drive, vehicle: VehicleSpec) -> None:
    enabled = drive.enabled.copy()
    enabled[1500:] = False
    ahead = run(
        {"physics": model_of(vehicle)}, vehicle, [make_motion_track(whole(drive._replace(enabled=enabled)), vehicle)]
    )
    assert len(ahead.drive_names) in (3, 4) and np.isnan(ahead.speed_mps["physics"][-1, 2])
    never = make_motion_track(whole(drive._replace(enabled=~drive.enabled)), vehicle)
    with pytest.raises(InputError, match="no stretch"):
        run({"physics": model_of(vehicle)}, vehicle, [never])
