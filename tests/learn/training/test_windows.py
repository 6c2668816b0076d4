"""Windows by kind of driving: rare kinds are drawn more often, none never, and left is as right."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

torch = pytest.importorskip("torch")

from tests.learn.training.made import REST, physics, track  # noqa: E402
from tunefree_hil.config.schema import EffectSpec  # noqa: E402
from tunefree_hil.learn.training.windows import (  # noqa: E402
    CRITERIA,
    SPEED,
    TrackPool,
    add_mirrored,
    classify_windows,
    compute_draw_probabilities,
    draw_rows,
    find_window_starts,
    make_pool,
)

WARM, AHEAD = 100, 300


@pytest.fixture(scope="module")
def pool() -> TrackPool:
    return make_pool([track(1), track(2)], physics(), REST)


def held(speeds: list[float], rows: int = 3000) -> TrackPool:
    """So many rows at each speed, straight on, with the pedals at rest."""
    n = rows * len(speeds)
    motion = torch.zeros((n, 6), dtype=torch.float64)
    motion[:, SPEED] = torch.tensor(speeds, dtype=torch.float64).repeat_interleave(rows)
    inputs = torch.zeros((n, 3), dtype=torch.float64) + torch.tensor([REST, REST, 0.0])
    return TrackPool(0.01, REST, inputs, inputs, motion, torch.zeros(n), ((0, n),))


def test_what_takes_commands_learns_from_what_its_effects_make_of_them(pool: TrackPool) -> None:
    """A bench runs them before it: learned as well, they would be there twice. The actuators are its own."""
    offset = EffectSpec(name="steer_offset", params={"offset_rad": 0.05})
    other = make_pool([track(1), track(2)], replace(physics(), effects=[offset]), REST)
    moved, asked = other.commands - pool.commands, pool.commands
    assert moved[:, 2].numpy() == pytest.approx(0.05) and not moved[:, :2].any()
    assert asked.numpy() == pytest.approx(np.concatenate([one.commands for one in (track(1), track(2))]))


def test_a_kind_counts_by_the_root_of_its_share() -> None:
    some_pool = held([10.0, 10.0, 10.0, 10.0, 2.0])
    some = find_window_starts(some_pool, WARM, AHEAD)
    probabilities = compute_draw_probabilities(some_pool, some, WARM, AHEAD)
    assert probabilities.sum() == pytest.approx(1.0)
    fast, slow = some < 11_000, some > 12_000
    ratio = probabilities[slow].mean() / probabilities[fast].mean()
    assert ratio == pytest.approx(np.sqrt(fast.sum() / slow.sum()), rel=0.1)


def test_few_windows_of_a_kind_are_not_drawn_without_end() -> None:
    some_pool = held([10.0] * 9)
    some_pool.motion[-AHEAD - 40 :, SPEED] = 1.0
    some = find_window_starts(some_pool, WARM, AHEAD)
    probabilities = compute_draw_probabilities(some_pool, some, WARM, AHEAD)
    assert probabilities.max() / probabilities.min() <= np.sqrt(len(some) / CRITERIA.min_class_windows) * 1.001


def test_no_window_is_never_drawn_and_left_is_as_right(pool: TrackPool) -> None:
    both = add_mirrored(pool)
    some = find_window_starts(both, WARM, AHEAD)
    assert compute_draw_probabilities(both, some, WARM, AHEAD).min() > 0.0
    half = some[some < len(pool.inputs)]
    assert np.array_equal(
        classify_windows(both, half, WARM, AHEAD), classify_windows(both, half + len(pool.inputs), WARM, AHEAD)
    )
    assert len(np.unique(classify_windows(pool, half, WARM, AHEAD), axis=0)) > 5


def test_lots_are_the_same_again_and_follow_the_chances(pool: TrackPool) -> None:
    some = find_window_starts(pool, WARM, AHEAD)
    probabilities = np.zeros(len(some))
    probabilities[[3, 40]] = 0.25, 0.75
    first, again = (draw_rows(some, 4000, 1, 7, probabilities) for _ in range(2))
    assert np.array_equal(first, again) and set(first) == {some[3], some[40]}
    assert np.mean(first == some[40]) == pytest.approx(0.75, abs=0.03)
    assert not np.array_equal(first, draw_rows(some, 4000, 1, 8, probabilities))
    assert len(set(draw_rows(some, len(some), 1, 7))) == len(some)
