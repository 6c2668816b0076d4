"""A drive opened: what each link begins from, and what a log that lacks something cannot show."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import msgspec
import numpy as np
import pytest

from tests.learn.made_drives import made_drive
from tunefree_hil.base.contracts import Link
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.gap.measured.chain import MeasuredDrive, build_measured_drive, size_scale_from_vehicle
from tunefree_hil.gap.measured.excitation import assess_excitation, measure_quantities
from tunefree_hil.gap.measured.targets import DriveComparison
from tunefree_hil.gap.model.graph import load_catalogue
from tunefree_hil.learn.drives.drive import Drive

pytestmark = pytest.mark.slow


@cache
def drive() -> Drive:
    return made_drive(60.0)


def opened(without: Iterable[str] = ()) -> MeasuredDrive:
    gone = tuple(without)
    fields = {key: one for key, one in drive().fields.items() if not key.startswith(gone)} if gone else drive().fields
    return build_measured_drive(drive()._replace(fields=fields), load_vehicle("mkz_bywire"))


def names(one: MeasuredDrive) -> set[str]:
    return {target.name for target in DriveComparison(one).targets}


def test_a_whole_log_shows_every_link() -> None:
    one = opened()
    assert not one.unobservable_links and one.inputs.has_output == (True, True, True) and one.inputs.uses_ins_speed
    assert {"throttle", "brake", "steer", "rate_of_speed", "yaw_rate", "wheel_vs_ins", "yaw_vs_ins"} <= names(one)


def test_without_an_ins_its_links_are_lost_by_name() -> None:
    one = opened(["ins."])
    assert {Link.WHEEL_VS_INS, Link.YAW_VS_INS} <= set(one.unobservable_links)
    assert not {"wheel_vs_ins", "yaw_vs_ins"} & names(one) and {"rate_of_speed", "yaw_rate"} <= names(one)


def test_without_reports_the_chain_goes_from_commands() -> None:
    one = opened(["report.throttle_frac", "report.brake_frac", "report.steer_rad"])
    assert Link.COMMAND_TO_REPORT in one.unobservable_links and one.inputs.has_output == (False, False, False)
    assert not {"throttle", "brake", "steer"} & names(one)


def test_without_any_speed_nothing_can_be_told() -> None:
    with pytest.raises(InputError, match="speed"):
        opened(["ins.speed", "ins.x_m", "report.speed"])


def test_the_drive_holds_what_effects_need_and_says_what_it_lacks() -> None:
    held = measure_quantities([opened()], load_vehicle("mkz_bywire"))
    assert held["moving_s"] > 20.0 and held["brakings"] >= 2.0 and held["steer_reversals"] > 5.0
    still = assess_excitation(load_catalogue(), dict.fromkeys(held, 0.0))
    needy = [name for name, effect in load_catalogue().items() if effect.needs]
    assert all(not still[name].is_sufficient and still[name].shortages and still[name].score == 0.0 for name in needy)
    assert all(one.is_sufficient for one in assess_excitation(load_catalogue(), dict.fromkeys(held, 1e6)).values())


def test_curves_to_either_side_may_be_in_another_log() -> None:
    one, vehicle = opened(), load_vehicle("mkz_bywire")
    left, right = (
        one._replace(inputs=one.inputs._replace(yaw_rate_radps=np.full(one.ticks, by))) for by in (0.2, -0.2)
    )
    assert (
        measure_quantities([left], vehicle)["curve_s"] == measure_quantities([right, right], vehicle)["curve_s"] == 0.0
    )
    assert measure_quantities([left, right, right], vehicle)["curve_s"] > 10.0


def test_what_was_measured_is_there_where_the_log_has_it() -> None:
    one = opened()
    assert np.isfinite(one.inputs.commands).all() and np.isfinite(one.inputs.outputs).all()
    assert one.command_active[200:].mean() > 0.95


def test_after_a_gap_in_the_recording_nobody_knows_for_a_while_what_a_channel_follows() -> None:
    gap = slice(2000, 2300)
    fresh = {name: one.copy() for name, one in drive().fresh.items()}
    for one in fresh.values():
        one[gap] = False
    one = build_measured_drive(drive()._replace(fresh=fresh), load_vehicle("mkz_bywire"))
    whole = opened()
    assert whole.command_active[1900:2500].all() and not one.command_active[2000:2390].any()
    assert one.command_active[1900:1990].all() and one.command_active[2410:-10].all()
    assert not one.is_moving[2005:2295].any()


def test_an_ins_that_says_its_pose_alone_tells_its_rates() -> None:
    one, whole = opened(["ins.speed_mps", "ins.yaw_rate_radps", "ins.accel_mps2"]), opened()
    assert one.inputs.uses_ins_speed and not {Link.WHEEL_VS_INS, Link.YAW_VS_INS} & set(one.unobservable_links)
    for name, near in (("ins.speed_mps", 0.25), ("ins.yaw_rate_radps", 0.03)):
        here, there = (some.signals[name].values[100:-100] for some in (one, whole))
        assert np.sqrt(np.mean((here - there) ** 2)) < near


@pytest.mark.parametrize("bare", [True, False])
def test_an_ins_of_the_first_seconds_only_is_left_out_whether_it_says_its_rates_or_its_pose(bare: bool) -> None:
    gone = ("ins.speed", "ins.yaw_rate", "ins.accel") if bare else ("none",)
    fields = {key: one for key, one in drive().fields.items() if not key.startswith(gone)}
    first = np.arange(drive().n_rows) < 0.3 * drive().n_rows
    fresh = {key: one & first if key.startswith("ins.") else one for key, one in drive().fresh.items()}
    one = build_measured_drive(drive()._replace(fields=fields, fresh=fresh), load_vehicle("mkz_bywire"))
    assert not one.inputs.uses_ins_speed and one.is_moving.mean() > 0.8 and len(one.omissions) == 1
    assert {"yaw_rate", "rate_of_speed"} <= names(one) and not one.derived_ticks


def test_a_car_without_a_gyro_has_the_yaw_rate_of_its_wheels() -> None:
    vehicle = load_vehicle("mkz_bywire")
    nominal = msgspec.structs.replace(vehicle.nominal, track_m=1.6, wheel_radius_m=0.33)
    kept = {key: some for key, some in drive().fields.items() if not key.startswith(("ins.", "report.yaw"))}
    yaw, fresh = drive().fields["report.yaw_rate_radps"], drive().fresh["report.yaw_rate_radps"]
    wheels = {f"report.wheel_{side}_radps": sign * 0.5 * 1.6 * yaw / 0.33 for side, sign in (("rl", -1), ("rr", 1))}
    made = drive()._replace(fields=kept | wheels, fresh={**drive().fresh, **dict.fromkeys(wheels, fresh)})
    assert "report.yaw_rate_radps" not in build_measured_drive(made, vehicle).signals, (
        "nobody says how far apart they are"
    )
    one = build_measured_drive(made, msgspec.structs.replace(vehicle, nominal=nominal)).signals["report.yaw_rate_radps"]
    assert one.values[100:] == pytest.approx(opened().signals["report.yaw_rate_radps"].values[100:], abs=1e-9)


def test_a_car_that_is_asked_for_an_acceleration_is_driven_by_two_pedals() -> None:
    gone = ("command.throttle_frac", "command.brake_frac", "report.throttle", "report.brake")
    asked = 1.2 * np.sin(0.3 * np.arange(drive().n_rows) * drive().dt_s)
    kept = {key: some for key, some in drive().fields.items() if not key.startswith(gone)}
    fresh = {key: some for key, some in drive().fresh.items() if not key.startswith(gone)}
    always = np.ones(drive().n_rows, dtype=bool)
    made = drive()._replace(fields={**kept, "command.accel_mps2": asked}, fresh={**fresh, "command.accel_mps2": always})
    one = build_measured_drive(made, load_vehicle("mkz_bywire"))
    rest = load_vehicle("mkz_bywire").nominal.rest_pedal_frac
    pedals = one.inputs.commands[10:, :2] - rest
    assert (pedals >= -1e-12).all() and (pedals.min(axis=1) < 1e-12).all(), "never both"
    assert np.abs(10.0 * (pedals[:, 0] - pedals[:, 1]) - asked[10:]).max() < 0.02
    assert one.command_active[200:, :2].all() and one.inputs.has_output[:2] == (False, False)


def test_what_counts_as_driving_goes_with_the_size_of_a_car() -> None:
    vehicle = load_vehicle("mkz_bywire")
    assert size_scale_from_vehicle(vehicle) == 1.0 and opened().size_scale == 1.0
    small = msgspec.structs.replace(vehicle, nominal=msgspec.structs.replace(vehicle.nominal, wheelbase_m=0.1735))
    assert size_scale_from_vehicle(small) == pytest.approx(0.1735 / 2.7)


def test_a_pose_that_jumps_tells_no_speed_and_that_is_said() -> None:
    gone = ("ins.speed", "ins.yaw", "ins.accel")
    fields = {key: one for key, one in drive().fields.items() if not key.startswith(gone)}
    whole = build_measured_drive(drive()._replace(fields=fields), load_vehicle("mkz_bywire"))
    assert set(whole.derived_ticks) == {"ins.speed_mps", "ins.yaw_rate_radps"} and min(whole.derived_ticks.values()) > 1
    fields["ins.x_m"] = fields["ins.x_m"] + 50.0 * (np.arange(drive().n_rows) > drive().n_rows // 2)
    one = build_measured_drive(drive()._replace(fields=fields), load_vehicle("mkz_bywire"))
    assert not whole.omissions and len(one.omissions) == 1 and "ins.x_m jumps" in one.omissions[0]
    assert set(one.derived_ticks) == {"ins.yaw_rate_radps"} and not one.inputs.uses_ins_speed
    assert not one.has_wheel_yaw_rate and one._replace(derived_ticks={"report.yaw_rate_radps": 1}).has_wheel_yaw_rate


def test_a_speed_by_places_is_not_there_where_places_are_missing() -> None:
    """The heading goes on, and a straight line through the gap is no motion that anybody measured."""
    gone = ("ins.speed", "ins.yaw_rate", "ins.accel")
    fields = {key: one for key, one in drive().fields.items() if not key.startswith(gone)}
    gap = np.zeros(drive().n_rows, dtype=bool)
    gap[2000:2300] = True
    fresh = {key: one & ~gap if key in ("ins.x_m", "ins.y_m") else one for key, one in drive().fresh.items()}
    signals = build_measured_drive(drive()._replace(fields=fields, fresh=fresh), load_vehicle("mkz_bywire")).signals
    assert not signals["ins.speed_mps"].is_valid[2010:2290].any() and signals["ins.speed_mps"].is_valid[500:1900].all()
    assert signals["ins.yaw_rate_radps"].is_valid[500:2500].all()
