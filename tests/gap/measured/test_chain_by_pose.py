"""Rates of an INS that says its pose alone: those of the motion, and none where the pose tells none."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.gap.measured.chain import HEADING, SPEED, YAW_RATE, X, Y, find_pose_jumps, rates_from_pose

DT_S = 0.01
Array = np.ndarray


def pose(every: int = 1, seconds: float = 20.0, turn_radps: float = 0.4, speed_mps: float = 2.0) -> dict[str, Array]:
    """A car that speeds up and turns, its heading within [-pi, pi), a new value every so many ticks."""
    t = np.arange(round(seconds / DT_S)) * DT_S
    heading = turn_radps * t + 0.2 * np.sin(t)
    speed = speed_mps + 0.3 * np.sin(0.7 * t)
    x, y = (np.cumsum(speed * way(heading)) * DT_S for way in (np.cos, np.sin))
    fields = {X: x, Y: y, HEADING: (heading + np.pi) % (2.0 * np.pi) - np.pi}
    held = np.arange(len(t)) // every * every
    return {name: values[held] for name, values in fields.items()}


def fresh(fields: dict[str, Array], every: int = 1) -> dict[str, Array]:
    return {name: np.arange(len(values)) % every == 0 for name, values in fields.items()}


@given(st.sampled_from([1, 2, 5]), st.floats(-1.0, 1.0), st.floats(0.6, 20.0))
def test_rates_are_those_of_the_motion(every: int, turn_radps: float, speed_mps: float) -> None:
    fields = pose(every, turn_radps=turn_radps, speed_mps=speed_mps)
    found = rates_from_pose(fields, fresh(fields, every), DT_S)
    t = np.arange(len(fields[X])) * DT_S
    inside = slice(50, -50)
    assert np.abs(found[YAW_RATE] - turn_radps - 0.2 * np.cos(t))[inside].max() < 0.01
    assert np.abs(found[SPEED] - speed_mps - 0.3 * np.sin(0.7 * t))[inside].max() < 0.02 * (1.0 + speed_mps)


def test_backwards_is_negative() -> None:
    fields = pose(speed_mps=-1.0)
    assert (rates_from_pose(fields, fresh(fields), DT_S)[SPEED][50:-50] < 0.0).all()


def test_what_the_ins_says_is_not_made_up() -> None:
    fields = pose()
    fields |= {YAW_RATE: np.zeros(len(fields[X]))}
    assert set(rates_from_pose(fields, fresh(fields), DT_S)) == {SPEED}
    fields |= {SPEED: np.zeros(len(fields[X]))}
    assert rates_from_pose(fields, fresh(fields), DT_S) == {}


@pytest.mark.parametrize("gone", [X, Y, HEADING])
def test_half_a_pose_tells_half(gone: str) -> None:
    fields = {name: values for name, values in pose().items() if name != gone}
    assert set(rates_from_pose(fields, fresh(fields), DT_S)) == (set() if gone == HEADING else {YAW_RATE})


def test_seldom_values_tell_no_slope() -> None:
    fields = pose(every=20)
    assert rates_from_pose(fields, fresh(fields, 20), DT_S) == {}


def test_a_pose_that_jumps_is_no_witness() -> None:
    """A camera that takes another marker for the car: nothing is said of that drive."""
    for name, by in ((HEADING, 1.0), (X, 6.0)):
        fields = pose()
        fields[name] = fields[name] + by * (np.arange(len(fields[name])) > 1500)
        found = rates_from_pose(fields, fresh(fields), DT_S)
        assert set(found) == (set() if name == HEADING else {YAW_RATE})


def test_frames_that_are_lost_are_no_jump() -> None:
    """A car goes on while nobody looks; one that is somewhere else afterwards has jumped."""
    fields = pose()
    seen = {name: np.arange(len(values)) % 200 > 4 for name, values in fields.items()}
    assert find_pose_jumps(fields, seen, DT_S) == () and set(rates_from_pose(fields, seen, DT_S)) == {SPEED, YAW_RATE}
    fields[Y] = fields[Y] + 6.0 * (np.arange(len(fields[Y])) >= 1200)
    assert find_pose_jumps(fields, seen, DT_S) == (Y,) and set(rates_from_pose(fields, seen, DT_S)) == {YAW_RATE}
    assert find_pose_jumps({**fields, SPEED: fields[X]}, seen, DT_S) == (), "nobody asks it for a speed"
