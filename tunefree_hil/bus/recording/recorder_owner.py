"""The runner's end of a recorder process on SocketCAN; over a hub it is tfhub/owner.py."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError, NoAnswer
from tunefree_hil.bus.recording.recorder import RecorderSetup

REPLY_S = 60.0  # a disk may be slow
STATS_S = 5.0
MODULE = "tunefree_hil.bus.recording.recorder_process"  # then the number of its socket


class BusTrouble(BenchError):
    """Trouble on the bus that a recorder has reported; it knows more than the nodes that lost the bus."""


class RecorderStats(NamedTuple):
    """`frames`: channel -> frames received since the recorder was started."""

    frames: dict[str, int]


class RecorderOwner:
    """The owner's end of the socket pair. `foreign`, `errors`, `remote`: counts of the last episode: foreign
    frames by id, error frames by name, remote frames.

    Every method raises BenchError where the recorder is gone, and the trouble that it reports on the bus, once.
    """

    def __init__(self, control: socket.socket, setup: RecorderSetup, patience_s: float) -> None:
        self.foreign: dict[int, int] = {}
        self.errors: dict[str, int] = {}
        self.remote = 0
        self._control = control
        self._rest = b""
        self._troubles: list[dict[str, str]] = []
        self._reported: list[dict[str, str]] = []
        self._ask(setup._asdict(), patience_s)

    def start_log(self, paths: Mapping[str, str | PathLike[str]]) -> None:
        """Record from now on: {"vehicle": path, "bench": path}. Each file has its name only after stop_log."""
        self._troubles.clear()
        self._reported.clear()
        whole = {channel: str(Path(fspath(path)).absolute()) for channel, path in paths.items()}
        self._ask({"op": "start", "paths": whole}, REPLY_S)

    def stop_log(self) -> dict[str, int]:
        """Finish the logs; frames by channel. BenchError for a file, or for trouble that `check` has not raised yet."""
        counts = self._ask({"op": "stop"}, REPLY_S)
        self.foreign = {int(key, 16): count for key, count in counts["foreign"].items()}
        self.errors, self.remote = counts["errors"], counts["remote"]
        if counts["trouble"] is not None and counts["trouble"] not in self._reported:
            self._raise_trouble(counts["trouble"])
        return counts["frames"]

    def stats(self) -> RecorderStats:
        """The recorder's numbers. NoAnswer where it is stopped."""
        return RecorderStats(self._ask({"op": "stats"}, STATS_S)["frames"])

    def check(self) -> None:
        """Raise the trouble that the recorder has reported since the last call. Does not wait."""
        self._take(0.0)
        while self._troubles:
            trouble = self._troubles.pop(0)
            if trouble not in self._reported:
                self._raise_trouble(trouble)

    def close(self) -> None:
        """Give the recorder up; it ends."""
        self._control.close()

    def _raise_trouble(self, trouble: dict[str, str]) -> None:
        self._reported.append(trouble)
        raise BusTrouble(**trouble)

    def _ask(self, request: dict[str, Any], patience_s: float) -> Any:
        self._control.settimeout(patience_s)
        try:
            self._control.sendall(json.dumps(request).encode("ascii") + b"\n")
        except OSError as error:
            raise _gone() from error
        deadline_s = time.monotonic() + patience_s
        while True:
            for reply in self._take(max(0.0, deadline_s - time.monotonic())):
                if "error" in reply:
                    raise BenchError(**reply["error"])
                return reply["ok"]
            if time.monotonic() > deadline_s:
                words = f"the recorder did not answer {request.get('op', 'setup')} within {patience_s:g} s"
                raise NoAnswer(words, code="no_answer")

    def _take(self, timeout_s: float) -> list[dict[str, Any]]:
        """Replies that have arrived; troubles are stored."""
        self._control.settimeout(timeout_s)
        try:
            data = self._control.recv(1 << 16)
        except (BlockingIOError, TimeoutError):
            return []
        except OSError as error:
            raise _gone() from error
        if not data:
            raise _gone()
        *lines, self._rest = (self._rest + data).split(b"\n")
        replies = [json.loads(line) for line in lines]
        self._troubles += [reply["trouble"] for reply in replies if "trouble" in reply]
        return [reply for reply in replies if "trouble" not in reply]


def _gone() -> BenchError:
    return BenchError("the recorder is gone", code="recorder_gone", hint="its output stands beside that of the nodes")
