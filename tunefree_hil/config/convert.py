"""TOML text -> frozen structs of schema.py. Every mistake names file, key and what was expected."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin

import msgspec
from msgspec.structs import fields

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.find import nearest
from tunefree_hil.config.schema import Spec

S = TypeVar("S", bound=Spec)
SET_BY_LOADER = ("folder", "path", "hash")
# Limits may be infinite: it means that there is none (docs/reference/effects.md). Nothing else may.
MAY_BE_INFINITE = ("rate_limit", "effects", "params", "require")


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file, with or without a byte order mark. Raises InputError with line and column."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except tomllib.TOMLDecodeError as error:
        hint = "correct that place; strings need quotes, tables [brackets]"
        raise InputError(f"not TOML: {error}", code="not_toml", file=str(path), hint=hint) from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"not UTF-8 text: {error}", code="not_toml", file=str(path), hint="save it as UTF-8"
        ) from error
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", code="no_file", file=str(path)) from error


def convert(data: dict[str, Any], kind: type[S], file: Path | str) -> S:
    """`data` as a `kind`. Raises InputError for the first key that does not fit."""
    return _Reader(str(file)).struct(data, kind, "")


class _Reader:
    """Walks data and type together, so that every key's full name is known."""

    def __init__(self, file: str) -> None:
        self.file = file

    def error(self, key: str, message: str, code: str, hint: str) -> InputError:
        return InputError(message, code=code, file=self.file, key=key, hint=hint)

    def struct(self, data: Any, kind: type[S], key: str) -> S:
        if not isinstance(data, dict):
            raise self.error(
                key, f"expected a table, got {_show(data)}", "wrong_type", f"write [{key}] and keys below it"
            )
        known = {field.name: field for field in fields(kind) if key or field.name not in SET_BY_LOADER}
        for name in data:
            if name not in known:
                raise self.error(_join(key, name), "unknown key", "unknown_key", nearest(name, known))
        for name, field in known.items():
            if field.required and name not in data:
                expected = _expected(field.type)
                raise self.error(_join(key, name), "missing", "missing_key", f"add it; expected {expected}")
        values = {name: self.value(value, known[name].type, _join(key, name)) for name, value in data.items()}
        return kind(**values)

    def value(self, data: Any, kind: Any, key: str) -> Any:
        if isinstance(kind, type) and issubclass(kind, Spec):
            return self.struct(data, kind, key)
        origin, inner = get_origin(kind), get_args(kind)
        if origin is dict and isinstance(data, dict):
            return {name: self.value(value, inner[1], _join(key, name)) for name, value in data.items()}
        if origin is list and isinstance(data, list):
            return [self.value(value, inner[0], f"{key}[{i}]") for i, value in enumerate(data)]
        if origin in (Union, UnionType):
            for member in inner:
                if isinstance(data, dict) and isinstance(member, type) and issubclass(member, Spec):
                    return self.struct(data, member, key)
                if isinstance(data, list) and get_origin(member) is list:
                    return self.value(data, member, key)
        return self.leaf(data, kind, key)

    def leaf(self, data: Any, kind: Any, key: str) -> Any:
        try:
            value = msgspec.convert(data, kind)
        except msgspec.ValidationError as error:
            message = f"expected {_expected(kind)}, got {_show(data)}"
            raise self.error(key, message, "wrong_type", "change the value") from error
        if isinstance(value, float) and not math.isfinite(value):
            infinite = math.isinf(value) and any(word in MAY_BE_INFINITE for word in key.replace("[", ".").split("."))
            if not infinite:
                raise self.error(key, f"expected a finite number, got {value}", "not_finite", "give a number")
        return value


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


def _show(data: Any) -> str:
    kinds = {
        bool: "true or false",
        dict: "a table",
        list: "a list",
        str: "text",
        int: "a whole number",
        float: "a number",
    }
    kind = kinds.get(type(data), type(data).__name__)
    return f"{kind} ({data!r})" if isinstance(data, bool | int | float | str) else kind


def _expected(kind: Any) -> str:
    """A type as text."""
    origin, inner = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and issubclass(kind, Spec):
        return "a table with " + ", ".join(field.name for field in fields(kind))
    if origin in (Union, UnionType):
        return " or ".join(_expected(member) for member in inner if member is not type(None))
    if origin is list:
        return f"a list of {_expected(inner[0])}"
    if origin is dict:
        return "a table"
    if inner:  # Literal
        return "one of " + ", ".join(repr(value) for value in inner)
    return {float: "a number", int: "a whole number", str: "text", bool: "true or false"}.get(kind, str(kind))
