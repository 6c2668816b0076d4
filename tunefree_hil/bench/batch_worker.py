"""The process behind a Batch: drives what it is asked to over its standard input, answers over its standard output.

It is started with TUNEFREE_JIT=batch and ends at once when its input ends, which is when its parent does, however.
A message is its length (8 bytes, little-endian) and a pickle: parent and child are the same program on one machine.
"""

from __future__ import annotations

import os
import pickle
import queue
import sys
import threading
from typing import Any, BinaryIO, cast

from tunefree_hil.base.errors import TunefreeError
from tunefree_hil.bench.fleet import Fleet
from tunefree_hil.bench.load import Bench
from tunefree_hil.bus.codec import Codec

LENGTH_BYTES = 8


def send(pipe: BinaryIO, message: Any) -> None:
    """Write a message."""
    data = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
    pipe.write(len(data).to_bytes(LENGTH_BYTES, "little") + data)
    pipe.flush()


def receive(pipe: BinaryIO) -> Any:
    """Read a message. Raises EOFError where the other side is gone."""
    size = int.from_bytes(_exactly(pipe, LENGTH_BYTES), "little")
    return pickle.loads(_exactly(pipe, size))  # from our own parent or child only


def _exactly(pipe: BinaryIO, size: int) -> bytes:
    data = bytearray()
    while len(data) < size:
        part = pipe.read(size - len(data))
        if not part:
            raise EOFError
        data += part
    return bytes(data)


def packed(bench: Bench) -> tuple[Any, ...]:
    """What a bench is made of; its courses are built again, for a batch's tables are arrays."""
    return (bench.spec, bench.vehicle, bench.weights, dict(bench.scenarios), bench.dt_s)


def unpacked(pack: tuple[Any, ...]) -> Bench:
    """The bench again."""
    spec, vehicle, weights, scenarios, dt_s = pack
    return Bench(spec, vehicle, Codec(vehicle), weights, scenarios, dt_s)


def main() -> None:
    """Serve until the input ends."""
    # Unbuffered: the listening thread then holds no lock that the end of this process would wait for.
    requests = cast(BinaryIO, os.fdopen(os.dup(sys.stdin.fileno()), "rb", buffering=0))
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what anybody prints must not disturb the answers
    todo: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(requests, todo), daemon=True).start()
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


def _listen(pipe: BinaryIO, todo: queue.SimpleQueue[Any]) -> None:
    """Hand on requests; the parent's end is ours, whatever is being driven."""
    while True:
        try:
            todo.put(receive(pipe))
        except EOFError:
            os._exit(0)


if __name__ == "__main__":
    main()
