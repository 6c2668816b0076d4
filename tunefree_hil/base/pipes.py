"""Messages between a process and a helper that it started, over the helper's standard input and output.

A message is its length (8 bytes, little-endian) and a pickle: both ends are the same program on one machine.
"""

from __future__ import annotations

import os
import pickle
import queue
import sys
import threading
from typing import Any, BinaryIO, cast

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


def serve() -> tuple[queue.SimpleQueue[Any], BinaryIO]:
    """(requests as they come, where answers go) of a helper; from now on it ends at once when its parent does."""
    # Unbuffered: the listening thread then holds no lock that the end of this process would wait for.
    requests = cast(BinaryIO, os.fdopen(os.dup(sys.stdin.fileno()), "rb", buffering=0))
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what anybody prints must not disturb the answers
    todo: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(requests, todo), daemon=True).start()
    return todo, answers


def _listen(pipe: BinaryIO, todo: queue.SimpleQueue[Any]) -> None:
    """Hand on requests; the parent's end is ours, whatever is being worked on."""
    while True:
        try:
            todo.put(receive(pipe))
        except EOFError:
            os._exit(0)


def _exactly(pipe: BinaryIO, size: int) -> bytes:
    data = bytearray()
    while len(data) < size:
        part = pipe.read(size - len(data))
        if not part:
            raise EOFError
        data += part
    return bytes(data)
