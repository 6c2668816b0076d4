"""One step of an LSTM cell, and of a layer of tanh, as kernels (docs/reference/design.md): the ECU and the batch run
these.

tanh is a rational function of our own (the 13/6 form with its clamp, opt_anchors C.2), in float64 within 2e-7 of the
real one; the sigmoid is made of it. Loops are explicit and sums run in one order, so plain Python and compiled code
give the same bits. Weights are data: nothing is compiled for another model folder.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.kernel import buffer, kernel, table

CLAMP = 7.90531110763549805  # where the rational function reaches 1
N1, N3, N5, N7 = 4.89352455891786e-03, 6.37261928875436e-04, 1.48572235717979e-05, 5.12229709037114e-08
N9, N11, N13 = -8.60467152213735e-11, 2.00018790482477e-13, -2.76076847742355e-16
D0, D2, D4, D6 = 4.89352518554385e-03, 2.26843463243900e-03, 1.18534705686654e-04, 1.19825839466702e-06


class Cell(NamedTuple):
    """Weights of a cell of H units on I inputs, and its linear way out.

    weights: rows of I + H + 1 numbers (inputs, hidden, bias), row by row, in the order input gate, forget gate,
    candidate, output gate. out: a row of H + 1 numbers (hidden, bias) for each output. An input is taken as
    (value - mean) * inverse_scale.
    """

    mean: Any
    inverse_scale: Any
    weights: Any
    out: Any
    bound: Any


class CellState(NamedTuple):
    """seen: I inputs as taken, then H hidden values; memory: H; sums: 4 H, for use within a step."""

    seen: Any
    memory: Any
    sums: Any


class Layer(NamedTuple):
    """Weights of one hidden layer of H units: rows of I + 1 in `weights`, rows of H + 1 in `out`; the rest as Cell."""

    mean: Any
    inverse_scale: Any
    weights: Any
    out: Any
    bound: Any


class LayerState(NamedTuple):
    """For use within a step. seen: I inputs as taken; hidden: H."""

    seen: Any
    hidden: Any


@kernel
def rational_tanh(x: float) -> float:
    """tanh(x), within 2e-7, odd to the bit, never beyond 1."""
    if x > CLAMP:
        return 1.0
    if x < -CLAMP:
        return -1.0
    s = x * x
    top = x * (N1 + s * (N3 + s * (N5 + s * (N7 + s * (N9 + s * (N11 + s * N13))))))
    value = top / (D0 + s * (D2 + s * (D4 + s * D6)))  # not 0: positive coefficients, s not below 0
    if value > 1.0:
        return 1.0
    if value < -1.0:
        return -1.0
    return value


@kernel
def sigmoid(x: float) -> float:
    """1 / (1 + exp(-x)), by rational_tanh."""
    return 0.5 * rational_tanh(0.5 * x) + 0.5


@kernel
def take_in(net: Any, seen: Any, index: int, value: float) -> None:
    """Put input number `at` of a cell or a layer where its next step looks for it."""
    seen[index] = (value - net.mean[index]) * net.inverse_scale[index]


@kernel
def step_cell(net: Cell, state: CellState, relu: bool) -> None:
    """One step on the inputs in state.seen; hidden and memory are renewed where they are.

    relu: the rectifier takes the place of tanh, for candidate and output (an LSTM layer with activation 'relu').
    """
    seen, memory, sums, weights = state.seen, state.memory, state.sums, net.weights
    width, taken = len(memory), len(seen)
    first, offset = taken - width, 0
    for row in range(4 * width):
        total = float(weights[offset + taken])
        for i in range(taken):
            total = total + weights[offset + i] * seen[i]
        sums[row] = total
        offset = offset + taken + 1
    for j in range(width):
        candidate, keep = sums[2 * width + j], sigmoid(sums[width + j])
        if relu:
            candidate = candidate if candidate > 0.0 else 0.0
        else:
            candidate = rational_tanh(candidate)
        cell_value = keep * memory[j] + sigmoid(sums[j]) * candidate
        memory[j] = cell_value
        if relu:
            shown = cell_value if cell_value > 0.0 else 0.0
        else:
            shown = rational_tanh(cell_value)
        seen[first + j] = sigmoid(sums[3 * width + j]) * shown


@kernel
def cell_out(net: Cell, state: CellState, row: int) -> float:
    """Linear output number `row` of what the cell shows."""
    width = len(state.memory)
    first, offset = len(state.seen) - width, row * (width + 1)
    total = float(net.out[offset + width])
    for j in range(width):
        total = total + net.out[offset + j] * state.seen[first + j]
    return total


@kernel
def clear_cell(state: CellState) -> None:
    """Hidden values and memory 0, as before the first step."""
    width = len(state.memory)
    first = len(state.seen) - width
    for j in range(width):
        state.memory[j] = 0.0
        state.seen[first + j] = 0.0


@kernel
def step_layer(net: Layer, state: LayerState) -> None:
    """The hidden layer of tanh on the inputs in state.seen."""
    seen, hidden, weights = state.seen, state.hidden, net.weights
    taken, offset = len(seen), 0
    for j in range(len(hidden)):
        total = float(weights[offset + taken])
        for i in range(taken):
            total = total + weights[offset + i] * seen[i]
        hidden[j] = rational_tanh(total)
        offset = offset + taken + 1


@kernel
def layer_out(net: Layer, state: LayerState, row: int) -> float:
    """Linear output number `row` of the hidden layer."""
    width = len(state.hidden)
    offset = row * (width + 1)
    total = float(net.out[offset + width])
    for j in range(width):
        total = total + net.out[offset + j] * state.hidden[j]
    return total


@kernel
def bounded(net: Any, row: int, value: float) -> float:
    """bound * tanh: never beyond the bound of output number `row`, 0 for 0."""
    return float(net.bound[row]) * rational_tanh(value)


def init_cell(net: Cell) -> CellState:
    """Hidden values and memory 0."""
    width = len(net.out) // len(net.bound) - 1
    return CellState(buffer(len(net.mean) + width), buffer(width), buffer(4 * width))


def init_layer(net: Layer) -> LayerState:
    """Room for a step."""
    return LayerState(buffer(len(net.mean)), buffer(len(net.out) // len(net.bound) - 1))


def rows(*blocks: Sequence[Sequence[float]]) -> Any:
    """Blocks of equally many rows, side by side, as one table; a block's rows are sequences."""
    return table(float(value) for parts in zip(*blocks, strict=True) for part in parts for value in part)
