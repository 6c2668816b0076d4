"""Start and end of a command line: usage errors, signals, exit status (docs/reference/files.md)."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence

import typer

from tunefree_hil.cli import INTERRUPTED, handle_sigterm
from tunefree_hil.cli.app import app
from tunefree_hil.cli.output import ExitStatus, format_error, make_result_object

USAGE = 2


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit status. Wrong input gives a message, never a traceback."""
    handle_sigterm()
    try:
        status = app(args=list(arguments), prog_name="tunefree-hil", standalone_mode=False)
    except typer.TyperException as error:
        return _usage(error, arguments)
    except (typer.Abort, KeyboardInterrupt):
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    if status == INTERRUPTED and not isinstance(status, ExitStatus):  # Ctrl-C while typer was running
        print("interrupted", file=sys.stderr)
    return int(status) if isinstance(status, int) else 0


def _usage(error: typer.TyperException, arguments: Sequence[str]) -> int:
    """Print what is wrong with the arguments, and the command for help."""
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else "tunefree-hil"
    usage_error = {
        "code": "usage",
        "file": "",
        "key": getattr(error, "option_name", "") or "",
        "message": error.format_message(),
        "hint": f"{path} --help",
    }
    print(format_error(usage_error), file=sys.stderr)
    if "--json" in arguments:
        names = path.split()[1:]
        print(json.dumps(make_result_object(" ".join(names), USAGE, {}, [usage_error])))
    return USAGE
