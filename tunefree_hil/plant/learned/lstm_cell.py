"""One step of an LSTM cell, and of a layer of tanh, as kernels for the ECU and the batch.

tanh is a rational function (degrees 13 and 6, with a clamp), in float64 within 2e-7 of the exact one; the sigmoid is
computed from it. Loops are explicit and sums have a fixed order, so plain Python and compiled code give the same bits.
Weights are data: another model folder needs no compilation.
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
    """Weights of a cell of H units on I inputs, and its linear output.

    weights: rows of I + H + 1 numbers (inputs, hidden, bias), row by row, in the order input gate, forget gate,
    candidate, output gate. out: a row of H + 1 numbers (hidden, bias) for each output. An input is scaled as
    (value - mean) * inverse_scale.
    """

    mean: Any
    inverse_scale: Any
    weights: Any
    out: Any
    bound: Any


class CellState(NamedTuple):
    """inputs: I scaled inputs, then H hidden values; memory: H; sums: 4 H, used within a step."""

    inputs: Any
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
    """Buffers used within a step. inputs: I scaled inputs; hidden: H."""

    inputs: Any
    hidden: Any


@kernel
def rational_tanh(x: float) -> float:
    """tanh(x) within 2e-7, exactly odd, never beyond 1."""
    if x > CLAMP:
        return 1.0
    if x < -CLAMP:
        return -1.0
    s = x * x
    numerator = x * (N1 + s * (N3 + s * (N5 + s * (N7 + s * (N9 + s * (N11 + s * N13))))))
    value = numerator / (D0 + s * (D2 + s * (D4 + s * D6)))  # not 0: positive coefficients, s not below 0
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
def put_input(net: Any, inputs: Any, index: int, value: float) -> None:
    """Set the scaled input `index` of a cell or a layer for its next step."""
    inputs[index] = (value - net.mean[index]) * net.inverse_scale[index]


@kernel
def step_cell(net: Cell, state: CellState, relu: bool) -> None:
    """One step on state.inputs; hidden and memory are updated in place.

    relu: the rectifier instead of tanh, for candidate and output (an LSTM layer with activation 'relu').
    """
    inputs, memory, sums, weights = state.inputs, state.memory, state.sums, net.weights
    width, n_values = len(memory), len(inputs)
    first, offset = n_values - width, 0
    for row in range(4 * width):
        total = float(weights[offset + n_values])
        for i in range(n_values):
            total = total + weights[offset + i] * inputs[i]
        sums[row] = total
        offset = offset + n_values + 1
    for j in range(width):
        candidate, forget = sums[2 * width + j], sigmoid(sums[width + j])
        if relu:
            candidate = candidate if candidate > 0.0 else 0.0
        else:
            candidate = rational_tanh(candidate)
        cell_value = forget * memory[j] + sigmoid(sums[j]) * candidate
        memory[j] = cell_value
        if relu:
            output = cell_value if cell_value > 0.0 else 0.0
        else:
            output = rational_tanh(cell_value)
        inputs[first + j] = sigmoid(sums[3 * width + j]) * output


@kernel
def cell_out(net: Cell, state: CellState, row: int) -> float:
    """Linear output number `row` of the cell."""
    width = len(state.memory)
    first, offset = len(state.inputs) - width, row * (width + 1)
    total = float(net.out[offset + width])
    for j in range(width):
        total = total + net.out[offset + j] * state.inputs[first + j]
    return total


@kernel
def clear_cell(state: CellState) -> None:
    """Hidden values and memory 0, as before the first step."""
    width = len(state.memory)
    first = len(state.inputs) - width
    for j in range(width):
        state.memory[j] = 0.0
        state.inputs[first + j] = 0.0


@kernel
def step_layer(net: Layer, state: LayerState) -> None:
    """The hidden layer of tanh on the inputs in state.inputs."""
    inputs, hidden, weights = state.inputs, state.hidden, net.weights
    n_values, offset = len(inputs), 0
    for j in range(len(hidden)):
        total = float(weights[offset + n_values])
        for i in range(n_values):
            total = total + weights[offset + i] * inputs[i]
        hidden[j] = rational_tanh(total)
        offset = offset + n_values + 1


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
    """bound * tanh: within the bound of output number `row`, 0 for 0."""
    return float(net.bound[row]) * rational_tanh(value)


def init_cell(net: Cell) -> CellState:
    """Hidden values and memory 0."""
    width = len(net.out) // len(net.bound) - 1
    return CellState(buffer(len(net.mean) + width), buffer(width), buffer(4 * width))


def init_layer(net: Layer) -> LayerState:
    """The buffers for a step."""
    return LayerState(buffer(len(net.mean)), buffer(len(net.out) // len(net.bound) - 1))


def rows(*blocks: Sequence[Sequence[float]]) -> Any:
    """Blocks of equally many rows, side by side, as one table; a block's rows are sequences."""
    return table(float(value) for parts in zip(*blocks, strict=True) for part in parts for value in part)
