"""What the checks of the TOML files yield."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple


class ConfigProblem(NamedTuple):
    """A value that does not fit: its key in the file, what is wrong, and what to write instead."""

    key: str
    message: str
    hint: str


Problems = Iterator[ConfigProblem]
