"""The process of a Batch: it reads requests from its standard input and writes results to its standard output.

It runs with TUNEFREE_JIT=batch and ends when its input is closed, which is also when its parent ends.
The messages are those of base/pipes.py.
"""

from __future__ import annotations

from typing import Any

from tunefree_hil.base.errors import TunefreeError
from tunefree_hil.base.pipes import send, serve
from tunefree_hil.bench.load import Bench
from tunefree_hil.bench.parallel import Fleet
from tunefree_hil.bus.dbc.codec import Codec


def packed(bench: Bench) -> tuple[Any, ...]:
    """Parts of a bench; its courses are built again, as tables of a batch are arrays."""
    return (bench.spec, bench.vehicle, bench.weights, dict(bench.scenarios), bench.dt_s)


def unpacked(pack: tuple[Any, ...]) -> Bench:
    """Build the bench."""
    spec, vehicle, weights, scenarios, dt_s = pack
    return Bench(spec, vehicle, Codec(vehicle), weights, scenarios, dt_s)


def main() -> None:
    """Serve until the input ends."""
    todo, answers = serve()
    fleet: Fleet | None = None
    while True:
        message = todo.get()
        try:
            if fleet is None:
                pack, model, extra_effects, threads = message
                fleet = Fleet(unpacked(pack), model, extra_effects, threads)
                send(answers, None)
            else:
                jobs, columns = message
                send(answers, fleet.drive(jobs, columns=columns))
        except TunefreeError as error:
            send(answers, error)


if __name__ == "__main__":
    main()
