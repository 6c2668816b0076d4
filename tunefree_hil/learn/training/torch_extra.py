"""The optional torch extra."""

from __future__ import annotations

import importlib

from tunefree_hil.base.errors import InputError


def require_torch(what: str = "learn") -> None:
    """Raise InputError where torch cannot be imported. what: the command that needs it."""
    try:
        importlib.import_module("torch")
    except ImportError as error:
        raise InputError(
            f"{what} needs torch, which is not installed here ({error})",
            code="no_torch",
            key="torch",
            hint="pip install '.[learn]' in the project's folder; all other commands work without",
        ) from error
