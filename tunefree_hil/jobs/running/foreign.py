"""Foreign controllers: any process that uses the vehicle's DBC and bench.dbc (docs/reference/bench_channel.md)."""

from __future__ import annotations

import hashlib
import os
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, is_heavy, part_values
from tunefree_hil.bus.bench_channel import HELLO_WORDS, Role
from tunefree_hil.config.schema import with_controller
from tunefree_hil.control.parameters import NAMES
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession


def with_controller_command(bench: Bench, text: str) -> Bench:
    """The bench with the controller program of `--controller 'CMD'`; '' leaves the bench file's.

    File names in the command are relative to the current folder.
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        hint = "--controller 'PROGRAM ARGUMENT ...', quoted as for a shell"
        raise InputError(f"{text!r}: {error}", code="bad_command", key="--controller", hint=hint) from None
    return replace(bench, spec=with_controller(bench.spec, _resolve_paths(words, Path())))


def controller_program(bench: Bench) -> list[str] | None:
    """The program to start instead of the built-in controller, None for that one.

    File names in the command ('../build/controller') are relative to the bench file.
    """
    return _resolve_paths(bench.spec.controller.command, Path(bench.file).parent) or None


def make_launch(bench: Bench, model: str, **more: Any) -> BenchLaunch:
    """The launch of a bench with this model and the controller of its file; more: other fields of the launch."""
    command = controller_program(bench)
    return BenchLaunch(model=model, jitted_ecu=is_heavy(bench, model), controller_command=command, **more)


def program_hashes(bench: Bench) -> dict[str, str]:
    """SHA-256 of the files in the controller's command by name, so that a rebuilt program is detected."""
    files = [Path(word) for word in controller_program(bench) or [] if os.path.isabs(word) and os.path.isfile(word)]
    return {path.name: f"sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}" for path in files}


def _resolve_paths(words: Sequence[str], folder: Path) -> list[str]:
    """The words, with paths of files in `folder` made absolute.

    Symbolic links are not resolved: the `python` of a virtual environment finds its packages by its own path.
    """
    return [os.path.abspath(folder / word) if "/" in word and (folder / word).is_file() else word for word in words]


def joined_controller_name(lanes: Sequence[BenchSession]) -> str:
    """Name that the controller of a joined bench announces."""
    return lanes[0].runner.collector.name(Role.CONTROLLER)


def foreign_parameter_names(names: Iterable[str]) -> list[str]:
    """The names that are no parameters of the built-in controller (docs/reference/controller.md)."""
    return [name for name in names if name not in NAMES]


def unsupported_parameters(bench: Bench, names: Iterable[str]) -> list[str]:
    """The names that neither the built-in controller nor the user's parts in it have."""
    parts = part_values(bench)
    return [name for name in foreign_parameter_names(names) if name not in parts]


def require_foreign_controller(bench: Bench, names: Iterable[str], *, join: bool) -> None:
    """Raise InputError where foreign parameters are tuned without a foreign controller."""
    if bench.spec.controller.command or join:
        return
    if unsupported := unsupported_parameters(bench, names):
        raise InputError(
            f"the built-in controller has no parameter {', '.join(unsupported)}",
            code="unknown_parameter",
            file=bench.file,
            key="tune.parameters",
            hint="name the program that has it: command = [...] in [controller], --controller 'CMD' of drive and tune, "
            "or --join for a running one",
        )


def require_announced(bench: Bench, lanes: Sequence[BenchSession], names: Iterable[str]) -> None:
    """Raise InputError where the controller did not announce a tuned parameter."""
    foreign = foreign_parameter_names(names)
    announced = list(lanes[0].runner.announced().values()) if foreign else []
    missing = [name for name in foreign if name not in announced]
    if missing:
        hint = f"it announced {', '.join(announced)}: tune these, or make it announce the missing ones"
        raise InputError(
            f"the controller did not announce the parameter {', '.join(missing)}",
            code="not_announced",
            file=bench.file,
            key="tune.parameters",
            hint=hint if announced else f"it announced no parameters; it has to send {HELLO_WORDS}",
        )
