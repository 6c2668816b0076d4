"""The nets of eq. 1: they learn, are the same for the same seed, and need no torch once they are trained."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.open_loop_map.cells import CellPoints, compute_cell_errors, compute_rms
from tunefree_hil.learn.open_loop_map.table import LinearScale, PedalNet, average_nets
from tunefree_hil.learn.training import map_nets


def bowl(seed: int = 0, count: int = 240) -> CellPoints:
    """A curved law of speed and command with a little noise, three points a cell."""
    rng = np.random.default_rng(seed)
    speed, command = rng.uniform(0.5, 20.0, count), rng.uniform(0.15, 0.8, count)
    accel = 3.0 * (1.0 - np.exp(-(command - 0.15) / 0.15)) / (1.0 + speed / 10.0) - 0.01 * speed
    return CellPoints(
        speed, command, accel + 0.01 * rng.standard_normal(count), np.arange(count) // 3, np.full(count, 1 / 3)
    )


def test_without_torch_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError, match="torch") as caught:
        map_nets.import_torch()
    assert "pip install '.[learn]'" in caught.value.hint and caught.value.code == "no_torch"


def test_a_net_is_equation_one() -> None:
    one = PedalNet(
        LinearScale(10.0, 5.0), LinearScale(0.5, 0.25), LinearScale(1.0, 2.0),
        np.array([0.3, -1.0]), np.array([2.0, 0.5]), np.array([0.1, -0.2]), np.array([1.5, -0.7]), 0.25,
    )  # fmt: skip
    v, u = (12.0 - 10.0) / 5.0, (0.6 - 0.5) / 0.25
    hidden = [1.0 / (1.0 + np.exp(-z)) for z in (0.3 * v + 2.0 * u + 0.1, -1.0 * v + 0.5 * u - 0.2)]
    assert one.predict_acceleration(np.array([12.0]), np.array([0.6])) == pytest.approx(
        [1.0 + 2.0 * (1.5 * hidden[0] - 0.7 * hidden[1] + 0.25)]
    )
    assert one.predict_acceleration(np.zeros((3, 4)), np.zeros((3, 4))).shape == (3, 4)


def net_data(points: CellPoints, held_out: CellPoints | None = None) -> map_nets.MapNetData:
    return map_nets.MapNetData(points, held_out, map_nets.scales_from_points(points))


class TestTraining:
    @pytest.fixture(autouse=True)
    def _torch(self) -> None:
        pytest.importorskip("torch", reason="the extra `learn` is not installed")

    def test_it_learns_a_curved_law(self) -> None:
        points, unseen = bowl(), bowl(1)
        trained = map_nets.train_map_net(net_data(points, unseen), 8, 1)
        assert trained.is_complete and trained.held_out_mps2 < 0.02
        assert compute_rms(compute_cell_errors(trained.net.predict_acceleration, unseen)) == pytest.approx(
            trained.held_out_mps2
        )

    def test_the_same_seed_gives_the_same_net_another_one_another(self) -> None:
        data = net_data(bowl())
        one, same, other = (map_nets.train_map_net(data, 5, seed, rounds=2).net for seed in (1, 1, 2))
        assert np.array_equal(one.w_out, same.w_out) and not np.array_equal(one.w_out, other.w_out)

    def test_the_width_whose_mean_net_is_best_is_chosen(self) -> None:
        points, unseen = bowl(), bowl(1)
        good = [map_nets.train_map_net(net_data(points, unseen), 8, seed) for seed in (1, 2)]
        poor = [map_nets.train_map_net(net_data(points), 3, seed, rounds=1) for seed in (1, 2)]
        group, error = map_nets.select_width([*poor, *good], unseen)
        assert [one.net.width for one in group] == [8, 8] and error < 0.02
        mean = sum(one.net.predict_acceleration(unseen.speed_mps, unseen.command_frac) for one in good) / 2.0
        whole = average_nets([one.net for one in good])
        assert whole.width == 16
        assert whole.predict_acceleration(unseen.speed_mps, unseen.command_frac) == pytest.approx(mean)

    def test_numbers_that_are_not_finite_stop_the_training_and_the_best_is_kept(self) -> None:
        points = bowl()
        broken = points._replace(accel_mps2=np.where(points.cell == 3, np.nan, points.accel_mps2))
        trained = map_nets.train_map_net(net_data(points, points)._replace(training=broken), 3, 1)
        assert not trained.is_complete
        assert np.all(np.isfinite(trained.net.w_out))

    def test_threads_are_left_as_they_were(self) -> None:
        import torch

        before = torch.get_num_threads()
        map_nets.train_map_net(net_data(bowl()), 3, 1, rounds=1)
        assert torch.get_num_threads() == before
