"""A helper process, and messages over its standard input and output.

`Helper` is the side of the parent, `serve` that of the helper. A message is its length (8 bytes, little-endian) and
a pickle, as both sides are the same program on one machine.
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
LAST_LINES = 12  # of the helper's output, quoted when it has ended
END_S = 5.0  # from its last output to its exit status


class Loss(NamedTuple):
    """Content of PeerGone for a lost helper; `subject` begins its message ("the process that fits")."""

    peer: str
    subject: str
    code: str
    hint: str


class Helper:
    """A module of ours that runs as a process of its own and ends with this one. The module calls `serve`.

    variables: added to, or instead of, those of this process. `ask`, `send_request` and `receive_answer` raise PeerGone
    with the end of the output of the process, where it is lost.
    """

    def __init__(self, module: str, variables: Mapping[str, str], loss: Loss) -> None:
        self._loss = loss
        self._words = tempfile.TemporaryFile()  # noqa: SIM115 - needed as long as the process
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
        """Send a request and wait for its only answer."""
        with self._whole():
            send(self._requests, message)
            return receive(self._answers)

    def send_request(self, message: Any) -> None:
        """Send a request with several answers; a caller that does not receive all of them closes the helper."""
        with self._whole():
            send(self._requests, message)

    def receive_answer(self) -> Any:
        """Wait for the next answer."""
        with self._whole():
            return receive(self._answers)

    def close(self) -> None:
        """End the process at once."""
        if self.process.poll() is None:
            self.process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(END_S)
        for pipe in (self._requests, self._answers, self._words):
            with contextlib.suppress(BrokenPipeError):
                pipe.close()

    @contextlib.contextmanager
    def _whole(self) -> Iterator[None]:
        """Raise PeerGone for a message that was cut off; end the process on an interrupt."""
        try:
            yield
        except (EOFError, BrokenPipeError) as error:
            raise self._lost() from error
        except KeyboardInterrupt:
            self.process.kill()  # an answer may be incomplete, so no further request is possible
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
    """Read a message. Raises EOFError when the other side has ended."""
    size = int.from_bytes(_exactly(pipe, LENGTH_BYTES), "little")
    return pickle.loads(_exactly(pipe, size))  # from parent or child process only


def serve() -> tuple[queue.SimpleQueue[Any], BinaryIO]:
    """(queue of requests, pipe for answers) of a helper; from now on it ends with its parent."""
    # Unbuffered: the listening thread then holds no lock that would block the end of this process.
    requests = cast(BinaryIO, os.fdopen(os.dup(sys.stdin.fileno()), "rb", buffering=0))
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # printed text must not get into the answers
    todo: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(requests, todo), daemon=True).start()
    return todo, answers


def _listen(pipe: BinaryIO, todo: queue.SimpleQueue[Any]) -> None:
    """Queue requests; end this process with the parent, also during a request, and for a request that cannot be read,
    as the parent would wait for its answer forever.
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
