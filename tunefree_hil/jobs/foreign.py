"""Somebody else's controller: any process that speaks the vehicle's DBC and bench.dbc (interfaces 7 and 8)."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import replace

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench
from tunefree_hil.config.schema import with_controller
from tunefree_hil.control.parameters import NAMES
from tunefree_hil.jobs.session import Session


def with_command(bench: Bench, text: str) -> Bench:
    """The bench with the controller program of `--controller 'CMD'`; '' leaves it as the bench file says."""
    try:
        words = shlex.split(text)
    except ValueError as error:
        hint = "--controller 'PROGRAM ARGUMENT ...', quoted as for a shell"
        raise InputError(f"{text!r}: {error}", code="bad_command", key="--controller", hint=hint) from None
    return replace(bench, spec=with_controller(bench.spec, words))


def command_of(bench: Bench) -> list[str] | None:
    """The program to start instead of our controller, None for ours."""
    return list(bench.spec.controller.command) or None


def own_names(names: Iterable[str]) -> list[str]:
    """Those that are none of interfaces 7."""
    return [name for name in names if name not in NAMES]


def require_one(bench: Bench, names: Iterable[str], *, join: bool) -> None:
    """Raise InputError where foreign parameters are searched and no foreign controller is to be had."""
    own = own_names(names)
    controller = bench.spec.controller
    parts = any(":" in part for part in (controller.lateral, controller.longitudinal, controller.inner))
    if own and not (controller.command or join or parts):
        raise InputError(
            f"our controller has no parameter {', '.join(own)}",
            code="unknown_parameter",
            file=bench.file,
            key="tune.parameters",
            hint="name the controller that has it: [controller] command = [...], --controller 'CMD', or --join",
        )


def require_announced(bench: Bench, lanes: Sequence[Session], names: Iterable[str]) -> None:
    """Raise InputError where the controller did not announce a parameter that is searched."""
    own = own_names(names)
    announced = list(lanes[0].runner.announced().values()) if own else []
    missing = [name for name in own if name not in announced]
    if missing:
        said = f"it announced {', '.join(announced)}" if announced else "it announced no parameters (HELLO)"
        raise InputError(
            f"the controller has no parameter {', '.join(missing)}",
            code="not_announced",
            file=bench.file,
            key="tune.parameters",
            hint=f"{said}; search one of those, or let the controller announce it from index 16 on",
        )
