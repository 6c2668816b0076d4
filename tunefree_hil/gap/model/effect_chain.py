"""The effects of one port in series: compiled once, on or off by their params alone.

What effects on a report make of the outputs in it, so that a measured output can be put back to what it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Latency, Port
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block, kernel, series
from tunefree_hil.base.records import Report

Three = tuple[Any, Any, Any]

# Of throttle, brake, steer: before the actuator, on its output, behind the report
PORTS_A = (Port.THROTTLE_A, Port.BRAKE_A, Port.STEER_A)
PORTS_OUT = (Port.THROTTLE_OUT, Port.BRAKE_OUT, Port.STEER_OUT)
PORTS_B = (Port.THROTTLE_B, Port.BRAKE_B, Port.STEER_B)
SCALAR_PORTS = (*PORTS_A, *PORTS_OUT, *PORTS_B)


@kernel
def _same(params: float, state: float, x: Any, dt_s: float) -> tuple[float, Any]:
    return state, x


def _nothing() -> Block:
    return Block(lambda params, dt_s: 0.0, _same, 0.0)


class Chain(NamedTuple):
    """The effects of a port in series: their steps compiled once, params and states laid out for them by name."""

    names: tuple[str, ...]
    block: Block

    def params(self, blocks: Mapping[str, Block]) -> Any:
        """Params for the chain's step, each effect's from its Block."""
        return _nested([blocks[name].params for name in self.names])

    def state(self, blocks: Mapping[str, Block], dt_s: float) -> Any:
        """The state that the chain starts with."""
        return _nested([blocks[name].init(blocks[name].params, dt_s) for name in self.names])


def _nested(some: Sequence[Any]) -> Any:
    """As `series` nests: ((a, b), c)."""
    if not some:
        return 0.0
    whole = some[0]
    for one in some[1:]:
        whole = (whole, one)
    return whole


def chain_of(names: Sequence[str], blocks: Mapping[str, Block]) -> Chain:
    """Blocks of these names one behind the other; with no name a chain that does nothing."""
    if not names:
        return Chain((), _nothing())
    whole = blocks[names[0]]
    for name in names[1:]:
        whole = series(whole, blocks[name])
    return Chain(tuple(names), whole)


def three_of(
    chains: Mapping[Port, Chain], ports: tuple[Port, Port, Port], blocks: Mapping[str, Block], dt_s: float
) -> tuple[Three, Three]:
    """(params, states) of the effects on three channels."""
    one, two, three = (chains[port] for port in ports)
    params = (one.params(blocks), two.params(blocks), three.params(blocks))
    return params, (one.state(blocks, dt_s), two.state(blocks, dt_s), three.state(blocks, dt_s))


Array = np.ndarray

NO_LINE = "what it makes of a reported output is neither a factor nor an amount, so that the output is not known"
TICKS = 3  # that the same report is said
EXACT = 1e-9  # of an output of 1: what a sum in binary leaves of a factor


class Said(NamedTuple):
    """Of the three outputs y (throttle, brake, steer), each [3]: gain * y + shift is reported."""

    gain: Array
    shift: Array


def said_of(block: Block, dt_s: float) -> Said:
    """Of an effect on the report; a delay changes no output. Raises InputError where that is no straight line, and
    where it is the same whatever they are.
    """
    if isinstance(block.params, Latency):
        return Said(np.ones(3), np.zeros(3))
    below, one, two = (_outputs_of(block, value, dt_s) for value in (-1.0, 1.0, 2.0))
    gain = two - one
    gain[np.abs(gain - 1.0) < EXACT] = 1.0
    if (np.abs(one - below - 2.0 * gain) > EXACT).any() or (gain == 0.0).any():
        raise InputError(NO_LINE, code="no_line", hint="an effect on a report may scale an output and add to it")
    return Said(gain, one - gain)


def _outputs_of(block: Block, value: float, dt_s: float) -> Array:
    """Throttle, brake, steer [3] that an effect makes of a report in which every field is `value`. Raises InputError
    for one that makes something else of it a tick later: it has a memory of the outputs.
    """
    step = getattr(block.step, "py_func", block.step)  # a few steps are not worth compiling
    state, same, found = block.init(block.params, dt_s), Report(*(value,) * len(Report._fields)), list[Array]()
    for _ in range(TICKS):
        state, said = step(block.params, state, same, dt_s)
        found.append(np.array([said.throttle_frac, said.brake_frac, said.steer_rad]))
    if np.ptp(found, axis=0).max() > EXACT:
        raise InputError(NO_LINE, code="no_line", hint="an effect on a report may scale an output and add to it")
    return found[0]


def undone(outputs: Array, series: Sequence[Said]) -> Array:
    """Reported outputs [n, 3] as they were before effects in this order touched them."""
    for said in reversed(series):
        outputs = (outputs - said.shift) / said.gain
    return outputs
