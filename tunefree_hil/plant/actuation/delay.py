"""A delay by whole ticks, for any record: the bench's report and command delay in lockstep
(docs/reference/bench_channel.md)."""

from __future__ import annotations

from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block, kernel


def delay(n_ticks: int, initial: Any) -> Block:
    """Block whose output is its input `n_ticks` steps ago, `initial` before that; 0 ticks is the identity.

    Works for a float, a record of floats or records of records (a tuple (Measurement, ByWireStatus) too), whose
    types must be those of `initial`. The state is a row of records, oldest first, and never changed in place.
    """
    if n_ticks < 0:
        raise InputError(f"a delay of {n_ticks} ticks", code="bad_delay", key="timing", hint="0 or more ticks")
    return Block(init_delay(n_ticks), step_delay(n_ticks), initial)


def init_delay(n_ticks: int) -> Any:
    """init of a delay whose params are the initial record."""

    def init(params: Any, dt_s: float) -> Any:
        return (params,) * n_ticks

    return init


def step_delay(n_ticks: int) -> Any:
    """step of a delay over a row of `n_ticks` records."""
    if n_ticks == 0:

        @kernel
        def step_none(params: Any, state: Any, x: Any, dt_s: float) -> tuple[Any, Any]:
            return state, x

        return step_none

    @kernel
    def step(params: Any, state: Any, x: Any, dt_s: float) -> tuple[Any, Any]:
        return state[1:] + (x,), state[0]

    return step
