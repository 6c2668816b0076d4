"""Shows the events of a job and turns its end into an exit status (docs/reference/files.md).

Progress and messages go to stderr. stdout has the product of a job (events of kind 'line') or, with --json, one object.
The last line is the sentence of the result; the lines before it are the next commands to paste.
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
from tunefree_hil.cli.text import format_progress, make_pasteable

SCHEMA = "tunefree.result/1"
STATUSES = ("ok", "failed", "interrupted")
EXIT_SIGPIPE = 141  # 128 + SIGPIPE: the job did not finish, so its checks are not done
PATH_ERRORS = (FileNotFoundError, FileExistsError, IsADirectoryError, NotADirectoryError, PermissionError)


class ExitStatus(int):
    """Exit status of a command that has printed how it ended; the 130 of typer is a plain int."""


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
            text = format_progress(event.message, event.data)
        else:
            text = f"warning: {event.message}" if event.kind == "warning" else event.message
        print(text, file=self.stream, flush=True)

    def close(self) -> None:
        """Nothing to close."""


class _JobEnd:
    """What is needed at the end of a job: its result, and the command to resume it."""

    def __init__(self) -> None:
        self.result: Event | None = None
        self.resume, self.saved = "", True

    def note(self, event: Event) -> None:
        if event.data.get("resume"):
            self.resume, self.saved = str(event.data["resume"]), bool(event.data.get("saved", True))
        if event.kind == "result":
            self.result = event


def present(command: str, job: Callable[[], Iterable[Event]], *, plain: bool, as_json: bool) -> int:
    """Run a job, show its events and print how it ended.

    Errors of base/errors.py become one message; any other exception is a bug and keeps its traceback. When the reader
    (head, less) closes the pipe, the exit status is that of the result if there is one by then.

    Args:
        command: Name for --json.
        job: Starts the job.
        plain: One line an event.
        as_json: One object on stdout, last.

    Returns:
        The exit status.
    """
    job_end = _JobEnd()
    try:
        return ExitStatus(_run_and_print(command, job, job_end, _make_sink(plain), as_json))
    except BrokenPipeError:
        for stream in (sys.stdout, sys.stderr):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        return ExitStatus(_status_from_result(job_end) if job_end.result else EXIT_SIGPIPE)


def _run_and_print(
    command: str, job: Callable[[], Iterable[Event]], job_end: _JobEnd, sink: Sink, as_json: bool
) -> int:
    """Run the job and print its end; returns the exit status. Raises BrokenPipeError when the reader is gone."""
    status, errors = 1, []
    try:
        _show_events(job(), sink, job_end, as_json)
        status = _status_from_result(job_end)
    except KeyboardInterrupt:
        status = INTERRUPTED
    except BrokenPipeError:
        raise
    except (TunefreeError, OSError) as error:
        reported = error if isinstance(error, TunefreeError) else _error_from_system(error)
        status, errors = reported.exit_status, [reported.as_dict()]
    except Exception as error:
        traceback.print_exc()
        errors = [_error_from_bug(error).as_dict()]
    finally:
        sink.close()
    _print_end(status, job_end, errors)
    if as_json:
        data = dict(job_end.result.data) if job_end.result else {}
        if status == INTERRUPTED and job_end.resume:
            data["resume"] = job_end.resume
        print(json.dumps(make_result_object(command, status, data, errors), allow_nan=False))
    sys.stdout.flush()
    return status


def _show_events(events: Iterable[Event], sink: Sink, job_end: _JobEnd, as_json: bool) -> None:
    """Show every event; the job is closed whatever ends it."""
    try:
        for event in events:
            job_end.note(event)
            if event.kind == "line":
                if not as_json:
                    print(event.message)
            elif event.kind != "result":
                sink.show(event)
    finally:
        close = getattr(events, "close", None)
        if close is not None:
            close()


def _status_from_result(job_end: _JobEnd) -> int:
    if job_end.result is None:
        raise BenchError(
            "the job ended without a result", code="no_result", hint="run it again with --plain and report it"
        )
    return int(job_end.result.data.get("exit", 0))


def _error_from_system(error: OSError) -> TunefreeError:
    """InputError for a wrong path, BenchError for a full disk or a lost device."""
    kind = InputError if isinstance(error, PATH_ERRORS) else BenchError
    hint = (
        "make room, then run the same command" if error.errno == errno.ENOSPC else "check the path and its permissions"
    )
    return kind(error.strerror or str(error), code="system", file=str(error.filename or ""), hint=hint)


def _error_from_bug(error: Exception) -> TunefreeError:
    return TunefreeError(
        f"{type(error).__name__}: {error}", code="internal", hint="a bug in tunefree_hil; report the lines above"
    )


def _print_end(status: int, job_end: _JobEnd, errors: list[dict[str, str]]) -> None:
    """Print the last lines."""
    lines = [format_error(error) for error in errors]
    if status == INTERRUPTED:
        lines += _format_next([job_end.resume] if job_end.resume else [])
        state = ", state saved" if job_end.saved else ", nothing saved yet: that command starts from the beginning"
        lines.append(f"interrupted{state}" if job_end.resume else "interrupted")
    elif not errors and job_end.result is not None:
        data = job_end.result.data
        lines += _format_next(data.get("next", []))
        lines.append(str(data.get("sentence") or job_end.result.message))
    for line in lines:
        print(line, file=sys.stderr, flush=True)


def _format_next(commands: Iterable[str]) -> list[str]:
    lines = [f"  {make_pasteable(command)}" for command in commands]
    return ["next:", *lines] if lines else []


def format_error(error: Mapping[str, str]) -> str:
    """One error as text: where, what is wrong, what to do."""
    where = error["file"] + (f", key {error['key']}" if error["key"] and error["file"] else "")
    text = f"error: {where}: {error['message']}" if where else f"error: {error['message']}"
    return f"{text}\n  what to do: {error['hint']}" if error["hint"] else text


def make_result_object(command: str, status: int, data: dict[str, Any], errors: list[dict[str, str]]) -> dict[str, Any]:
    """The object of --json (schema tunefree.result/1); numbers that are not finite become null."""
    text = data.get("status")
    if text not in STATUSES or (text == "ok") != (status == 0):
        text = {0: "ok", INTERRUPTED: "interrupted"}.get(status, "failed")
    payload = {key: value for key, value in data.items() if key not in ("exit", "status")}
    head = {"schema": SCHEMA, "command": command, "status": text, "exit": status}
    return {**head, "data": _plain(payload), "errors": errors}


def _plain(value: Any) -> Any:
    """JSON data: numpy numbers and arrays, paths, records and enums become plain values."""
    if isinstance(value, str | bool | int) or value is None:
        return value
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if hasattr(value, "_asdict"):
        return _plain(value._asdict())
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value)


def _make_sink(plain: bool) -> Sink:
    """Live bars at a terminal, otherwise lines."""
    if plain or not sys.stderr.isatty() or os.environ.get("TERM", "") in ("", "dumb"):
        return PlainSink(sys.stderr)
    from tunefree_hil.cli.live import LiveSink  # imported here: rich costs memory, which node processes save

    return LiveSink()
