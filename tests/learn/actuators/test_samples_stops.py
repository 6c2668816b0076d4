"""A stop is a level at which commands of several sizes end; no other behaviour of an actuator counts as one."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.made_drives import DT_S, made_drive, whole
from tunefree_hil.learn.actuators.samples import (
    ActuatorSamples,
    clip_commands,
    clip_to_stops,
    collect_samples,
    commands_at_outputs,
    describe_stops,
    find_stops,
)
from tunefree_hil.learn.drives.drive import Drive, DrivePart

CHANCE = np.random.default_rng(3)
HELD = 80  # rows that a command is held for
ASKED = np.repeat(CHANCE.uniform(-2.0, 2.0, 60), HELD)


def lagging(command: np.ndarray, rows: float = 12.0) -> np.ndarray:
    output, y = np.empty_like(command), command[0]
    for k, target in enumerate(command):
        y += (target - y) / rows
        output[k] = y
    return output


def pair(output: np.ndarray, command: np.ndarray = ASKED) -> ActuatorSamples:
    noisy = output + 0.002 * np.random.default_rng(4).standard_normal(len(output))
    return ActuatorSamples(command, noisy, np.arange(len(command)) % 2 == 0, DT_S)


@pytest.mark.parametrize("ends", [(-1.2, 1.2), (-np.inf, 0.8), (-0.5, np.inf)])
def test_a_stop_is_found_at_either_end_before_the_lag_and_behind_it(ends: tuple[float, float]) -> None:
    for output in (lagging(np.clip(ASKED, *ends)), np.clip(lagging(ASKED), *ends)):
        stops = find_stops([pair(output)])
        assert stops == pytest.approx(ends, abs=0.01)
        clipped = clip_commands(pair(output), *commands_at_outputs([pair(output)], *stops)).command
        assert clipped == pytest.approx(np.clip(ASKED, *ends), abs=0.02)


def rate_limited(command: np.ndarray, max_step: float) -> np.ndarray:
    output, y = np.empty_like(command), command[0]
    for k, target in enumerate(command):
        y += float(np.clip(target - y, -max_step, max_step))
        output[k] = y
    return output


def with_play(command: np.ndarray, play: float) -> np.ndarray:
    output, y = np.empty_like(command), command[0]
    for k, target in enumerate(command):
        y = float(np.clip(y, target - play, target + play))
        output[k] = y
    return output


@pytest.mark.parametrize(
    "output",
    [ASKED, lagging(ASKED), 0.6 * ASKED, lagging(ASKED, 60.0), rate_limited(ASKED, 0.02), with_play(ASKED, 0.3),
     np.where(np.abs(ASKED) < 0.4, 0.0, ASKED), lagging(ASKED) + 0.3, np.zeros_like(ASKED)],
)  # fmt: skip
def test_lags_gains_limits_of_rate_play_bands_and_offsets_are_no_stops(output: np.ndarray) -> None:
    assert find_stops([pair(output)]) == (-np.inf, np.inf)
    assert find_stops([]) == (-np.inf, np.inf)


def test_one_command_again_and_again_is_no_stop() -> None:
    command = np.tile(np.repeat([0.0, 1.0], HELD), 20)
    assert find_stops([pair(lagging(0.7 * command), command)]) == (-np.inf, np.inf)


@pytest.mark.parametrize("before_the_lag", [True, False])
@pytest.mark.parametrize("rows", [12.0, 20.0])
@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (0.85, 0.0), (1.1, 0.0), (1.0, 0.05), (0.93, -0.04)])
def test_commands_end_where_the_channels_own_gain_and_offset_reach_its_stop(
    gain: float, offset: float, rows: float, before_the_lag: bool
) -> None:
    moved = gain * ASKED + offset
    output = lagging(np.clip(moved, -0.9, 0.9), rows) if before_the_lag else np.clip(lagging(moved, rows), -0.9, 0.9)
    segment = pair(output)
    ends = commands_at_outputs([segment], *find_stops([segment]))
    assert ends == pytest.approx(((-0.9 - offset) / gain, (0.9 - offset) / gain), abs=0.025)
    given = clip_commands(segment, *ends).command
    off = lagging(gain * given + offset, rows) - lagging(np.clip(moved, -0.9, 0.9), rows)
    assert np.abs(off).max() < 0.03, "what the fit is given is what the channel obeyed"


def test_where_nothing_rests_a_channel_is_taken_to_reach_what_it_is_asked() -> None:
    swept = 1.5 * np.sin(np.arange(6000) * DT_S * 2.0)
    assert commands_at_outputs([pair(np.clip(swept, -0.9, 0.9), swept)], -0.9, 0.9) == (-0.9, 0.9)


def stopped(drive: Drive, stop: float) -> Drive:
    name = "report.steer_rad"
    return drive._replace(fields={**drive.fields, name: np.clip(drive.fields[name], -stop, stop)})


def test_pairs_end_where_the_channel_does_and_say_so() -> None:
    drive = made_drive(60.0, seed=2)
    plain = collect_samples([whole(drive)], "steer")
    assert clip_to_stops(plain, plain) == (plain, plain)
    raw = collect_samples([whole(stopped(drive, 0.7))], "steer")
    short = collect_samples(
        [DrivePart(stopped(drive, 0.7), 0, drive.n_rows // 12)], "steer"
    )  # too short to show it by itself
    for clipped, original in zip(clip_to_stops(raw, short), (raw, short), strict=True):
        assert "it stops at a command of " in clipped.description and clipped.n_rows == original.n_rows
        assert max(float(np.nanmax(np.abs(one.command))) for one in clipped.segments) == pytest.approx(0.7, abs=0.01)
    assert max(float(np.nanmax(np.abs(one.command))) for one in raw.segments) > 1.0
    assert describe_stops(plain.segments, -np.inf, np.inf) == ""
