"""Accelerometers, headings and positions that are stuck while the car moves, and those that may be constant."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.jobs.gap.gap import TOLERATED
from tunefree_hil.learn.checks.stuck_signals import check_stuck_signals
from tunefree_hil.learn.drives.drive import Drive

DT_S, TICKS = 0.01, 6000
ACCEL, LATERAL, HEADING, PLACE = "report.accel_mps2", "report.lateral_accel_mps2", "ins.heading_rad", "ins.x_m"


def driven(turn: float = 0.2, push: float = 1.5, noise: float = 0.0, mps: float = 8.0) -> dict[str, np.ndarray]:
    """A minute of weaving (rad/s) while the speed goes up and down (m/s^2), or of standing still (all 0)."""
    time_s, chance = np.arange(TICKS) * DT_S, np.random.default_rng(6)
    accel, yaw = push * np.sin(0.8 * time_s), turn * np.sin(0.5 * time_s)
    speed = mps + push / 0.8 * (1.0 - np.cos(0.8 * time_s))
    heading = np.cumsum(yaw) * DT_S
    exact = {
        "report.speed_mps": speed, "report.yaw_rate_radps": yaw, ACCEL: accel, "ins.accel_mps2": accel,
        LATERAL: yaw * speed, HEADING: heading,
        PLACE: np.cumsum(speed * np.cos(heading)) * DT_S, "ins.y_m": np.cumsum(speed * np.sin(heading)) * DT_S,
    }  # fmt: skip
    return {name: values + noise * chance.normal(size=TICKS) for name, values in exact.items()}


def drive_of(fields: dict[str, np.ndarray], interval: int = 1) -> Drive:
    """A drive with a frame every `interval` ticks, whose value lasts until the next."""
    fresh: np.ndarray = np.equal(np.arange(TICKS) % interval, 0)
    held_values = {name: values[np.arange(TICKS) // interval * interval] for name, values in fields.items()}
    return Drive("made", "", DT_S, held_values, dict.fromkeys(held_values, fresh), np.ones(TICKS, dtype=bool))


@pytest.mark.parametrize("name", [ACCEL, "ins.accel_mps2", LATERAL, HEADING, PLACE])
@pytest.mark.parametrize("dead", [False, True])
@pytest.mark.parametrize("interval", [1, 10])
def test_what_stands_still_is_refused(name: str, dead: bool, interval: int) -> None:
    fields = driven(noise=0.01)
    assert list(check_stuck_signals(drive_of(fields, interval))) == []
    for axis in ("ins.x_m", "ins.y_m") if name == PLACE else (name,):
        if dead:
            fields[axis][:] = 0.0
        else:
            fields[axis][2000 : 5500 if name in (HEADING, PLACE) else 4000] = fields[axis][2000]
    (problem,) = check_stuck_signals(drive_of(fields, interval))
    assert (problem.severity, problem.code, problem.field) == ("refuse", "stuck", name)
    assert name in problem.message and "expected to follow" in problem.message


def test_what_may_stand_still_is_not() -> None:
    """Straight along an axis; standing with a drifting gyro; a smooth road with coarse quantisation."""
    along = driven(turn=0.0)
    assert np.ptp(along["ins.y_m"]) == 0.0
    assert list(check_stuck_signals(drive_of(along))) == []

    stands = driven(turn=0.0, push=0.0, mps=0.0)
    stands["report.yaw_rate_radps"] += 0.02
    stands["report.speed_mps"] += 0.02 * np.random.default_rng(7).normal(size=TICKS)
    assert list(check_stuck_signals(drive_of(stands))) == []

    coarse = driven(turn=0.06, push=0.7, noise=0.001)
    for name, step in ((ACCEL, 1.0), ("ins.accel_mps2", 1.0), (LATERAL, 1.0), (HEADING, 0.02), (PLACE, 0.5)):
        coarse[name] = np.floor(coarse[name] / step + 0.7) * step
    assert list(check_stuck_signals(drive_of(coarse, 5))) == []


def test_an_accelerometer_at_its_end_and_a_pose_held_for_a_while_are_not_stuck() -> None:
    """The first is left out where it matters (gap/measured/signals.py); the second happens in a tunnel."""
    fields = driven(push=3.0, noise=0.01)
    for name in (ACCEL, "ins.accel_mps2", LATERAL):
        fields[name] = np.clip(fields[name], -0.5, 0.5)
    for name in (HEADING, PLACE, "ins.y_m"):
        fields[name][2000:4000] = fields[name][2000]
    assert list(check_stuck_signals(drive_of(fields))) == []
    fields[ACCEL][1500:2500] = 0.123
    assert [one.field for one in check_stuck_signals(drive_of(fields))] == [ACCEL]


def test_the_rate_of_a_speed_in_whole_steps_moves_nothing() -> None:
    """Cruising with a speed in whole km/h and an accelerometer that reads 0 for seconds."""
    fields = driven(push=0.1, mps=20.0, turn=0.0)
    fields["report.speed_mps"] = np.round(fields["report.speed_mps"] * 3.6) / 3.6
    fields["report.speed_mps"][::40] += 1.0 / 3.6
    fields[ACCEL] = np.round(fields[ACCEL])
    assert list(check_stuck_signals(drive_of(fields))) == []


def test_an_echo_that_stands_has_a_code_of_its_own() -> None:
    """`gap` looks for commands that do not arrive, so it tolerates this code."""
    command = 0.1 + 0.05 * np.sin(0.05 * np.arange(TICKS) * DT_S * 2.0 * np.pi)
    fields = {"command.brake_frac": command, "report.brake_command_frac": command.copy()}
    assert list(check_stuck_signals(drive_of(fields))) == []
    fields["report.brake_command_frac"][1000:4000] = command[1000]
    (problem,) = check_stuck_signals(drive_of(fields))
    assert (problem.code, problem.field) == ("echo_stuck", "report.brake_command_frac") and "echo_stuck" in TOLERATED
