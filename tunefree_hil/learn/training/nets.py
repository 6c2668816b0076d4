"""The trained networks as torch modules: the cell and the layer of plant/learned/lstm_cell.py with their arrays in plant.npz."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from tunefree_hil.learn.drives.drive import Array

UNITS = 8  # of the cell (paper Table I)
HIDDEN = 10  # of the mlp


class Ready(NamedTuple):
    """Weights as a rollout wants them: scaling folded in, rows in the order input, forget, output gate, candidate."""

    inputs: Tensor  # [4H, I]
    hidden: Tensor  # [4H, H]
    both: Tensor  # [4H, I + H]
    bias: Tensor  # [4H, 1]
    out: Tensor  # [2, H]
    out_bias: Tensor  # [2, 1]
    bound: Tensor  # [2, 1]


class CellNet(nn.Module):
    """LSTM cell and linear layer to two outputs; parameters and buffers are named as the arrays of plant.npz.

    relu: the rectifier in place of tanh in the cell. still: the outputs begin at 0. blind: inputs that the cell
    does not look at, whose weights are 0 and stay so.
    """

    mean: Tensor
    scale: Tensor
    bound: Tensor

    def __init__(
        self,
        mean: Array,
        scale: Array,
        bound: Sequence[float],
        seed: int,
        *,
        relu: bool = False,
        still: bool = True,
        blind: Sequence[int] = (),
    ) -> None:
        super().__init__()
        draw = torch.Generator().manual_seed(seed)
        inputs, spread = len(mean), 1.0 / math.sqrt(UNITS)

        def drawn(*shape: int) -> nn.Parameter:
            return nn.Parameter((torch.rand(*shape, generator=draw, dtype=torch.float64) * 2.0 - 1.0) * spread)

        self.w_in, self.w_rec = drawn(4 * UNITS, inputs), drawn(4 * UNITS, UNITS)
        if blind:
            seen = torch.ones(inputs, dtype=torch.float64)
            seen[list(blind)] = 0.0
            self.w_in.data *= seen
            self.w_in.register_hook(lambda slope: slope * seen)
        bias = torch.zeros(4 * UNITS, dtype=torch.float64)
        bias[UNITS : 2 * UNITS] = 1.0  # the forget gate begins open: memory lasts
        self.bias = nn.Parameter(bias)
        self.w_out = nn.Parameter(torch.zeros(2, UNITS, dtype=torch.float64)) if still else drawn(2, UNITS)
        self.b_out = nn.Parameter(torch.zeros(2, dtype=torch.float64))
        self.relu = relu
        for name, values in (("mean", mean), ("scale", scale), ("bound", bound)):
            self.register_buffer(name, torch.as_tensor(values, dtype=torch.float64))

    def ready(self) -> Ready:
        """Weights for a rollout; gradients pass."""
        order = [*range(2 * UNITS), *range(3 * UNITS, 4 * UNITS), *range(2 * UNITS, 3 * UNITS)]
        scaled = self.w_in / self.scale
        bias = self.bias - scaled @ self.mean
        inputs, hidden = scaled[order], self.w_rec[order]
        both = torch.cat([inputs, hidden], dim=1)
        return Ready(
            inputs, hidden, both, bias[order].unsqueeze(1), self.w_out, self.b_out.unsqueeze(1), self.bound.unsqueeze(1)
        )

    def turn(self, gates: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """(hidden, memory) after a step, each [H, B], from the sums of the gates [4H, B] in the order of Ready."""
        opened = torch.sigmoid(gates[: 3 * UNITS])
        shape = torch.relu if self.relu else torch.tanh
        memory = opened[UNITS : 2 * UNITS] * memory + opened[:UNITS] * shape(gates[3 * UNITS :])
        return opened[2 * UNITS :] * shape(memory), memory

    def over(self, ready: Ready, features: Tensor) -> tuple[Tensor, Tensor]:
        """(hidden, memory) [H, B] after known features [T, I, B], from 0."""
        sums = ready.inputs @ features + ready.bias
        hidden = torch.zeros(UNITS, features.shape[2], dtype=features.dtype)
        memory = hidden
        for row in sums.unbind(0):
            hidden, memory = self.turn(torch.addmm(row, ready.hidden, hidden), memory)
        return hidden, memory

    def arrays(self) -> dict[str, Array]:
        """The arrays of plant.npz."""
        return {name: value.detach().numpy().copy() for name, value in self.state_dict().items()}


def put_out(ready: Ready, hidden: Tensor) -> Tensor:
    """The two outputs [2, B], bounded."""
    return ready.bound * torch.tanh(torch.addmm(ready.out_bias, ready.out, hidden))


class LayerNet(nn.Module):
    """One hidden layer of tanh and two bounded outputs; parameters and buffers named as in plant.npz."""

    mean: Tensor
    scale: Tensor
    bound: Tensor

    def __init__(self, mean: Array, scale: Array, bound: Sequence[float], seed: int) -> None:
        super().__init__()
        draw = torch.Generator().manual_seed(seed)

        def drawn(*shape: int) -> nn.Parameter:
            spread = math.sqrt(6.0 / sum(shape))
            return nn.Parameter((torch.rand(*shape, generator=draw, dtype=torch.float64) * 2.0 - 1.0) * spread)

        self.w1, self.w2 = drawn(HIDDEN, len(mean)), drawn(2, HIDDEN)
        self.b1 = nn.Parameter(torch.zeros(HIDDEN, dtype=torch.float64))
        self.b2 = nn.Parameter(torch.zeros(2, dtype=torch.float64))
        for name, values in (("mean", mean), ("scale", scale), ("bound", bound)):
            self.register_buffer(name, torch.as_tensor(values, dtype=torch.float64))

    def forward(self, features: Tensor) -> Tensor:
        """Outputs [2, B] for features [I, B]."""
        taken = (features - self.mean.unsqueeze(1)) / self.scale.unsqueeze(1)
        hidden = torch.tanh(torch.addmm(self.b1.unsqueeze(1), self.w1, taken))
        return self.bound.unsqueeze(1) * torch.tanh(torch.addmm(self.b2.unsqueeze(1), self.w2, hidden))

    def arrays(self) -> dict[str, Array]:
        """The arrays of plant.npz."""
        return {name: value.detach().numpy().copy() for name, value in self.state_dict().items()}
