"""Guided run is the cell along the measured motion; left is as right; the blind input stays unseen."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from tests.learn.training.made import REST, physics, track  # noqa: E402
from tests.learn.training.test_rollout import stirred  # noqa: E402
from tunefree_hil.learn.training.fit import make_learner  # noqa: E402
from tunefree_hil.learn.training.learners import MASKED_INPUTS, FreeRunLearner, TrainingPlan  # noqa: E402
from tunefree_hil.learn.training.nets import cell_outputs  # noqa: E402
from tunefree_hil.learn.training.rollout import compute_errors  # noqa: E402
from tunefree_hil.learn.training.teacher_forcing import TeacherForcedRunner  # noqa: E402
from tunefree_hil.learn.training.windows import SPEED, TrackPool, add_mirrored, make_pool, make_windows  # noqa: E402

WARM, AHEAD = 100, 300
FIRST = np.array([300, 700, 1500])


@pytest.fixture(scope="module")
def pool() -> TrackPool:
    return make_pool([track(1)], physics(), REST)


@pytest.fixture
def learner(pool: TrackPool) -> FreeRunLearner:
    found = make_learner(TrainingPlan("hybrid", 1, 50, batch=16), pool, pool, physics())
    assert isinstance(found, FreeRunLearner)
    return found


def test_the_librarys_loop_is_the_cells(learner: FreeRunLearner) -> None:
    guided = learner.teacher_forced
    assert isinstance(guided, TeacherForcedRunner)
    stirred(learner.net)
    features = guided.base.features[make_windows(FIRST, WARM, AHEAD).rows[1:]]
    with torch.no_grad():
        outputs = guided.outputs(features)
        ready = learner.net.rollout_weights()
        for rows in (1, 50, WARM + AHEAD):
            hidden, _ = learner.net.run(ready, features[:rows].transpose(1, 2))
            assert torch.abs(cell_outputs(ready, hidden).T - outputs[rows - 1]).max() < 1e-5
    assert outputs.abs().max() > 0.01


def test_guided_run_is_free_run_as_long_as_the_speed_is_right(learner: FreeRunLearner) -> None:
    """One tick behind the warm-up both have been told the same; then the speed drifts apart slowly."""
    stirred(learner.net)
    assert learner.teacher_forced is not None
    window = make_windows(FIRST, WARM, AHEAD)
    with torch.no_grad():
        free, guided = (one.run(learner.training, window) for one in (learner.runner, learner.teacher_forced))
    moved = learner.training.motion[window.rows[WARM:], SPEED].mean(0) > 1.0
    assert moved.any()
    for ours, theirs in zip(guided, free, strict=True):
        assert torch.abs(ours[1] - theirs[1])[moved].max() < 2e-5
    missed = compute_errors(free, learner.training, window).speed_mps[-1].abs().mean()
    assert torch.abs(guided.speed[-1] - free.speed[-1]).mean() < 0.5 * missed


def test_training_reaches_the_net_in_every_stage_but_the_blind_input(learner: FreeRunLearner) -> None:
    stirred(learner.net)
    for step in (0, 49):
        learner.net.zero_grad()
        learner.loss(step).backward()
        slope = learner.net.w_in.grad
        assert slope is not None and float(slope.abs().sum()) > 0.0
        assert not slope[:, list(MASKED_INPUTS)].any()
    fresh = make_learner(TrainingPlan("hybrid", 1, 5), learner.held_out, learner.held_out, physics())
    assert not fresh.arrays()["w_in"][:, list(MASKED_INPUTS)].any()


def test_the_pace_falls_within_guided_and_within_free_run(learner: FreeRunLearner) -> None:
    learner.steps = 100
    guided, free = (
        [learner.rate_share(step) for step in range(96)],
        [learner.rate_share(step) for step in range(96, 100)],
    )
    assert guided[0] == 1.0 and free[0] == pytest.approx(0.05)
    for some in (guided, free):
        assert all(after < before for before, after in pairwise(some))
    assert learner.cost(0) < learner.cost(99)


def test_a_mirrored_drive_is_the_other_way_round(pool: TrackPool) -> None:
    both = add_mirrored(pool)
    rows = len(pool.inputs)
    assert len(both.spans) == 2 * len(pool.spans) and both.seconds == pytest.approx(2.0 * pool.seconds)
    assert torch.equal(both.inputs[rows:, 2], -pool.inputs[:, 2])
    assert torch.equal(both.inputs[rows:, :2], pool.inputs[:, :2])
    own = make_learner(TrainingPlan("hybrid", 1, 5), both, pool, physics())
    assert isinstance(own, FreeRunLearner)
    window = make_windows(np.concatenate([FIRST, FIRST + rows]), WARM, AHEAD)
    with torch.no_grad():
        errors = compute_errors(own.runner.run(own.training, window), own.training, window)
    one, other = errors.heading_rad.split(len(FIRST), dim=1)
    assert torch.abs(one + other).max() < 1e-9 < one.abs().max()
    left, right = errors.position_m.split(len(FIRST), dim=1)
    assert torch.abs(left - right).max() < 1e-9
