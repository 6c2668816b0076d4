"""What is compared of a drive: only what moves, each with the size that its misses are held against."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.made_drives import DT_S, QUANTUM, REST, as_drive
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.gap.measured.chain import MeasuredDrive, build_measured_drive
from tunefree_hil.gap.measured.targets import TARGET_CRITERIA, DriveComparison, Target, find_sparse_targets

TICKS = 3000
T = DT_S * np.arange(TICKS)
PEDAL = REST + 0.05 * (1.0 + np.sin(0.7 * T))
STEER = 0.3 * np.sin(1.1 * T)
STANDS = np.full(TICKS, REST)


def opened(brake: np.ndarray = PEDAL, asked: np.ndarray | None = None, yaw: np.ndarray | None = None) -> MeasuredDrive:
    """A drive of signals that nobody simulated. brake: its report; asked: the command, else the same."""
    fields = {
        "report.speed_mps": 10.0 + 2.0 * np.sin(0.2 * T),
        "report.yaw_rate_radps": 0.1 * STEER if yaw is None else yaw,
    }
    said = {"throttle_frac": (PEDAL, PEDAL), "brake_frac": (brake, brake if asked is None else asked)}
    for name, (output, command) in {**said, "steer_rad": (STEER, STEER)}.items():
        bare, _, unit = name.rpartition("_")
        fields |= {f"report.{name}": output, f"report.{bare}_command_{unit}": command, f"command.{name}": command}
    drive = as_drive(fields, 1)
    exact = {name: values for name, values in fields.items() if "brake" in name or (yaw is not None and "yaw" in name)}
    return build_measured_drive(drive._replace(fields={**drive.fields, **exact}), load_vehicle("mkz_bywire"))


def targets(drive: MeasuredDrive) -> dict[str, Target]:
    return {one.name: one for one in DriveComparison(drive).targets}


def test_everything_that_moves_is_compared_and_has_a_size() -> None:
    found = targets(opened())
    assert {"throttle", "brake", "steer", "rate_of_speed", "yaw_rate"} <= set(found)
    assert all(one.size > 0.0 for one in found.values())
    assert found["steer"].size == pytest.approx(0.3 / np.sqrt(2.0), rel=0.05)


@pytest.mark.parametrize("flicker", [0.0, QUANTUM["brake_frac"]])
def test_a_brake_that_nobody_presses_is_compared_with_nothing(flicker: float) -> None:
    chance = np.random.default_rng(1)
    assert "brake" not in targets(opened(STANDS + flicker * chance.integers(0, 3, TICKS), STANDS))


def test_a_brake_that_stands_though_it_is_asked_to_move_is_compared() -> None:
    found = targets(opened(STANDS, PEDAL))
    assert found["brake"].size == pytest.approx(float(np.std(PEDAL)), rel=0.05)


def test_a_pedal_that_knows_two_places_only_is_compared() -> None:
    both = np.where(np.sin(0.7 * T) > 0.0, REST, REST + 0.1)
    assert targets(opened(both))["brake"].size == pytest.approx(0.05, rel=0.05)


def test_a_sensor_that_never_moves_is_compared_with_nothing() -> None:
    assert "yaw_rate" not in targets(opened(yaw=np.zeros(TICKS)))


def test_drives_together_must_have_enough_of_a_target_and_each_more_than_a_moment_of_it() -> None:
    one = opened()
    moment = one._replace(is_moving=one.is_moving & (T > 5.0) & (T < 10.5))
    assert "yaw_rate" not in {target.name for target in DriveComparison(moment).targets}, "it is all there is"
    short = DriveComparison(moment, 0.05)
    (rows,) = (int(target.valid.sum()) for target in short.targets if target.name == "yaw_rate")
    assert 40 <= rows < TARGET_CRITERIA.min_rows and {"yaw_rate", "rate_of_speed"} <= find_sparse_targets([short])
    assert "yaw_rate" not in find_sparse_targets([short, DriveComparison(one, 0.95)])
    glimpse = one._replace(is_moving=one.is_moving & (T > 5.0) & (T < 7.0))
    assert "yaw_rate" not in {target.name for target in DriveComparison(glimpse, 0.01).targets}

    throttle = next(target for target in short.targets if target.name == "throttle")
    short.drop_targets(find_sparse_targets([short]))
    assert "throttle" in {target.name for target in short.targets} and throttle.valid.sum() >= TARGET_CRITERIA.min_rows
    assert "yaw_rate" not in {target.name for target in short.targets}


@pytest.mark.parametrize(("share", "left_out"), [(0.2, True), (0.7, False)])
def test_the_rate_of_speed_is_not_asked_for_in_tight_turns_unless_there_is_hardly_anything_else(
    share: float, left_out: bool
) -> None:
    ends = share * T[-1]
    tight = ends > T
    drive = opened(yaw=np.where(tight, 1.3, 0.1) * (1.0 + 0.01 * np.sin(T)))  # at 10 m/s: 0.37 and 0.03 rad
    rate, yaw = (targets(drive)[name] for name in ("rate_of_speed", "yaw_rate"))
    inner = tight & (T > 1.0) & (ends - 3.0 > T)
    assert rate.valid[inner[rate.rows]].any() != left_out and yaw.valid[inner[yaw.rows]].all()
    assert (
        np.abs(drive.kinematic_steer_rad[~tight]).max()
        < TARGET_CRITERIA.max_gentle_rad
        < np.abs(drive.kinematic_steer_rad[inner]).min()
    )


def test_short_drives_tell_together_what_a_long_one_tells() -> None:
    """9 s: none of them says enough alone, three of them are half a minute."""
    short = opened()
    piece = short._replace(is_moving=short.is_moving & (T > 10.0) & (T < 19.5))
    assert "yaw_rate" not in targets(piece)
    assert "yaw_rate" in {one.name for one in DriveComparison(piece, share=1 / 3).targets}
