"""Shell commands to copy and paste, with quoted arguments that the command line reads back exactly."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

PROGRAM = "tunefree-hil"
SAME_NAMES: Mapping[str, str] = {}


def shell_command(command: str, *arguments: Any, **options: Any) -> str:
    """`tunefree-hil COMMAND ARGUMENT ... --option VALUE ...`; an argument that is None is left out."""
    words = [_argument_text(argument) for argument in arguments if argument is not None]
    return shlex.join([PROGRAM, *command.split(), *words, *option_arguments(**options)])


def option_arguments(**options: Any) -> list[str]:
    """Command-line words of options, with - for _. True is a flag, False and None are left out, a list repeats it."""
    words: list[str] = []
    for name, value in options.items():
        option = "--" + name.replace("_", "-")
        if value is True:
            words.append(option)
        elif value is not None and value is not False:
            values = value if isinstance(value, list | tuple) else [value]
            words += [word for item in values for word in (option, _argument_text(item))]
    return words


def changed_options(
    options: NamedTuple, skip: Collection[str] = (), option_names: Mapping[str, str] = SAME_NAMES
) -> dict[str, Any]:
    """The options of a job that differ from their defaults.

    Args:
        skip: Fields that are not options.
        option_names: Option names that differ from their field's name.
    """
    defaults = options._field_defaults
    changed = {name: value for name, value in options._asdict().items() if value != defaults.get(name)}
    return {option_names.get(name, name): value for name, value in changed.items() if name not in skip}


def _argument_text(value: Any) -> str:
    """Text of a value; of a number the shortest that is read back bit for bit, so that a resumed run agrees."""
    return f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else str(value)
