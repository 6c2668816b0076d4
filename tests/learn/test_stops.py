"""Stops of a channel: a level that commands of all sizes end at, and nothing else that an actuator does."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.made_drives import DT_S, made_drive, whole
from tunefree_hil.learn.pairs import Pair, pairs_of
from tunefree_hil.learn.stops import stop_words, stops_of, within

CHANCE = np.random.default_rng(3)
HELD = 80  # rows that a command is held for
ASKED = np.repeat(CHANCE.uniform(-2.0, 2.0, 60), HELD)


def lagging(command: np.ndarray, rows: float = 12.0) -> np.ndarray:
    found, y = np.empty_like(command), command[0]
    for k, one in enumerate(command):
        y += (one - y) / rows
        found[k] = y
    return found


def pair(output: np.ndarray, command: np.ndarray = ASKED) -> Pair:
    noisy = output + 0.002 * np.random.default_rng(4).standard_normal(len(output))
    return Pair(command, noisy, np.arange(len(command)) % 2 == 0, DT_S)


@pytest.mark.parametrize("ends", [(-1.2, 1.2), (-np.inf, 0.8), (-0.5, np.inf)])
def test_a_stop_is_found_at_either_end_before_the_lag_and_behind_it(ends: tuple[float, float]) -> None:
    for output in (lagging(np.clip(ASKED, *ends)), np.clip(lagging(ASKED), *ends)):
        found = stops_of([pair(output)])
        assert found == pytest.approx(ends, abs=0.01)
        clipped = within(pair(output), *found).command
        assert clipped == pytest.approx(np.clip(ASKED, *found))


def rate_limited(command: np.ndarray, by: float) -> np.ndarray:
    found, y = np.empty_like(command), command[0]
    for k, one in enumerate(command):
        y += float(np.clip(one - y, -by, by))
        found[k] = y
    return found


def with_play(command: np.ndarray, by: float) -> np.ndarray:
    found, y = np.empty_like(command), command[0]
    for k, one in enumerate(command):
        y = float(np.clip(y, one - by, one + by))
        found[k] = y
    return found


@pytest.mark.parametrize(
    "output",
    [ASKED, lagging(ASKED), 0.6 * ASKED, lagging(ASKED, 60.0), rate_limited(ASKED, 0.02), with_play(ASKED, 0.3),
     np.where(np.abs(ASKED) < 0.4, 0.0, ASKED), lagging(ASKED) + 0.3, np.zeros_like(ASKED)],
)  # fmt: skip
def test_lags_gains_limits_of_rate_play_bands_and_offsets_are_no_stops(output: np.ndarray) -> None:
    assert stops_of([pair(output)]) == (-np.inf, np.inf)
    assert stops_of([]) == (-np.inf, np.inf)


def test_one_command_again_and_again_is_no_stop() -> None:
    held = np.tile(np.repeat([0.0, 1.0], HELD), 20)
    assert stops_of([pair(lagging(0.7 * held), held)]) == (-np.inf, np.inf)


def test_pairs_end_where_the_channel_does_and_say_so() -> None:
    drive = made_drive(60.0, seed=2)
    plain = pairs_of([whole(drive)], "steer")
    assert "stops" not in plain.words
    name = "report.steer_rad"
    stopped = drive._replace(fields={**drive.fields, name: np.clip(drive.fields[name], -0.7, 0.7)})
    found = pairs_of([whole(stopped)], "steer")
    assert "stops at -0.7 and 0.7, which" in found.words
    most, plainly = (float(np.nanmax(np.abs(one.some[0].command))) for one in (found, plain))
    assert most == pytest.approx(0.7, abs=1e-3) and plainly > 1.0
    assert stop_words(plain.some, -np.inf, np.inf) == ""
