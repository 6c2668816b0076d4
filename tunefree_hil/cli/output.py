"""Shows the events of a job and turns its end into an exit status (interfaces 1).

Progress and words go to stderr. stdout carries a job's product (events of kind 'line') or, with --json, one object.
A person's last line is the result's sentence; the lines before it are the next commands to paste.
"""

from __future__ import annotations

import errno
import json
import math
import os
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol, TextIO

from tunefree_hil.base.errors import BenchError, InputError, TunefreeError
from tunefree_hil.base.events import Event
from tunefree_hil.cli import INTERRUPTED
from tunefree_hil.cli.text import pasteable, progress_line

SCHEMA = "tunefree.result/1"
STATUSES = ("ok", "failed", "interrupted")
NOBODY_READS = 141  # as of a program that SIGPIPE ends: it did not come to its end, and what it checks may not hold
WRONG_PATH = (FileNotFoundError, FileExistsError, IsADirectoryError, NotADirectoryError, PermissionError)


class Said(int):
    """The exit status of a command that has said how it ended; typer's own 130 is one that has not."""


class Sink(Protocol):
    """Where notes, warnings and progress go."""

    def show(self, event: Event) -> None: ...

    def close(self) -> None: ...


class PlainSink:
    """One line an event."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def show(self, event: Event) -> None:
        """Write the event as one line."""
        if event.kind == "progress":
            text = progress_line(event.message, event.data)
        else:
            text = f"warning: {event.message}" if event.kind == "warning" else event.message
        print(text, file=self.stream, flush=True)

    def close(self) -> None:
        """Nothing is open."""


class _Heard:
    """What the events have told so far that the end needs."""

    def __init__(self) -> None:
        self.result: Event | None = None
        self.resume, self.saved = "", True

    def note(self, event: Event) -> None:
        if event.data.get("resume"):
            self.resume, self.saved = str(event.data["resume"]), bool(event.data.get("saved", True))
        if event.kind == "result":
            self.result = event


def present(command: str, job: Callable[[], Iterable[Event]], *, plain: bool, as_json: bool, first: str = "") -> int:
    """Run `job`, show its events, print how it ended. Returns the exit status.

    `first` is said at once, before the job's own modules are imported. Errors of base/errors.py become one message;
    any other exception is a mistake of ours and keeps its traceback. When the reader (head, less) leaves, the status
    is the result's where there is one by then.
    """
    heard = _Heard()
    try:
        return Said(_shown(command, job, heard, _sink(plain), as_json, first))
    except BrokenPipeError:
        for stream in (sys.stdout, sys.stderr):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        return Said(_status_of(heard) if heard.result else NOBODY_READS)


def _shown(
    command: str, job: Callable[[], Iterable[Event]], heard: _Heard, sink: Sink, as_json: bool, first: str
) -> int:
    """The job run and its end printed; the exit status. Raises BrokenPipeError when nobody reads any more."""
    status, errors = 1, []
    try:
        if first:
            sink.show(Event("note", first))
        _watch(job(), sink, heard, as_json)
        status = _status_of(heard)
    except KeyboardInterrupt:
        status = INTERRUPTED
    except BrokenPipeError:
        raise
    except (TunefreeError, OSError) as error:
        said = error if isinstance(error, TunefreeError) else _of_the_system(error)
        status, errors = said.exit_status, [said.as_dict()]
    except Exception as error:
        traceback.print_exc()
        errors = [_of_ours(error).as_dict()]
    finally:
        sink.close()
    _say_end(status, heard, errors)
    if as_json:
        data = dict(heard.result.data) if heard.result else {}
        if status == INTERRUPTED and heard.resume:
            data["resume"] = heard.resume
        print(json.dumps(result_object(command, status, data, errors), allow_nan=False))
    sys.stdout.flush()
    return status


def _watch(events: Iterable[Event], sink: Sink, heard: _Heard, as_json: bool) -> None:
    """Show every event; the job's own clearing up runs whatever ends it."""
    try:
        for event in events:
            heard.note(event)
            if event.kind == "line":
                if not as_json:
                    print(event.message)
            elif event.kind != "result":
                sink.show(event)
    finally:
        close = getattr(events, "close", None)
        if close is not None:
            close()


def _status_of(heard: _Heard) -> int:
    if heard.result is None:
        raise BenchError(
            "the job ended without a result", code="no_result", hint="run it again with --plain and report it"
        )
    return int(heard.result.data.get("exit", 0))


def _of_the_system(error: OSError) -> TunefreeError:
    """A path that is wrong is the user's to mend; a full disk or a lost device is the bench's."""
    kind = InputError if isinstance(error, WRONG_PATH) else BenchError
    hint = (
        "make room, then run the same command" if error.errno == errno.ENOSPC else "check the path and its permissions"
    )
    return kind(error.strerror or str(error), code="system", file=str(error.filename or ""), hint=hint)


def _of_ours(error: Exception) -> TunefreeError:
    return TunefreeError(
        f"{type(error).__name__}: {error}", code="internal", hint="a mistake in tunefree_hil; report the lines above"
    )


def _say_end(status: int, heard: _Heard, errors: list[dict[str, str]]) -> None:
    """The last lines for a person."""
    lines = [error_text(error) for error in errors]
    if status == INTERRUPTED:
        lines += _next([heard.resume] if heard.resume else [])
        kept = ", state saved" if heard.saved else ", nothing is kept yet: that command begins anew"
        lines.append(f"interrupted{kept}" if heard.resume else "interrupted")
    elif not errors and heard.result is not None:
        data = heard.result.data
        lines += _next(data.get("next", []))
        lines.append(str(data.get("sentence") or heard.result.message))
    for line in lines:
        print(line, file=sys.stderr, flush=True)


def _next(commands: Iterable[str]) -> list[str]:
    lines = [f"  {pasteable(command)}" for command in commands]
    return ["next:", *lines] if lines else []


def error_text(error: Mapping[str, str]) -> str:
    """One error for a person: where, what was expected, what to do."""
    where = error["file"] + (f", key {error['key']}" if error["key"] and error["file"] else "")
    text = f"error: {where}: {error['message']}" if where else f"error: {error['message']}"
    return f"{text}\n  what to do: {error['hint']}" if error["hint"] else text


def result_object(command: str, status: int, data: dict[str, Any], errors: list[dict[str, str]]) -> dict[str, Any]:
    """The object that --json prints (schema tunefree.result/1); numbers that are not finite become null."""
    word = data.get("status")
    if word not in STATUSES or (word == "ok") != (status == 0):
        word = {0: "ok", INTERRUPTED: "interrupted"}.get(status, "failed")
    rest = {key: value for key, value in data.items() if key not in ("exit", "status")}
    found = {"schema": SCHEMA, "command": command, "status": word, "exit": status}
    return {**found, "data": _plain(rest), "errors": errors}


def _plain(value: Any) -> Any:
    """Only what JSON knows: numpy numbers and rows, paths, records and enums made plain."""
    if isinstance(value, str | bool | int) or value is None:
        return value
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if hasattr(value, "_asdict"):
        return _plain(value._asdict())
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(one) for one in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value)


def _sink(plain: bool) -> Sink:
    """Live bars for a person at a terminal; lines for everything else."""
    if plain or not sys.stderr.isatty() or os.environ.get("TERM", "") in ("", "dumb"):
        return PlainSink(sys.stderr)
    from tunefree_hil.cli.live import LiveSink  # rich costs memory that a node's process does not have

    return LiveSink()
