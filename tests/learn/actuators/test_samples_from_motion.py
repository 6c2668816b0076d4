"""Channels without a reported output: what the motion shows of them."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.learn.made_bare import bare_drive
from tests.learn.made_drives import whole
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.learn.actuators.identify import (
    collect_channel,
    fit_from_data_sheet,
    model_channels,
    restrict_to_motion,
)
from tunefree_hil.learn.actuators.samples_from_motion import (
    MOTION_DESCRIPTION,
    fit_motion_law,
    samples_from_motion,
    suggest_plant_constants,
)
from tunefree_hil.learn.data_sheet import make_constant_priors, make_fixed_params, read_channel_sheet
from tunefree_hil.learn.drives.drive import Drive, DriveSplit
from tunefree_hil.learn.estimate import Estimate
from tunefree_hil.learn.physics.windows import extract_windows


@pytest.fixture(scope="module")
def vehicle(repo: Path) -> VehicleSpec:
    return load_vehicle(repo / "dbc" / "mkz_bywire")


@pytest.fixture(scope="module")
def drive() -> Drive:
    return bare_drive(90.0, seed=3)


def test_the_laws_explain_what_the_commands_do(drive: Drive, vehicle: VehicleSpec) -> None:
    throttle, steer = (fit_motion_law([whole(drive)], channel, vehicle) for channel in ("throttle", "steer"))
    brake = fit_motion_law([whole(drive)], "brake", vehicle)
    assert throttle is not None and steer is not None and brake is not None
    assert throttle.explained_share > 0.6 and brake.explained_share > 0.6 and steer.explained_share > 0.8
    assert steer.steer_ratio == pytest.approx(16.0, rel=0.2), (
        "tyres slip: a little more wheel per angle than rolling needs"
    )
    assert 5 <= steer.command_delay_ticks <= 40, (
        "dead time and lag of the channel are 0.2 s together, and the wire's own ticks"
    )


def test_pairs_carry_the_delay(drive: Drive, vehicle: VehicleSpec) -> None:
    law = fit_motion_law([whole(drive)], "steer", vehicle)
    assert law is not None
    pairs = samples_from_motion([whole(drive)], law, vehicle)
    assert (
        pairs.description == MOTION_DESCRIPTION
        and pairs.n_rows > 3000
        and all(pair.filter_ticks for pair in pairs.segments)
    )
    pair = max(pairs.segments, key=lambda one: len(one.command))
    shares = [
        float(np.corrcoef(pair.command[200 - k : -200 - k], pair.output[200:-200])[0, 1]) for k in (0, 10, 20, 30, 60)
    ]
    assert max(shares) == max(shares[1:4]) > 0.9, shares


def test_a_wheel_that_turns_the_other_way_makes_no_law(drive: Drive, vehicle: VehicleSpec) -> None:
    turned = {**drive.fields, "command.steer_rad": -drive.fields["command.steer_rad"]}
    assert fit_motion_law([whole(drive._replace(fields=turned))], "steer", vehicle) is None


def test_without_what_it_takes_there_is_no_law(drive: Drive, vehicle: VehicleSpec) -> None:
    def lacking(*names: str) -> Drive:
        return drive._replace(fields={key: one for key, one in drive.fields.items() if key not in names})

    assert fit_motion_law([whole(lacking("report.yaw_rate_radps"))], "steer", vehicle) is None
    assert fit_motion_law([whole(lacking("report.speed_mps"))], "throttle", vehicle) is None
    assert fit_motion_law([whole(lacking("command.throttle_frac"))], "throttle", vehicle) is None
    off = drive._replace(enabled=np.zeros(drive.n_rows, dtype=bool))
    assert fit_motion_law([whole(off)], "throttle", vehicle) is None
    assert fit_motion_law([whole(drive)], "accel", vehicle) is None and fit_motion_law([], "steer", vehicle) is None


def test_a_report_is_taken_where_there_is_one(drive: Drive, vehicle: VehicleSpec) -> None:
    fields = {**drive.fields, "report.steer_rad": drive.fields["command.steer_rad"]}
    fresh = {**drive.fresh, "report.steer_rad": drive.fresh["command.steer_rad"]}
    reported = DriveSplit((whole(drive._replace(fields=fields, fresh=fresh)),), (), "")
    assert collect_channel(reported, "steer", vehicle)[2] is None
    training, _, law = collect_channel(DriveSplit((whole(drive),), (), ""), "steer", vehicle)
    assert law is not None and training.segments
    assert model_channels(vehicle) == ["throttle", "brake", "steer"]


def test_windows_take_the_command_where_no_output_is_reported(drive: Drive, vehicle: VehicleSpec) -> None:
    assert extract_windows([whole(drive)], vehicle).windows == ()
    channels = {
        name: fit_from_data_sheet(read_channel_sheet(vehicle, name), "a test")
        for name in ("throttle", "brake", "steer")
    }
    windows = extract_windows([whole(drive)], vehicle, 8.0, channels)
    assert windows.has_pedals and windows.is_steered and len(windows.windows) >= 8
    window = windows.windows[2]
    sent = drive.fields["command.throttle_frac"][window.begin - 6 : window.begin - 6 + len(window.inputs)]
    assert np.corrcoef(window.inputs[:, 0], sent)[0, 1] > 0.95
    half = drive.enabled.copy()
    half[: drive.n_rows // 2] = False
    late = extract_windows([whole(drive._replace(enabled=half))], vehicle, 8.0, channels)
    assert 0 < len(late.windows) < len(windows.windows) and all(
        one.begin >= drive.n_rows // 2 - 2 for one in late.windows
    )


def test_what_motion_shows_is_wider_and_leaves_the_rest_to_the_plant(vehicle: VehicleSpec) -> None:
    sheet = read_channel_sheet(vehicle, "steer")
    blind = fit_from_data_sheet(sheet, "")
    seen = restrict_to_motion(
        blind._replace(dead_time_s=Estimate(0.1, 0.08, 0.12), lag_s=Estimate(0.2, 0.15, 0.25)), sheet
    )
    assert (seen.gain.value, seen.offset.value, seen.dead_band.value) == (1.0, 0.0, 0.0)
    assert seen.lag_s.low == 0.0 and seen.lag_s.high == 0.25 and seen.dead_time_s.known
    lost = restrict_to_motion(blind, sheet)
    assert lost.dead_time_s.value == sheet.dead_time_s and not lost.dead_time_s.known
    assert "hardly shows" in lost.dead_time_s.why
    dead_time_s, unknown = Estimate(0.1, 0.08, 0.12), Estimate(2.0, 0.0, 9.0, False)
    endless = restrict_to_motion(blind._replace(dead_time_s=dead_time_s, lag_s=Estimate(2.99, 1.2, 8.0)), sheet)
    assert endless.lag_s.value == sheet.lag_s, "as slow as the search goes: so a car changes by itself"
    second = blind._replace(order=2, dead_time_s=unknown, lag_s=Estimate(0.0, 0.0, 0.0), natural_hz=unknown)
    assert restrict_to_motion(second, sheet).order == 1, "a channel of second order has no lag that could be known"
    assert restrict_to_motion(second._replace(natural_hz=Estimate(2.0, 1.5, 2.5)), sheet).natural_hz.value == 2.0


def test_suggestions_replace_what_no_folder_states(drive: Drive, vehicle: VehicleSpec) -> None:
    laws = {
        name: law
        for name in ("throttle", "steer")
        if (law := fit_motion_law([whole(drive)], name, vehicle)) is not None
    }
    seen = suggest_plant_constants(laws, 2080.0)
    assert seen.get("creep_force_n") == 0.0 or laws["throttle"].coefficients[0] > 0.0
    still = {**seen, "creep_force_n": 0.0}
    assert make_fixed_params(vehicle, still)["creep_force_n"] == 0.0 and "creep_force_n" not in make_constant_priors(
        vehicle, still
    )
    assert seen["drive_force_n"] > 0.0 and 0.0 < seen["rolling_frac"] < 0.31
    stated = make_constant_priors(vehicle, seen)
    assert stated["steer_ratio"].value == 16.0, "the folder states it"
    bare = msgspec.structs.replace(vehicle, nominal=msgspec.structs.replace(vehicle.nominal, steer_ratio=None))
    assert make_constant_priors(bare, seen)["steer_ratio"].value == laws["steer"].steer_ratio


def test_a_scale_car_is_doubted_more_and_has_no_brake_that_nobody_named(vehicle: VehicleSpec) -> None:
    small = msgspec.structs.replace(vehicle.nominal, mass_kg=1.6, wheelbase_m=0.17, front_axle_m=0.08)
    command = {name: one for name, one in vehicle.command.items() if name != "brake_frac"}
    report = {name: one for name, one in vehicle.report.items() if name != "brake_frac"}
    car = msgspec.structs.replace(vehicle, nominal=small, command=command, report=report)
    assert make_fixed_params(car)["brake_force_n_per_frac"] == 0.0
    assert "brake_force_n_per_frac" not in make_constant_priors(
        car
    ) and "brake_force_n_per_frac" in make_constant_priors(vehicle)
    assert (
        make_constant_priors(car)["rolling_frac"].uncertainty
        > 3.0 * make_constant_priors(vehicle)["rolling_frac"].uncertainty
    )
    assert make_constant_priors(vehicle)["rolling_frac"].uncertainty == 2.0
