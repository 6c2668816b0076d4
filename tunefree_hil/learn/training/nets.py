"""Trainable versions of the nets of plant/learned/lstm_cell.py; parameters and buffers are the arrays of plant.npz."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from tunefree_hil.learn.drives.drive import Array

N_CELL_UNITS = 8  # of the cell (Baidu paper, Table I)
N_HIDDEN_UNITS = 10  # of kind mlp


class RolloutWeights(NamedTuple):
    """Weights of a cell for a rollout: scaling folded in, rows in the order input, forget, output gate, candidate.

    h: units of the cell, i: inputs.
    """

    inputs: Tensor  # (4h, i)
    hidden: Tensor  # (4h, h)
    both: Tensor  # (4h, i + h)
    bias: Tensor  # (4h, 1)
    out: Tensor  # (2, h)
    out_bias: Tensor  # (2, 1)
    bound: Tensor  # (2, 1)


class NetScaling(NamedTuple):
    """Mean and scale of the inputs of a net, shape (n_inputs,), and the bounds of its two outputs."""

    mean: Array
    scale: Array
    bound: Sequence[float]


class ScaledNet(nn.Module):
    """A net with its scaling as buffers."""

    mean: Tensor
    scale: Tensor
    bound: Tensor

    def __init__(self, scaling: NetScaling) -> None:
        super().__init__()
        for name, values in scaling._asdict().items():
            self.register_buffer(name, torch.as_tensor(values, dtype=torch.float64))

    def arrays(self) -> dict[str, Array]:
        """The arrays of plant.npz."""
        return {name: value.detach().numpy().copy() for name, value in self.state_dict().items()}


def draw_weights(generator: torch.Generator, spread: float, *shape: int) -> nn.Parameter:
    """Weights between -spread and spread."""
    return nn.Parameter((torch.rand(*shape, generator=generator, dtype=torch.float64) * 2.0 - 1.0) * spread)


class CellNet(ScaledNet):
    """LSTM cell and a linear layer with two bounded outputs.

    Args:
        scaling: Of inputs and outputs.
        seed: Of the weights.
        relu: ReLU replaces tanh in the cell.
        zero_outputs: The outputs start at 0.
        masked: Inputs whose weights stay 0.
    """

    def __init__(
        self,
        scaling: NetScaling,
        seed: int,
        *,
        relu: bool = False,
        zero_outputs: bool = True,
        masked: Sequence[int] = (),
    ) -> None:
        super().__init__(scaling)
        generator = torch.Generator().manual_seed(seed)
        inputs, spread = len(scaling.mean), 1.0 / math.sqrt(N_CELL_UNITS)

        self.w_in = draw_weights(generator, spread, 4 * N_CELL_UNITS, inputs)
        self.w_rec = draw_weights(generator, spread, 4 * N_CELL_UNITS, N_CELL_UNITS)
        if masked:
            mask = torch.ones(inputs, dtype=torch.float64)
            mask[list(masked)] = 0.0
            self.w_in.data *= mask
            self.w_in.register_hook(lambda gradient: gradient * mask)
        bias = torch.zeros(4 * N_CELL_UNITS, dtype=torch.float64)
        bias[N_CELL_UNITS : 2 * N_CELL_UNITS] = 1.0  # the forget gate starts open
        self.bias = nn.Parameter(bias)
        zeros = nn.Parameter(torch.zeros(2, N_CELL_UNITS, dtype=torch.float64))
        self.w_out = zeros if zero_outputs else draw_weights(generator, spread, 2, N_CELL_UNITS)
        self.b_out = nn.Parameter(torch.zeros(2, dtype=torch.float64))
        self.relu = relu

    def rollout_weights(self) -> RolloutWeights:
        """Weights for a rollout, with gradients."""
        units = N_CELL_UNITS
        order = [*range(2 * units), *range(3 * units, 4 * units), *range(2 * units, 3 * units)]
        scaled = self.w_in / self.scale
        bias = self.bias - scaled @ self.mean
        inputs, hidden = scaled[order], self.w_rec[order]
        return RolloutWeights(
            inputs=inputs,
            hidden=hidden,
            both=torch.cat([inputs, hidden], dim=1),
            bias=bias[order].unsqueeze(1),
            out=self.w_out,
            out_bias=self.b_out.unsqueeze(1),
            bound=self.bound.unsqueeze(1),
        )

    def step(self, gates: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Hidden state and memory after a step, shape (n_units, n_windows).

        Args:
            gates: Sums of the gates in the order of RolloutWeights, shape (4 * n_units, n_windows).
            memory: Before the step.
        """
        opening = torch.sigmoid(gates[: 3 * N_CELL_UNITS])
        shape = torch.relu if self.relu else torch.tanh
        memory = opening[N_CELL_UNITS : 2 * N_CELL_UNITS] * memory + opening[:N_CELL_UNITS] * shape(
            gates[3 * N_CELL_UNITS :]
        )
        return opening[2 * N_CELL_UNITS :] * shape(memory), memory

    def run(self, weights: RolloutWeights, features: Tensor) -> tuple[Tensor, Tensor]:
        """Hidden state and memory after known features, from 0. features: shape (n_ticks, n_inputs, n_windows)."""
        sums = weights.inputs @ features + weights.bias
        hidden = torch.zeros(N_CELL_UNITS, features.shape[2], dtype=features.dtype)
        memory = hidden
        for row in sums.unbind(0):
            hidden, memory = self.step(torch.addmm(row, weights.hidden, hidden), memory)
        return hidden, memory


def cell_outputs(weights: RolloutWeights, hidden: Tensor) -> Tensor:
    """The two bounded outputs, shape (2, n_windows)."""
    return weights.bound * torch.tanh(torch.addmm(weights.out_bias, weights.out, hidden))


class LayerNet(ScaledNet):
    """One hidden layer of tanh and two bounded outputs."""

    def __init__(self, scaling: NetScaling, seed: int) -> None:
        super().__init__(scaling)
        generator = torch.Generator().manual_seed(seed)
        shapes = (N_HIDDEN_UNITS, len(scaling.mean)), (2, N_HIDDEN_UNITS)
        self.w1, self.w2 = (draw_weights(generator, math.sqrt(6.0 / sum(shape)), *shape) for shape in shapes)
        self.b1 = nn.Parameter(torch.zeros(N_HIDDEN_UNITS, dtype=torch.float64))
        self.b2 = nn.Parameter(torch.zeros(2, dtype=torch.float64))

    def forward(self, features: Tensor) -> Tensor:
        """Outputs, shape (2, n_windows), for features of shape (n_inputs, n_windows)."""
        scaled = (features - self.mean.unsqueeze(1)) / self.scale.unsqueeze(1)
        hidden = torch.tanh(torch.addmm(self.b1.unsqueeze(1), self.w1, scaled))
        return self.bound.unsqueeze(1) * torch.tanh(torch.addmm(self.b2.unsqueeze(1), self.w2, hidden))
