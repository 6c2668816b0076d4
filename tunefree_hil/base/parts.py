"""A part is a file: the file name is the public name, the folder is the list."""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import sys
import traceback
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

from tunefree_hil.base.errors import InputError

FAILURES = (  # of running a file: syntax, imports, execution
    *(SyntaxError, ImportError, NameError, AttributeError, TypeError, ValueError, LookupError),
    *(ArithmeticError, AssertionError, RuntimeError, OSError),
)


def names(package: str) -> list[str]:
    """The parts in a folder, by file name."""
    module = importlib.import_module(package)
    return sorted(info.name for info in pkgutil.iter_modules(module.__path__) if not info.name.startswith("_"))


def load(package: str, name: str, export: str, kind: type | None = None) -> Any:
    """The constant `export` of the part `name` of `package`, or of the user's own 'path/to/file.py:EXPORT'.

    Raises InputError with the existing parts, the line at which the user's file fails, or the type of an export that
    is not a `kind`.
    """
    if ":" in name:
        part = _from_path(name)
        if kind is not None and not isinstance(part, kind):
            problem = f"{name} is of type {type(part).__name__}, where {kind.__name__} is expected"
            raise InputError(problem, code="unknown_part", hint=f"{export} = {kind.__name__}(...) in that file")
        return part
    if name not in names(package):
        known = ", ".join(names(package))
        raise InputError(
            f"no {name!r} in {package}; there are {known}",
            code="unknown_part",
            hint=f"use one of these, or 'path/to/module.py:{export}' for a part of your own",
        )
    return getattr(importlib.import_module(f"{package}.{name}"), export)


def _from_path(name: str) -> Any:
    path_text, _, export = name.rpartition(":")
    path = Path(path_text)
    if not path.is_file():
        raise InputError(f"{path} does not exist", code="unknown_part", hint="'path/to/module.py:EXPORT'")
    module = _module(path.resolve(), path.read_bytes())
    if not hasattr(module, export):
        raise InputError(f"{path} has no {export}", code="unknown_part", hint=f"export a constant named {export}")
    return getattr(module, export)


@lru_cache
def _module(path: Path, text: bytes) -> ModuleType:
    """A user's file as a module, loaded again only when its text has changed.

    The compiler distinguishes types by class: a new load would give new types and a new compilation.
    """
    spec = importlib.util.spec_from_file_location(f"tunefree_user_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path} is not a Python module", code="unknown_part")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except FAILURES as error:
        del sys.modules[spec.name]
        raise InputError(
            f"{path} does not load, line {_line_in(path, error)}: {type(error).__name__}: {error}",
            code="unknown_part",
            hint=f"mend it there; `python {path}` shows all of it",
        ) from error
    return module


def _line_in(path: Path, error: Exception) -> int:
    """The last line of the user's file in the traceback."""
    if isinstance(error, SyntaxError) and error.filename == str(path):
        return error.lineno or 1
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    return (lines[-1] if lines else None) or 1
