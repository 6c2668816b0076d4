"""A trained net runs in torch as in the kernels that ECU and batch run: within 1e-5 a tick, 1 mm over 10 s."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from tests.learn.training.made import REST, physics, track, vehicle  # noqa: E402
from tunefree_hil.config.load import load_model  # noqa: E402
from tunefree_hil.learn.evaluation.free_run import RunSpan, make_runnable, run_free  # noqa: E402
from tunefree_hil.learn.evaluation.motion import simulate_actuators  # noqa: E402
from tunefree_hil.learn.model_folder import LearnedModel, write_learned_model  # noqa: E402
from tunefree_hil.learn.training.fit import make_learner  # noqa: E402
from tunefree_hil.learn.training.learners import FreeRunLearner, TrainingPlan  # noqa: E402
from tunefree_hil.learn.training.one_step import OneStepLearner  # noqa: E402
from tunefree_hil.learn.training.rollout import KinematicRunner, PhysicsRunner, integrate_pose  # noqa: E402
from tunefree_hil.learn.training.windows import TrackPool, make_pool, make_windows  # noqa: E402

WARM, AHEAD = 100, 1000
FIRST = np.array([300])


@pytest.fixture(scope="module")
def pool() -> TrackPool:
    return make_pool([track(1)], physics(), REST)


def stirred(net: torch.nn.Module, seed: int = 1) -> None:
    """Weights as large as a training's, so that the outputs say something."""
    draw = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for value in net.parameters():
            value += 0.1 * torch.randn(value.shape, generator=draw, dtype=value.dtype)


def by_kernel(kind: str, arrays: dict[str, np.ndarray] | None, folder: Path) -> list[np.ndarray]:
    """Rows (x, y, heading, speed, yaw rate) from the start on."""
    model = physics()
    if arrays is not None:
        write_learned_model(folder / kind, LearnedModel(kind, vehicle(), model, arrays), {})
        model = load_model(folder / kind)
    rig, own = make_runnable(model, vehicle()), track(1)
    outputs = simulate_actuators(own, model, REST)
    return [run_free(rig, own, outputs, RunSpan(int(first), WARM, AHEAD))[WARM:] for first in FIRST]


def compare(runner: PhysicsRunner | KinematicRunner, pool: TrackPool, kernel: list[np.ndarray], a_tick: float) -> None:
    window = make_windows(FIRST, WARM, AHEAD)
    with torch.no_grad():
        ran = runner.run(pool, window)
        heading, x, y = integrate_pose(ran, pool.dt_s)
    for i, rows in enumerate(kernel):
        assert abs(ran.speed[1, i] - rows[1, 3]) < a_tick * pool.dt_s
        assert abs(ran.yaw_rate[1, i] - rows[1, 4]) < a_tick
        assert np.abs(ran.speed[1:, i].numpy() - rows[1:, 3]).max() < 1e-3
        own, row = track(1), FIRST[i] + WARM
        cosine, sine = np.cos(own.heading_rad[row]), np.sin(own.heading_rad[row])
        dx, dy = rows[1:, 0] - own.x_m[row], rows[1:, 1] - own.y_m[row]
        apart = np.hypot(dx * cosine + dy * sine - x[:, i].numpy(), dy * cosine - dx * sine - y[:, i].numpy())
        assert apart.max() < 1e-3
        assert np.abs(heading[:, i].numpy() - (rows[1:, 2] - own.heading_rad[row])).max() < 1e-4
    assert float(ran.speed.max()) > 3.0  # it went somewhere


def test_physics(pool: TrackPool, tmp_path: Path) -> None:
    learner = make_learner(TrainingPlan("hybrid", 1, 10), pool, pool, physics())
    assert isinstance(learner, FreeRunLearner)
    runner = learner.runner
    assert isinstance(runner, PhysicsRunner)
    compare(PhysicsRunner(runner.physics, pool), pool, by_kernel("physics", None, tmp_path), 1e-9)


@pytest.mark.parametrize("kind", ["hybrid", "lstm"])
def test_a_net_runs_as_in_its_kernel(kind: str, pool: TrackPool, tmp_path: Path) -> None:
    learner = make_learner(TrainingPlan(kind, 1, 10), pool, pool, physics())
    stirred(learner.net)
    assert isinstance(learner, FreeRunLearner)
    compare(learner.runner, pool, by_kernel(kind, learner.arrays(), tmp_path), 1e-5)


@pytest.mark.parametrize("kind", ["mlp", "paper"])
def test_a_one_step_net_says_what_its_kernel_says(kind: str, pool: TrackPool, tmp_path: Path) -> None:
    """One step after a measured second: acceleration and yaw rate."""
    learner = OneStepLearner(TrainingPlan(kind, 1, 10), pool, pool)
    stirred(learner.net)
    write_learned_model(tmp_path / kind, LearnedModel(kind, vehicle(), physics(), learner.arrays()), {})
    rig, own = make_runnable(load_model(tmp_path / kind), vehicle()), track(1)
    row = int(FIRST[0]) + WARM
    shown = run_free(rig, own, rig.actuator_outputs(own), RunSpan(int(FIRST[0]), WARM, 1))[-1]
    with torch.no_grad():
        features = learner._features(pool, np.array([row + 1]))
        if kind == "mlp":
            said = learner.net(features[0])
        else:
            ready = learner.net.rollout_weights()
            hidden, _ = learner.net.run(ready, features)
            said = torch.addmm(ready.out_bias, ready.out, hidden) * learner.spread + learner.mean
    assert abs((shown[3] - own.speed_mps[row]) / pool.dt_s - float(said[0])) < 1e-5
    assert abs(shown[4] - float(said[1])) < 1e-5
