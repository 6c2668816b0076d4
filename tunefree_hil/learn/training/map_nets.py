"""Training of the map's two nets (eq. 1, Table I): hidden width by enumeration on held-out cells, mean of seeds.

Full batch, float64, L-BFGS: some hundred points and weights, so a net takes a fraction of a second. What is trained is
a `PedalNet`, which needs no torch.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.open_loop_map.cells import Points, cell_errors, rms
from tunefree_hil.learn.open_loop_map.table import PedalNet, Scale, merged, scale_of

WIDTHS = (3, 5, 8, 12, 16)  # shipped: 15 for the throttle, 10 for the brake (apollo_facts 5.2)
SEEDS = 3
ROUND_ITERATIONS = 20  # of L-BFGS, after which the held-out error is looked at
MOST_ROUNDS = 30
PATIENCE = 6  # rounds without a better held-out error
DECAY = 1e-6  # on the squares of all weights but the biases, beside the mean squared error in scaled units
BIAS_SPREAD = 2.0  # of the first biases: the units' bends lie all over the inputs


class Trained(NamedTuple):
    """A net, its error on the held-out cells (m/s2, NaN where none were held out), the round that was its best."""

    net: PedalNet
    held_out_mps2: float
    rounds: int
    seed: int
    whole: bool  # False: it came to numbers that are not finite; this is the best before


class Scales(NamedTuple):
    """Of both inputs and the output."""

    speed: Scale
    command: Scale
    accel: Scale


def require_torch() -> Any:
    """The library. Raises InputError where it is not installed."""
    try:
        import torch
    except ImportError as error:
        raise InputError(
            "training needs torch, which is not installed",
            code="no_torch",
            hint="pip install '.[learn]' in the project's folder; everything but `learn` and `map` works without it",
        ) from error
    return torch


def scales_of(points: Points) -> Scales:
    """Of all points of a pedal, held out or not."""
    return Scales(scale_of(points.speed_mps), scale_of(points.command_frac), scale_of(points.accel_mps2))


def enumerate_widths(training: Points, held_out: Points, scales: Scales, seed: int) -> Iterator[Trained]:
    """Every width with every seed, narrow ones first."""
    for width in WIDTHS:
        for number in range(SEEDS):
            yield train(training, held_out, scales, width, seed * SEEDS + number)


def chosen(candidates: Sequence[Trained], held_out: Points) -> tuple[list[Trained], float]:
    """The seeds of the width whose mean net does best on the held-out cells, and its error there."""
    by_width: dict[int, list[Trained]] = {}
    for one in candidates:
        by_width.setdefault(one.net.width, []).append(one)
    errors = {width: error_of(merged([one.net for one in group]), held_out) for width, group in by_width.items()}
    best = min(errors, key=errors.__getitem__)
    return by_width[best], errors[best]


def train(training: Points, held_out: Points | None, scales: Scales, width: int, seed: int, rounds: int = 0) -> Trained:
    """One net. With held-out points: stopped early on their error; without: after `rounds` (0: MOST_ROUNDS)."""
    torch = require_torch()
    with _one_thread(torch):
        weights = _first_weights(torch, width, seed)
        optimizer = torch.optim.LBFGS(
            weights, max_iter=ROUND_ITERATIONS, history_size=ROUND_ITERATIONS, line_search_fn="strong_wolfe"
        )
        loss = _loss_of(torch, training, scales, weights)

        def closure() -> Any:
            optimizer.zero_grad()
            value = loss()
            value.backward()
            return value

        best: Trained | None = None
        for k in range(1, (rounds or MOST_ROUNDS) + 1):
            optimizer.step(closure)
            net = _net_of(scales, weights)
            error = error_of(net, training if held_out is None else held_out)
            if not np.isfinite(error):
                fallback = best or Trained(_net_of(scales, _first_weights(torch, width, seed)), np.inf, 0, seed, False)
                return fallback._replace(whole=False)
            if held_out is None or best is None or error < best.held_out_mps2:
                best = Trained(net, error, k, seed, True)
            elif k - best.rounds >= PATIENCE:
                break
    assert best is not None
    return best if held_out is not None else best._replace(held_out_mps2=float("nan"))


def error_of(net: PedalNet, points: Points) -> float:
    """On cells, m/s2; not finite where the net's weights are not."""
    return rms(cell_errors(net.accel_of, points))


def _first_weights(torch: Any, width: int, seed: int) -> list[Any]:
    """Speed, command, bias, output, output's bias: Xavier, but for the biases, which spread the bends."""
    chance = torch.Generator().manual_seed(seed)

    def drawn(count: int, spread: float) -> Any:
        return ((2.0 * torch.rand(count, generator=chance, dtype=torch.float64) - 1.0) * spread).requires_grad_()

    inner, outer = (6.0 / (2.0 + width)) ** 0.5, (6.0 / (1.0 + width)) ** 0.5
    weights = [drawn(width, 3.0 * inner), drawn(width, 3.0 * inner), drawn(width, BIAS_SPREAD), drawn(width, outer)]
    return [*weights, torch.zeros(1, dtype=torch.float64, requires_grad=True)]


def _loss_of(torch: Any, points: Points, scales: Scales, weights: list[Any]) -> Any:
    """() -> weighted mean squared error in scaled units plus the decay."""
    v, u, a = (
        torch.as_tensor(scale.into(values), dtype=torch.float64)
        for scale, values in zip(scales, points[:3], strict=True)
    )
    share = torch.as_tensor(points.weight / np.sum(points.weight), dtype=torch.float64)
    w_speed, w_command, bias, w_out, b_out = weights

    def loss() -> Any:
        hidden = torch.sigmoid(v[:, None] * w_speed + u[:, None] * w_command + bias)
        missed = hidden @ w_out + b_out - a
        decay = sum((w * w).sum() for w in (w_speed, w_command, w_out))
        return (share * missed * missed).sum() + DECAY * decay

    return loss


def _net_of(scales: Scales, weights: list[Any]) -> PedalNet:
    w_speed, w_command, bias, w_out, b_out = (one.detach().numpy().copy() for one in weights)
    return PedalNet(*scales, w_speed, w_command, bias, w_out, float(b_out[0]))


@contextmanager
def _one_thread(torch: Any) -> Iterator[None]:
    """Tensors this small only lose time to threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
