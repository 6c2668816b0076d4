"""Windows by kind of driving: rare kinds are drawn more often, none never, and left is as right."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

torch = pytest.importorskip("torch")

from tests.learn.training.made import REST, physics, track  # noqa: E402
from tunefree_hil.config.schema import EffectSpec  # noqa: E402
from tunefree_hil.learn.training.windows import (  # noqa: E402
    FEW,
    SPEED,
    Pool,
    begins,
    chances_of,
    drawn,
    kinds_of,
    pool_of,
    with_mirrored,
)

WARM, AHEAD = 100, 300


@pytest.fixture(scope="module")
def pool() -> Pool:
    return pool_of([track(1), track(2)], physics(), REST)


def held(speeds: list[float], rows: int = 3000) -> Pool:
    """So many rows at each speed, straight on, with the pedals at rest."""
    n = rows * len(speeds)
    motion = torch.zeros((n, 6), dtype=torch.float64)
    motion[:, SPEED] = torch.tensor(speeds, dtype=torch.float64).repeat_interleave(rows)
    inputs = torch.zeros((n, 3), dtype=torch.float64) + torch.tensor([REST, REST, 0.0])
    return Pool(0.01, REST, inputs, inputs, motion, torch.zeros(n), ((0, n),))


def test_what_takes_commands_learns_from_what_its_effects_make_of_them(pool: Pool) -> None:
    """A bench runs them before it: learned as well, they would be there twice. The actuators are its own."""
    offset = EffectSpec(name="steer_offset", params={"offset_rad": 0.05})
    other = pool_of([track(1), track(2)], replace(physics(), effects=[offset]), REST)
    moved, asked = other.commands - pool.commands, pool.commands
    assert moved[:, 2].numpy() == pytest.approx(0.05) and not moved[:, :2].any()
    assert asked.numpy() == pytest.approx(np.concatenate([one.commands for one in (track(1), track(2))]))


def test_a_kind_counts_by_the_root_of_its_share() -> None:
    some_pool = held([10.0, 10.0, 10.0, 10.0, 2.0])
    some = begins(some_pool, WARM, AHEAD)
    chances = chances_of(some_pool, some, WARM, AHEAD)
    assert chances.sum() == pytest.approx(1.0)
    fast, slow = some < 11_000, some > 12_000
    ratio = chances[slow].mean() / chances[fast].mean()
    assert ratio == pytest.approx(np.sqrt(fast.sum() / slow.sum()), rel=0.1)


def test_few_windows_of_a_kind_are_not_drawn_without_end() -> None:
    some_pool = held([10.0] * 9)
    some_pool.motion[-AHEAD - 40 :, SPEED] = 1.0
    some = begins(some_pool, WARM, AHEAD)
    chances = chances_of(some_pool, some, WARM, AHEAD)
    assert chances.max() / chances.min() <= np.sqrt(len(some) / FEW) * 1.001


def test_no_window_is_never_drawn_and_left_is_as_right(pool: Pool) -> None:
    both = with_mirrored(pool)
    some = begins(both, WARM, AHEAD)
    assert chances_of(both, some, WARM, AHEAD).min() > 0.0
    half = some[some < len(pool.inputs)]
    assert np.array_equal(kinds_of(both, half, WARM, AHEAD), kinds_of(both, half + len(pool.inputs), WARM, AHEAD))
    assert len(np.unique(kinds_of(pool, half, WARM, AHEAD), axis=0)) > 5


def test_lots_are_the_same_again_and_follow_the_chances(pool: Pool) -> None:
    some = begins(pool, WARM, AHEAD)
    chances = np.zeros(len(some))
    chances[[3, 40]] = 0.25, 0.75
    first, again = (drawn(some, 4000, 1, 7, chances) for _ in range(2))
    assert np.array_equal(first, again) and set(first) == {some[3], some[40]}
    assert np.mean(first == some[40]) == pytest.approx(0.75, abs=0.03)
    assert not np.array_equal(first, drawn(some, 4000, 1, 8, chances))
    assert len(set(drawn(some, len(some), 1, 7))) == len(some)
