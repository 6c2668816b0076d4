"""The recorder's process: takes requests of its owner over a socket pair, in lines of JSON.

    python -m tunefree_hil.bus.recording.recorder_process FD [SESSION]

SESSION only shows in a list of processes. First the owner sends the RecorderSetup, then requests: start (paths), stop,
stats. Each gets one line, {"ok": ...} or {"error": ...}; trouble on the bus is reported between them, once, as
{"trouble": {...}}.
"""

from __future__ import annotations

import json
import select
import signal
import socket
import sys
from typing import Any, TextIO

from tunefree_hil.base.errors import BenchError, TunefreeError
from tunefree_hil.bus.recording.recorder import Recorder, RecorderSetup, open_recorder

IDLE_S = 0.5
LONGEST_LINE = 1 << 20


def serve(control: socket.socket) -> None:
    """Serve the owner at the other end of `control` until it closes.

    Raises BenchError, InputError where a link does not open.
    """
    control.setblocking(True)
    with control.makefile("r", encoding="ascii", newline="\n") as lines:
        words = json.loads(lines.readline(LONGEST_LINE) or "null")
        if words is None:
            return
        reports, commands = words.pop("ids")
        try:
            recorder = open_recorder(RecorderSetup(**words, ids=(reports, commands)))
        except TunefreeError as error:
            _send(control, {"error": error.as_dict()})
            raise
        _send(control, {"ok": {}})
        try:
            _record(recorder, control, lines)
        except (BrokenPipeError, ConnectionResetError):
            return  # the owner went during a reply
        finally:
            recorder.close()


def _record(recorder: Recorder, control: socket.socket, lines: TextIO) -> None:
    """Read the bus, report trouble, answer requests; until the owner is gone."""
    reported: TunefreeError | None = None
    poll = select.poll()
    for fd in (*recorder.fds, control.fileno()):
        poll.register(fd, select.POLLIN)
    while True:
        busy = recorder.work()
        ready = {fd for fd, _ in poll.poll(0 if busy else IDLE_S * 1e3)}
        recorder.read()
        if recorder.trouble is not None and recorder.trouble is not reported:
            reported = recorder.trouble
            _send(control, {"trouble": reported.as_dict()})
        if control.fileno() in ready:
            line = lines.readline(LONGEST_LINE)
            if not line:
                return
            _send(control, _answer(recorder, json.loads(line)))
            reported = recorder.trouble  # the answer holds trouble found at the end of a log


def _answer(recorder: Recorder, request: dict[str, Any]) -> dict[str, Any]:
    """The reply to one line: {"ok": ...} or {"error": ...}; with stop also the trouble there was."""
    try:
        if request["op"] == "start":
            recorder.start(request["paths"])
            return {"ok": {}}
        if request["op"] == "stop":
            counts = recorder.stop()
            return {"ok": {**counts, "trouble": recorder.trouble.as_dict() if recorder.trouble else None}}
        return {"ok": {"frames": recorder.frames}}
    except BenchError as error:
        return {"error": error.as_dict()}


def _send(control: socket.socket, words: dict[str, Any]) -> None:
    control.sendall(json.dumps(words).encode("ascii") + b"\n")


def main() -> int:
    """The process; its exit status."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the owner handles Ctrl-C
    try:
        serve(socket.socket(fileno=int(sys.argv[1])))
    except TunefreeError as error:
        sys.stderr.write(f"recorder: {error}\n")
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
