"""Where the command line begins and ends: usage mistakes, signals, exit status (interfaces 1)."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence

import typer

from tunefree_hil.cli import INTERRUPTED, end_as_ctrl_c
from tunefree_hil.cli.app import app
from tunefree_hil.cli.output import Said, error_text, result_object

USAGE = 2


def run(arguments: Sequence[str]) -> int:
    """Run one command line. Returns its exit status; never a traceback for what the user gave."""
    end_as_ctrl_c()
    try:
        status = app(args=list(arguments), prog_name="tunefree-hil", standalone_mode=False)
    except typer.TyperException as error:
        return _usage(error, arguments)
    except (typer.Abort, KeyboardInterrupt):
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    if status == INTERRUPTED and not isinstance(status, Said):  # Ctrl-C while typer was at work
        print("interrupted", file=sys.stderr)
    return int(status) if isinstance(status, int) else 0


def _usage(error: typer.TyperException, arguments: Sequence[str]) -> int:
    """Say what was wrong with the arguments, and where to read how it goes."""
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else "tunefree-hil"
    said = {
        "code": "usage",
        "file": "",
        "key": getattr(error, "option_name", "") or "",
        "message": error.format_message(),
        "hint": f"{path} --help",
    }
    print(error_text(said), file=sys.stderr)
    if "--json" in arguments:
        words = path.split()[1:]
        print(json.dumps(result_object(" ".join(words), USAGE, {}, [said])))
    return USAGE
