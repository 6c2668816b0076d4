"""Training of the two nets of the open-loop map (Baidu paper, eq. 1 and Table I).

The hidden width is selected on held-out cells, and the nets of several seeds are averaged. Training is full batch in
float64 with L-BFGS: some hundred points and weights take a fraction of a second. The result needs no torch.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.open_loop_map.cells import CellPoints, compute_cell_errors, compute_rms
from tunefree_hil.learn.open_loop_map.table import LinearScale, PedalNet, average_nets, scale_from_values

HIDDEN_WIDTHS = (3, 5, 8, 12, 16)  # Apollo's nets have 15 for the throttle and 10 for the brake
N_SEEDS = 3
ROUND_ITERATIONS = 20  # of L-BFGS between two evaluations
MAX_ROUNDS = 30
PATIENCE_ROUNDS = 6  # without a better held-out error
WEIGHT_DECAY = 1e-6  # on squared weights but the biases, beside the mean squared error in scaled units
INITIAL_BIAS_SPREAD = 2.0  # spreads the transitions of the units over the inputs


class TrainedMapNet(NamedTuple):
    """A trained net.

    Attributes:
        held_out_mps2: Error on held-out cells, NaN without.
        rounds: The best round.
        seed: Of the weights.
        is_complete: False: it diverged to values that are not finite; `net` is the best one before.
    """

    net: PedalNet
    held_out_mps2: float
    rounds: int
    seed: int
    is_complete: bool


class MapNetScales(NamedTuple):
    """Scales of inputs and output."""

    speed: LinearScale
    command: LinearScale
    accel: LinearScale


class MapNetData(NamedTuple):
    """What a net is trained on. held_out: points that stop the training; None: it ends after a number of rounds."""

    training: CellPoints
    held_out: CellPoints | None
    scales: MapNetScales


def import_torch() -> Any:
    """The torch module.

    Raises:
        InputError: It is not installed.
    """
    try:
        import torch
    except ImportError as error:
        raise InputError(
            "training needs torch, which is not installed",
            code="no_torch",
            hint="pip install '.[learn]' in the project's folder; everything but `learn` and `map` works without it",
        ) from error
    return torch


def scales_from_points(points: CellPoints) -> MapNetScales:
    """Scales over all points of a pedal, held out or not."""
    return MapNetScales(
        scale_from_values(points.speed_mps),
        scale_from_values(points.command_frac),
        scale_from_values(points.accel_mps2),
    )


def train_all_widths(data: MapNetData, seed: int) -> Iterator[TrainedMapNet]:
    """Every width with every seed, narrow ones first."""
    for width in HIDDEN_WIDTHS:
        for number in range(N_SEEDS):
            yield train_map_net(data, width, seed * N_SEEDS + number)


def select_width(candidates: Sequence[TrainedMapNet], held_out: CellPoints) -> tuple[list[TrainedMapNet], float]:
    """The nets of the width whose mean net has the least error on the held-out cells, and that error."""
    by_width: dict[int, list[TrainedMapNet]] = {}
    for candidate in candidates:
        by_width.setdefault(candidate.net.width, []).append(candidate)
    errors = {
        width: compute_net_error(average_nets([candidate.net for candidate in group]), held_out)
        for width, group in by_width.items()
    }
    best = min(errors, key=errors.__getitem__)
    return by_width[best], errors[best]


def train_map_net(data: MapNetData, width: int, seed: int, rounds: int = 0) -> TrainedMapNet:
    """Train one net: with held-out points it is stopped by their error, else after `rounds` (0: MAX_ROUNDS)."""
    torch = import_torch()
    training, held_out, scales = data
    with _single_thread(torch):
        weights = _initial_weights(torch, width, seed)
        optimizer = torch.optim.LBFGS(
            weights, max_iter=ROUND_ITERATIONS, history_size=ROUND_ITERATIONS, line_search_fn="strong_wolfe"
        )
        loss = _make_loss(torch, training, scales, weights)

        def closure() -> Any:
            optimizer.zero_grad()
            value = loss()
            value.backward()
            return value

        best: TrainedMapNet | None = None
        for k in range(1, (rounds or MAX_ROUNDS) + 1):
            optimizer.step(closure)
            net = _net_from_weights(scales, weights)
            error = compute_net_error(net, training if held_out is None else held_out)
            if not np.isfinite(error):
                untrained = _net_from_weights(scales, _initial_weights(torch, width, seed))
                return (best or TrainedMapNet(untrained, np.inf, 0, seed, False))._replace(is_complete=False)
            if held_out is None or best is None or error < best.held_out_mps2:
                best = TrainedMapNet(net, error, k, seed, True)
            elif k - best.rounds >= PATIENCE_ROUNDS:
                break
    assert best is not None
    return best if held_out is not None else best._replace(held_out_mps2=float("nan"))


def compute_net_error(net: PedalNet, points: CellPoints) -> float:
    """RMS error over cells, m/s2; not finite where the weights are not."""
    return compute_rms(compute_cell_errors(net.predict_acceleration, points))


def _initial_weights(torch: Any, width: int, seed: int) -> list[Any]:
    """Speed, command, bias, output, output's bias: Xavier, but for the biases."""
    generator = torch.Generator().manual_seed(seed)

    def draw(count: int, spread: float) -> Any:
        uniform = torch.rand(count, generator=generator, dtype=torch.float64)
        return ((2.0 * uniform - 1.0) * spread).requires_grad_()

    inner, outer = (6.0 / (2.0 + width)) ** 0.5, (6.0 / (1.0 + width)) ** 0.5
    weights = [draw(width, 3.0 * inner), draw(width, 3.0 * inner), draw(width, INITIAL_BIAS_SPREAD), draw(width, outer)]
    return [*weights, torch.zeros(1, dtype=torch.float64, requires_grad=True)]


def _make_loss(torch: Any, points: CellPoints, scales: MapNetScales, weights: list[Any]) -> Any:
    """A function without arguments: weighted mean squared error in scaled units plus weight decay."""
    v, u, a = (
        torch.as_tensor(scale.normalize(values), dtype=torch.float64)
        for scale, values in zip(scales, points[:3], strict=True)
    )
    share = torch.as_tensor(points.weight / np.sum(points.weight), dtype=torch.float64)
    w_speed, w_command, bias, w_out, b_out = weights

    def loss() -> Any:
        hidden = torch.sigmoid(v[:, None] * w_speed + u[:, None] * w_command + bias)
        error = hidden @ w_out + b_out - a
        decay = sum((w * w).sum() for w in (w_speed, w_command, w_out))
        return (share * error * error).sum() + WEIGHT_DECAY * decay

    return loss


def _net_from_weights(scales: MapNetScales, weights: list[Any]) -> PedalNet:
    w_speed, w_command, bias, w_out, b_out = (weight.detach().numpy().copy() for weight in weights)
    return PedalNet(*scales, w_speed, w_command, bias, w_out, float(b_out[0]))


@contextmanager
def _single_thread(torch: Any) -> Iterator[None]:
    """Limit torch to one thread: with more, such small tensors are slower."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
