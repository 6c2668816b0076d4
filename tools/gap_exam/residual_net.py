"""A plain LSTM that learns what a simulation misses, without a name: `python residual_net.py IN OUT`.

IN (npz): x [blocks, steps, features] and y [blocks, steps, signals]; use [blocks]: 0 to learn from, 1 to judge by;
summed [signals]: those of which the network says the rate; and further x by name. OUT: what is said to each of these. A
process of its own: torch is loaded nowhere else.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

HIDDEN, EPOCHS, RATE, PATIENCE = 48, 300, 5e-3, 60
Array = np.ndarray


class Net:
    """An LSTM and a linear layer that begins with nothing."""

    def __init__(self, torch: Any, features: int, summed: Array) -> None:
        self.torch, self.summed = torch, torch.tensor(summed)
        self.cell = torch.nn.LSTM(features, HIDDEN, batch_first=True)
        self.head = torch.nn.Linear(HIDDEN, len(summed))
        torch.nn.init.zeros_(self.head.weight)
        torch.nn.init.zeros_(self.head.bias)
        self.weights = [*self.cell.parameters(), *self.head.parameters()]

    def __call__(self, x: Any) -> Any:
        """Outputs [blocks, steps, signals]; a rate is summed up from the block's start."""
        said = self.head(self.cell(x)[0])
        return self.torch.where(self.summed, said.cumsum(dim=1) / said.shape[1], said)


def fitted(x: Array, y: Array, use: Array, summed: Array, others: dict[str, Array]) -> dict[str, Array]:
    """Outputs for every array of `others` by the network that did best on the blocks to judge by."""
    import torch

    torch.manual_seed(1)
    torch.set_num_threads(1)
    learn, judge = use == 0, use == 1
    mean, spread = x[learn].mean(axis=(0, 1)), x[learn].std(axis=(0, 1)) + 1e-9
    size = np.sqrt((y[learn] ** 2).mean(axis=(0, 1))) + 1e-9
    net = Net(torch, x.shape[2], summed)

    def inputs(some: Array) -> Any:
        return torch.tensor((some - mean) / spread, dtype=torch.float32)

    share = torch.tensor(size / np.sqrt((size**2).mean()), dtype=torch.float32)  # what counts more is learned first

    def error_of(rows: Array) -> Any:
        at, wanted = inputs(x[rows]), torch.tensor(y[rows] / size, dtype=torch.float32)
        return lambda: (((net(at) - wanted) * share) ** 2).mean()

    _descend(torch, net, error_of(learn), error_of(judge))
    with torch.no_grad():
        return {name: net(inputs(some)).numpy() * size for name, some in others.items()}


def _descend(torch: Any, net: Net, error: Any, judged: Any) -> None:
    adam = torch.optim.Adam(net.weights, RATE)
    slower = torch.optim.lr_scheduler.CosineAnnealingLR(adam, EPOCHS)
    best, since = (np.inf, [one.detach().clone() for one in net.weights]), 0
    for _ in range(EPOCHS):
        adam.zero_grad()
        error().backward()
        torch.nn.utils.clip_grad_norm_(net.weights, 1.0)
        adam.step()
        slower.step()
        with torch.no_grad():
            now = float(judged())
        since += 1
        if now < best[0]:
            best, since = (now, [one.detach().clone() for one in net.weights]), 0
        if since > PATIENCE:
            break
    with torch.no_grad():
        for one, kept in zip(net.weights, best[1], strict=True):
            one.copy_(kept)


def main(source: str, target: str) -> None:
    """Read, fit, write."""
    with np.load(source) as data:
        arrays = dict(data)
    learned = [arrays.pop(name) for name in ("x", "y", "use", "summed")]
    np.savez(target, **fitted(*learned, arrays))  # type: ignore[arg-type]


if __name__ == "__main__":
    main(*sys.argv[1:])
