"""Somebody else's controller: any process that speaks the vehicle's DBC and bench.dbc (interfaces 7 and 8)."""

from __future__ import annotations

import hashlib
import os
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, part_values
from tunefree_hil.bus.bench_channel import HELLO_WORDS, Role
from tunefree_hil.config.schema import with_controller
from tunefree_hil.control.parameters import NAMES
from tunefree_hil.jobs.running.session import Session


def with_command(bench: Bench, text: str) -> Bench:
    """The bench with the controller program of `--controller 'CMD'`; '' leaves it as the bench file says.

    Words that name a file are the shell's: from the folder where one is, wherever the bench file lies.
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        hint = "--controller 'PROGRAM ARGUMENT ...', quoted as for a shell"
        raise InputError(f"{text!r}: {error}", code="bad_command", key="--controller", hint=hint) from None
    return replace(bench, spec=with_controller(bench.spec, _found(words, Path())))


def program_of(bench: Bench) -> list[str] | None:
    """The program to start instead of our controller, None for ours.

    A word that names a file beside the bench file ('../build/controller') is that file.
    """
    return _found(bench.spec.controller.command, Path(bench.file).parent) or None


def program_hashes(bench: Bench) -> dict[str, str]:
    """SHA-256 by name of the files of the controller's command: a program that was built anew is another one."""
    files = [Path(word) for word in program_of(bench) or [] if os.path.isabs(word) and os.path.isfile(word)]
    return {path.name: f"sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}" for path in files}


def _found(words: Sequence[str], folder: Path) -> list[str]:
    """The words, those that name a file in `folder` by a path as absolute ones.

    A link stays one: of an environment's `python` it is the name by which it finds its packages.
    """
    return [os.path.abspath(folder / word) if "/" in word and (folder / word).is_file() else word for word in words]


def joined_name(lanes: Sequence[Session]) -> str:
    """What the controller of a bench that was joined calls itself."""
    return lanes[0].runner.collector.name(Role.CONTROLLER)


def own_names(names: Iterable[str]) -> list[str]:
    """Those that are none of interfaces 7."""
    return [name for name in names if name not in NAMES]


def not_ours(bench: Bench, names: Iterable[str]) -> list[str]:
    """Those that our controller does not have, its parts of the user's own included."""
    parts = part_values(bench)
    return [name for name in own_names(names) if name not in parts]


def require_one(bench: Bench, names: Iterable[str], *, join: bool) -> None:
    """Raise InputError where foreign parameters are searched and no foreign controller is to be had."""
    if bench.spec.controller.command or join:
        return
    if own := not_ours(bench, names):
        raise InputError(
            f"our controller has no parameter {', '.join(own)}",
            code="unknown_parameter",
            file=bench.file,
            key="tune.parameters",
            hint="name the program that has it: command = [...] in [controller]; drive and tune take it as "
            "--controller 'CMD' too, or with --join the one that runs",
        )


def require_announced(bench: Bench, lanes: Sequence[Session], names: Iterable[str]) -> None:
    """Raise InputError where the controller did not announce a parameter that is searched."""
    own = own_names(names)
    announced = list(lanes[0].runner.announced().values()) if own else []
    missing = [name for name in own if name not in announced]
    if missing:
        hint = f"it announced {', '.join(announced)}: search some of those, or let it announce this one too"
        raise InputError(
            f"the controller announces no parameter {', '.join(missing)}",
            code="not_announced",
            file=bench.file,
            key="tune.parameters",
            hint=hint if announced else f"it announced none at all; it has to send {HELLO_WORDS}",
        )
