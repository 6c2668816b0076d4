"""Specs and results back to plain data and TOML."""

from __future__ import annotations

from typing import Any

import msgspec
import tomli_w


def plain(spec: Any) -> Any:
    """A spec, or a list of specs, as dicts and lists; values that were left out (None, empty tables) are left out."""
    return _without_none(msgspec.to_builtins(spec))


def to_toml(data: dict[str, Any]) -> str:
    """Plain data as TOML text."""
    return tomli_w.dumps(data)


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(one) for key, one in value.items() if one is not None and one != {}}
    if isinstance(value, list):
        return [_without_none(one) for one in value]
    return value
