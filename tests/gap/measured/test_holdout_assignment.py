"""Which blocks prove: as many as ever, and never the only ones in which a drive goes to its ends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.gap.made_answer import SECONDS, VEHICLE
from tests.learn.made_drives import made_drive
from tunefree_hil.gap.measured.blocks import FIT, HOLDOUT, Blocks, cut_blocks
from tunefree_hil.gap.measured.chain import MeasuredDrive, build_measured_drive
from tunefree_hil.gap.measured.holdout_assignment import (
    EXTREME_CRITERIA,
    assign_holdout_blocks,
    cover_extremes,
    find_block_extremes,
)

Array = np.ndarray
STEER_CHANGE = 6  # of `asked_at_most`: behind the throttle's two and one, the brake's two, the angle itself


def geometry(counts: list[int]) -> Blocks:
    """Blocks of drives of so many blocks each."""
    return cut_blocks([900 * count for count in counts], 0.01)


def is_seen(roles: Array, farthest: Array) -> Array:
    """[k]: whether the searched blocks go AS_FAR of the way, or there is no way to go."""
    found = []
    for column in farthest.T:
        some, searched = column[np.isfinite(column)], column[roles != HOLDOUT]
        span = np.ptp(some) if len(some) else 0.0
        found.append(span == 0.0 or bool((searched >= some.min() + EXTREME_CRITERIA.min_coverage * span).any()))
    return np.array(found)


@given(st.data())
def test_as_many_blocks_prove_as_before_and_no_end_is_lost(data: Any) -> None:
    blocks = geometry(data.draw(st.lists(st.integers(1, 20), min_size=1, max_size=3)))
    shape = (blocks.count, data.draw(st.integers(1, 6)))
    farthest = data.draw(arrays(float, shape, elements=st.sampled_from([0.0, 5.0, 9.1, 10.0, np.nan])))
    whole = data.draw(arrays(bool, blocks.count))
    roles = cover_extremes(blocks, farthest, whole)
    assert sorted(roles) == sorted(blocks.roles)
    seen, was = is_seen(roles, farthest), is_seen(blocks.roles, farthest)
    assert (seen >= was).all()
    if was.all():
        assert (roles == blocks.roles).all(), "where nothing is hidden nothing is changed"
    if len(was) == 1 and (blocks.roles != HOLDOUT).any():
        assert seen.all(), "one end can always be seen"


@pytest.mark.parametrize("block", range(16))
def test_the_one_block_that_goes_farthest_is_never_kept_for_the_proof(block: int) -> None:
    blocks, whole = geometry([16]), np.ones(16, dtype=bool)
    farthest = np.full((16, 2), [0.5, 1.0])
    farthest[block, 0] = 1.0
    roles = cover_extremes(blocks, farthest, whole)
    assert roles[block] != HOLDOUT
    assert np.abs(np.flatnonzero(roles != blocks.roles) - block).max(initial=0) <= 1, "a neighbour took its place"


def test_where_two_go_as_far_one_stays_for_the_proof() -> None:
    blocks, farthest = geometry([16]), np.zeros((16, 1))
    farthest[[3, 8], 0] = 1.0, 0.95  # the fourth proves, the ninth is fitted on
    assert (cover_extremes(blocks, farthest, np.ones(16, dtype=bool)) == blocks.roles).all()


def test_a_block_in_which_the_car_stands_takes_the_place_last() -> None:
    blocks, farthest, whole = geometry([16]), np.zeros((16, 1)), np.ones(16, dtype=bool)
    farthest[7, 0], whole[[6, 8]] = 1.0, False
    roles = cover_extremes(blocks, farthest, whole)
    assert roles[7] != HOLDOUT and roles[5] == HOLDOUT, "the nearest whole one"


def test_blocks_of_which_nothing_is_known_change_nothing() -> None:
    blocks = geometry([16])
    assert (cover_extremes(blocks, np.full((16, 3), np.nan), np.zeros(16, dtype=bool)) == blocks.roles).all()


def with_a_turn(opened: MeasuredDrive, block: int, steer_rad: float) -> MeasuredDrive:
    """The drive at an even speed, with one turn of the wheel in the middle of a block."""
    blocks = cut_blocks([opened.ticks], opened.dt_s)
    commands = opened.inputs.commands.copy()
    middle = int(blocks.begins[block] + blocks.ends[block]) // 2
    commands[middle : middle + 50, 2] = steer_rad
    speed = np.full(opened.ticks, 10.0)
    return opened._replace(inputs=opened.inputs._replace(commands=commands, speed_mps=speed))


@pytest.mark.parametrize("steer_rad", [6.0, -6.0])
def test_the_one_turn_of_a_drive_to_its_stop_is_searched(steer_rad: float) -> None:
    opened = build_measured_drive(made_drive(SECONDS, seed=5, name="turn.log"), VEHICLE)
    kept = int(np.flatnonzero(assign_holdout_blocks([opened]).roles == HOLDOUT)[0])
    assert assign_holdout_blocks([with_a_turn(opened, kept, steer_rad)]).roles[kept] != HOLDOUT


def test_an_end_that_a_persons_hands_reached_is_not_seen() -> None:
    opened = build_measured_drive(made_drive(SECONDS, seed=5, name="turn.log"), VEHICLE)
    kept, other = (int(np.flatnonzero(assign_holdout_blocks([opened]).roles == role)[0]) for role in (HOLDOUT, FIT))
    both = with_a_turn(with_a_turn(opened, kept, 6.0), other, 6.0)
    assert assign_holdout_blocks([both]).roles[kept] == HOLDOUT, "one of them is searched"
    follows = both.command_active.copy()
    blocks = cut_blocks([opened.ticks], opened.dt_s)
    follows[blocks.begins[other] : blocks.ends[other], 2] = False
    assert assign_holdout_blocks([both._replace(command_active=follows)]).roles[kept] != HOLDOUT


def test_a_drive_of_one_block_changes_places_with_another_drives() -> None:
    blocks, farthest = geometry([1] * 8), np.zeros((8, 1))
    farthest[3, 0] = 1.0
    roles = cover_extremes(blocks, farthest, np.ones(8, dtype=bool))
    assert blocks.roles[3] == HOLDOUT != roles[3] and sorted(roles) == sorted(blocks.roles)


def test_a_car_that_stands_has_its_blocks_all_the_same() -> None:
    opened = build_measured_drive(made_drive(SECONDS, seed=5, name="still.log"), VEHICLE)
    stands = opened._replace(is_moving=np.zeros(opened.ticks, dtype=bool))
    assert (assign_holdout_blocks([stands]).roles == cut_blocks([opened.ticks], opened.dt_s).roles).all()


def test_a_step_through_straight_ahead_is_a_change() -> None:
    drive = build_measured_drive(made_drive(SECONDS, seed=5), VEHICLE)
    t = np.arange(drive.ticks)
    found = {}
    for name, angle in {"step": np.where(t < 2400, 0.3, -0.3), "slow": 0.3 * np.cos(2.0 * np.pi * t / 4000.0)}.items():
        commands = drive.inputs.commands.copy()
        commands[:, 2] = angle
        inputs = drive.inputs._replace(commands=commands)
        found[name] = find_block_extremes(drive._replace(inputs=inputs), slice(2000, 2800))[STEER_CHANGE]
    assert found["step"] == pytest.approx(0.6) and found["slow"] < 0.02
