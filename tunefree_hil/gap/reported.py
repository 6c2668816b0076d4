"""What effects on a report make of the outputs in it, so that a measured output can be put back to what it was."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Latency
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.records import Report

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
