"""Commands that work as pasted: words quoted for a shell, which the command line reads as what was asked."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

PROGRAM = "tunefree-hil"
AS_THE_FIELD: Mapping[str, str] = {}


def pasted(command: str, *arguments: Any, **options: Any) -> str:
    """`tunefree-hil COMMAND ARGUMENT ... --option VALUE ...`; an argument that is None is left out."""
    said = [_word(one) for one in arguments if one is not None]
    return shlex.join([PROGRAM, *command.split(), *said, *option_words(**options)])


def option_words(**options: Any) -> list[str]:
    """By their names on the command line, with _ for -. True is a flag, False and None are nothing, and a list is said
    once for each of its values.
    """
    words: list[str] = []
    for name, value in options.items():
        option = "--" + name.replace("_", "-")
        if value is True:
            words.append(option)
        elif value is not None and value is not False:
            some = value if isinstance(value, list | tuple) else [value]
            words += [word for one in some for word in (option, _word(one))]
    return words


def given(asked: NamedTuple, leave: Collection[str] = (), called: Mapping[str, str] = AS_THE_FIELD) -> dict[str, Any]:
    """Of a job's Asked the options that are not what they are when nothing is said.

    leave: fields that are no options; called: fields whose option has another name.
    """
    usual = asked._field_defaults
    said = {name: value for name, value in asked._asdict().items() if value != usual.get(name)}
    return {called.get(name, name): value for name, value in said.items() if name not in leave}


def _word(value: Any) -> str:
    """Of a number the shortest that is read back as the same: what a run was begun with must agree to the last bit."""
    return f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else str(value)
