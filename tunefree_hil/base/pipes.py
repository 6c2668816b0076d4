"""A helper process and the messages with it, over its standard input and output.

A `Helper` is the starter's end, `serve` the helper's. A message is its length (8 bytes, little-endian) and a pickle:
both ends are the same program on one machine.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Iterator, Mapping
from typing import Any, BinaryIO, NamedTuple, cast

from tunefree_hil.base.errors import PeerGone
from tunefree_hil.base.own_python import own_python

LENGTH_BYTES = 8
LAST_LINES = 12  # of what a helper printed, where it dies
END_S = 5.0  # from its last sign of life to its exit status


class Loss(NamedTuple):
    """What the PeerGone of a lost helper says: `subject` begins its message ("the process that fits")."""

    peer: str
    subject: str
    code: str
    hint: str


class Helper:
    """A module of ours that runs as a process of its own and ends with this one. The module calls `serve`.

    variables: what its environment has beside, or instead of, ours. `ask`, `say` and `hear` raise PeerGone, with the
    end of what the process printed, where it is lost.
    """

    def __init__(self, module: str, variables: Mapping[str, str], loss: Loss) -> None:
        self._loss = loss
        self._words = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        self.process = subprocess.Popen(
            own_python(module),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._words,
            env={**os.environ, **variables},
        )
        self._requests = cast(BinaryIO, self.process.stdin)
        self._answers = cast(BinaryIO, self.process.stdout)

    def ask(self, message: Any) -> Any:
        """Send it a request and wait for its one answer."""
        with self._whole():
            send(self._requests, message)
            return receive(self._answers)

    def say(self, message: Any) -> None:
        """Send it a request that has several answers; whoever does not `hear` them all closes it."""
        with self._whole():
            send(self._requests, message)

    def hear(self) -> Any:
        """Wait for its next answer."""
        with self._whole():
            return receive(self._answers)

    def close(self) -> None:
        """End the process, whatever it does."""
        if self.process.poll() is None:
            self.process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(END_S)
        for pipe in (self._requests, self._answers, self._words):
            with contextlib.suppress(BrokenPipeError):
                pipe.close()

    @contextlib.contextmanager
    def _whole(self) -> Iterator[None]:
        """What was said or heard by halves cannot be gone on with."""
        try:
            yield
        except (EOFError, BrokenPipeError) as error:
            raise self._lost() from error
        except KeyboardInterrupt:
            self.process.kill()  # half an answer may be under way: nobody can ask it again
            raise

    def _lost(self) -> PeerGone:
        self.process.wait(END_S)
        self._words.seek(0)
        lines = self._words.read().decode(errors="replace").strip().splitlines()[-LAST_LINES:]
        stderr_lines = "\n    ".join(["", *lines]) if lines else ""
        message = f"{self._loss.subject} has ended ({self.process.returncode}){stderr_lines}"
        return PeerGone(self._loss.peer, message, code=self._loss.code, hint=self._loss.hint)


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
    """Hand on requests; the parent's end is ours, whatever is being worked on. So is a request that cannot be read:
    nobody would answer it, and the parent would wait for ever.
    """
    try:
        while True:
            todo.put(receive(pipe))
    except EOFError:
        os._exit(0)
    finally:
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)


def _exactly(pipe: BinaryIO, size: int) -> bytes:
    data = bytearray()
    while len(data) < size:
        part = pipe.read(size - len(data))
        if not part:
            raise EOFError
        data += part
    return bytes(data)
