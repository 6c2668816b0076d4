"""The cell's kernels against NumPy and the real tanh."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.plant.model_files import NETS, arrays_of
from tunefree_hil.plant.learned.lstm_cell import (
    bounded,
    cell_out,
    clear_cell,
    init_cell,
    init_layer,
    layer_out,
    put_input,
    rational_tanh,
    sigmoid,
    step_cell,
    step_layer,
)
from tunefree_hil.plant.learned.weights_file import INPUTS, PlantFile, cell_of, layer_of

Array = np.ndarray


def logistic(x: Array) -> Array:
    return 0.5 * (1.0 + np.tanh(0.5 * x))


def by_numpy(a: dict[str, Array], inputs: Array, relu: bool) -> Array:
    """The linear outputs, step by step, of the textbook's cell."""
    width = len(a["bias"]) // 4
    hidden, memory = np.zeros(width), np.zeros(width)
    squash = (lambda x: np.maximum(x, 0.0)) if relu else np.tanh
    outputs = []
    for x in (inputs - a["mean"]) / a["scale"]:
        gates = a["w_in"] @ x + a["w_rec"] @ hidden + a["bias"]
        i, f, g, o = gates.reshape(4, width)
        memory = logistic(f) * memory + logistic(i) * squash(g)
        hidden = logistic(o) * squash(memory)
        outputs.append(a["w_out"] @ hidden + a["b_out"])
    return np.array(outputs)


def ours(kind: str, a: dict[str, Array], inputs: Array, relu: bool) -> Array:
    net = cell_of(PlantFile(kind, INPUTS[kind], a))
    state = init_cell(net)
    outputs = []
    for x in inputs.tolist():
        for i, value in enumerate(x):
            put_input(net, state.inputs, i, value)
        step_cell(net, state, relu)
        outputs.append([cell_out(net, state, 0), cell_out(net, state, 1)])
    return np.array(outputs)


@given(st.floats(-30.0, 30.0))
def test_tanh_is_tanh(x: float) -> None:
    assert rational_tanh(x) == pytest.approx(math.tanh(x), abs=2e-7)
    assert rational_tanh(-x) == -rational_tanh(x)
    assert abs(rational_tanh(x)) <= 1.0
    assert sigmoid(x) == pytest.approx(1.0 / (1.0 + math.exp(-x)), abs=2e-7)


def test_tanh_at_its_ends() -> None:
    assert rational_tanh(0.0) == 0.0 and rational_tanh(math.inf) == 1.0 and rational_tanh(-math.inf) == -1.0
    assert math.isnan(rational_tanh(math.nan)), "what is not a number does not become one"
    at = np.linspace(-7.9, 7.9, 4001)
    values = np.array([rational_tanh(float(x)) for x in at])
    assert np.all(np.diff(values) > -1e-7), "it does not turn round"


@pytest.mark.parametrize("relu", [False, True])
@pytest.mark.parametrize("width", [1, 3, 8])
@pytest.mark.parametrize("kind", [kind for kind in NETS if kind != "mlp"])
def test_the_cell_is_the_textbooks(kind: str, width: int, relu: bool) -> None:
    a = arrays_of(kind, seed=10 + width, width=width)
    chance = np.random.default_rng(5)
    steps = 20 if relu else 300  # a rectifier has no bound
    inputs = a["mean"] + a["scale"] * chance.standard_normal((steps, len(a["mean"])))
    expected = by_numpy(a, inputs, relu)
    assert np.abs(ours(kind, a, inputs, relu) - expected).max() < 1e-5
    assert np.ptp(expected[:, 0]) > 0.02, "the case moves"


def test_the_layer_is_the_textbooks() -> None:
    a = arrays_of("mlp", width=10)
    net = layer_of(PlantFile("mlp", INPUTS["mlp"], a))
    state = init_layer(net)
    for x in (a["mean"] + a["scale"] * np.random.default_rng(2).standard_normal((50, len(a["mean"])))).tolist():
        for i, value in enumerate(x):
            put_input(net, state.inputs, i, value)
        step_layer(net, state)
        hidden = np.tanh(a["w1"] @ ((np.array(x) - a["mean"]) / a["scale"]) + a["b1"])
        expected = a["w2"] @ hidden + a["b2"]
        assert [layer_out(net, state, 0), layer_out(net, state, 1)] == pytest.approx(expected.tolist(), abs=2e-6)


def test_a_cleared_cell_is_a_new_one() -> None:
    a = arrays_of("lstm")
    net = cell_of(PlantFile("lstm", INPUTS["lstm"], a))
    used, new = init_cell(net), init_cell(net)
    step_cell(net, used, False)
    assert list(used.memory) != list(new.memory)
    clear_cell(used)
    assert list(used.memory) == list(new.memory) and list(used.inputs) == list(new.inputs)


@given(st.floats(-1e6, 1e6), st.integers(0, 1))
def test_nothing_goes_beyond_its_bound(value: float, row: int) -> None:
    net = cell_of(PlantFile("hybrid", INPUTS["hybrid"], arrays_of("hybrid")))
    assert abs(bounded(net, row, value)) <= net.bound[row]
    assert bounded(net, row, 0.0) == 0.0
