"""Effects of one port in series, compiled once and switched by their params; and what report effects do to outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Latency, Port
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block, kernel, series
from tunefree_hil.base.records import Report

Array = np.ndarray
ChannelTriple = tuple[Any, Any, Any]  # of throttle, brake, steer

# Ports of throttle, brake, steer: before the actuator, on its output, after the report
PORTS_A = (Port.THROTTLE_A, Port.BRAKE_A, Port.STEER_A)
PORTS_OUT = (Port.THROTTLE_OUT, Port.BRAKE_OUT, Port.STEER_OUT)
PORTS_B = (Port.THROTTLE_B, Port.BRAKE_B, Port.STEER_B)
SCALAR_PORTS = (*PORTS_A, *PORTS_OUT, *PORTS_B)


@kernel
def _pass_through(params: float, state: float, x: Any, dt_s: float) -> tuple[float, Any]:
    return state, x


def _identity_block() -> Block:
    return Block(lambda params, dt_s: 0.0, _pass_through, 0.0)


class EffectChain(NamedTuple):
    """The effects of a port in series. names: in their order; block: its step is compiled once."""

    names: tuple[str, ...]
    block: Block

    def params(self, blocks: Mapping[str, Block]) -> Any:
        """Params for the chain's step, from the Blocks of its effects by name."""
        return _nest_pairs([blocks[name].params for name in self.names])

    def state(self, blocks: Mapping[str, Block], dt_s: float) -> Any:
        """The initial state of the chain."""
        return _nest_pairs([blocks[name].init(blocks[name].params, dt_s) for name in self.names])


def _nest_pairs(items: Sequence[Any]) -> Any:
    """((a, b), c), as `series` nests its params; 0.0 for no items."""
    if not items:
        return 0.0
    nested = items[0]
    for item in items[1:]:
        nested = (nested, item)
    return nested


def chain_effects(names: Sequence[str], blocks: Mapping[str, Block]) -> EffectChain:
    """The Blocks of these names in series; the identity where there are none."""
    if not names:
        return EffectChain((), _identity_block())
    chain = blocks[names[0]]
    for name in names[1:]:
        chain = series(chain, blocks[name])
    return EffectChain(tuple(names), chain)


def join_channel_chains(
    chains: Mapping[Port, EffectChain], ports: tuple[Port, Port, Port], blocks: Mapping[str, Block], dt_s: float
) -> tuple[ChannelTriple, ChannelTriple]:
    """Params and initial states of the effects on three channels."""
    throttle, brake, steer = (chains[port] for port in ports)
    params = (throttle.params(blocks), brake.params(blocks), steer.params(blocks))
    return params, (throttle.state(blocks, dt_s), brake.state(blocks, dt_s), steer.state(blocks, dt_s))


NOT_AFFINE = "it changes a reported output by more than a factor and an offset, so the output is not known"
PROBE_TICKS = 3  # with the same report
AFFINE_TOLERANCE = 1e-9  # of an output of 1: rounding


class OutputMap(NamedTuple):
    """What is reported of an output y: gain * y + shift; each (3,), of throttle, brake, steer."""

    gain: Array
    shift: Array


def identify_output_map(block: Block, dt_s: float) -> OutputMap:
    """What an effect on the report makes of the outputs; a delay changes none.

    Raises:
        InputError: the map is not affine, or constant.
    """
    if isinstance(block.params, Latency):
        return OutputMap(np.ones(3), np.zeros(3))
    at_minus_one, at_one, at_two = (_probe_outputs(block, value, dt_s) for value in (-1.0, 1.0, 2.0))
    gain = at_two - at_one
    gain[np.abs(gain - 1.0) < AFFINE_TOLERANCE] = 1.0
    if (np.abs(at_one - at_minus_one - 2.0 * gain) > AFFINE_TOLERANCE).any() or (gain == 0.0).any():
        raise _not_affine()
    return OutputMap(gain, at_one - gain)


def _probe_outputs(block: Block, value: float, dt_s: float) -> Array:
    """The outputs, (3,), in the report that an effect makes of one whose fields are all `value`.

    Raises:
        InputError: a later tick gives something else, so the effect has a memory of the outputs.
    """
    step = getattr(block.step, "py_func", block.step)  # a few steps are not worth compiling
    state, report = block.init(block.params, dt_s), Report(*(value,) * len(Report._fields))
    outputs = list[Array]()
    for _ in range(PROBE_TICKS):
        state, changed = step(block.params, state, report, dt_s)
        outputs.append(np.array([changed.throttle_frac, changed.brake_frac, changed.steer_rad]))
    if np.ptp(outputs, axis=0).max() > AFFINE_TOLERANCE:
        raise _not_affine()
    return outputs[0]


def _not_affine() -> InputError:
    return InputError(NOT_AFFINE, code="no_line", hint="an effect on a report may scale an output and add to it")


def undo_output_maps(outputs: Array, maps: Sequence[OutputMap]) -> Array:
    """Outputs, (n_rows, 3), before the effects with these maps changed them, in this order."""
    for output_map in reversed(maps):
        outputs = (outputs - output_map.shift) / output_map.gain
    return outputs
