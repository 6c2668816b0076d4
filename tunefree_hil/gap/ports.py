"""The effects of one port in series: compiled once, on or off by their params alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Port
from tunefree_hil.base.kernel import Block, kernel, series

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
