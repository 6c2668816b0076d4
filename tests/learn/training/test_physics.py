"""The single-track tick in torch is the kernel's, and its slopes are what small differences of the kernel say."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from tunefree_hil.base.contracts import BodyChange  # noqa: E402
from tunefree_hil.base.records import GEAR_DRIVE, Actuation, Disturbance  # noqa: E402
from tunefree_hil.learn.training.physics import BatchedSingleTrack, step_physics  # noqa: E402
from tunefree_hil.plant.data_sheet import constants_of  # noqa: E402
from tunefree_hil.plant.kinematics import Velocity  # noqa: E402
from tunefree_hil.plant.single_track import pushed  # noqa: E402
from tunefree_hil.plant.types import ChassisInput  # noqa: E402

DT_S = 0.01
PARAMS = {"front_axle_m": 1.27, "front_stiffness_n_per_rad": 118000.0, "throttle_zero_frac": 0.17,
          "overrun_force_n": 400.0, "brake_rise_per_frac": 0.6, "drive_corner": 5.0}  # fmt: skip


def drawn(count: int, top_mps: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States [3, n], actuator outputs [n, 3], grades [n]: all that a car may meet, and somewhat more."""
    rng = np.random.default_rng(seed)
    states = np.stack([rng.uniform(0.0, top_mps, count), rng.normal(0.0, 0.4, count), rng.normal(0.0, 0.4, count)])
    outputs = np.stack([rng.uniform(0.1, 0.85, count), rng.uniform(0.1, 0.4, count), rng.uniform(-8.0, 8.0, count)], 1)
    outputs[::2, 1] = 0.15
    return states, outputs, rng.normal(0.0, 0.05, count)


def by_kernel(states: np.ndarray, outputs: np.ndarray, grades: np.ndarray) -> np.ndarray:
    p = constants_of(PARAMS, BodyChange())
    found = []
    for state, (throttle, brake, steer), grade in zip(
        states.T.tolist(), outputs.tolist(), grades.tolist(), strict=True
    ):
        x = ChassisInput(Actuation(throttle, brake, steer, GEAR_DRIVE), Disturbance(grade, 1.0))
        found.append(tuple(pushed(p, Velocity(*state), 0.0, x, DT_S).velocity))
    return np.array(found).T


@pytest.mark.parametrize("top_mps", [0.6, 2.0, 30.0])
def test_a_tick_is_the_kernels(top_mps: float) -> None:
    states, outputs, grades = drawn(300, top_mps, 1)
    physics = BatchedSingleTrack(PARAMS, DT_S)
    push = physics.compute_inputs(outputs, grades).T
    after = physics.step(states, push)
    assert np.abs(after - by_kernel(states, outputs, grades)).max() < 1e-9


def test_slopes_are_those_of_the_kernel() -> None:
    states, outputs, grades = drawn(60, 25.0, 2)
    states[0] += 2.0  # clear of the corners near standstill
    physics = BatchedSingleTrack(PARAMS, DT_S)
    push = physics.compute_inputs(outputs, grades).T
    for out in range(3):
        state = torch.from_numpy(states).requires_grad_()
        step_physics(physics, state, push)[out].sum().backward()
        for part in range(3):
            nudge = np.zeros((3, 1))
            nudge[part] = 1e-4
            up, down = by_kernel(states + nudge, outputs, grades), by_kernel(states - nudge, outputs, grades)
            expected = (up - down)[out] / 2e-4
            assert np.abs(state.grad[part].numpy() - expected).max() < 1e-4


def test_without_gradients_a_tick_is_the_same_to_the_bit() -> None:
    states, outputs, grades = drawn(40, 20.0, 3)
    physics = BatchedSingleTrack(PARAMS, DT_S)
    push = physics.compute_inputs(outputs, grades).T
    with torch.no_grad():
        plain = step_physics(physics, torch.from_numpy(states), push)
    assert torch.equal(plain, step_physics(physics, torch.from_numpy(states).requires_grad_(), push).detach())
