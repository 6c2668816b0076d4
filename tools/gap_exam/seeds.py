"""Seeds by hashing: an exam's come from the frozen commit, those for development from a name; the two never meet.

Every seed is SHA-256 over its whole path ('exam', commit, 'vehicle', 3): another domain or another use is another
stream, so that development vehicles and exam vehicles are disjoint by construction.
"""

from __future__ import annotations

import hashlib
import re

import numpy as np

EXAM, DEVELOPMENT = "exam", "dev"


class Domain:
    """Where all chance of one exam comes from."""

    def __init__(self, kind: str, name: str) -> None:
        if kind == EXAM and not re.fullmatch(r"[0-9a-f]{40}", name):
            raise ValueError(f"an exam's seed is the frozen commit's 40 hex digits, not {name!r}")
        if kind == DEVELOPMENT and not re.fullmatch(r"[a-z][a-z0-9_]{0,19}", name):
            raise ValueError(f"a development exam has a short name of small letters, not {name!r}")
        if kind not in (EXAM, DEVELOPMENT):
            raise ValueError(f"there are domains {EXAM!r} and {DEVELOPMENT!r}, not {kind!r}")
        self.kind, self.name = kind, name

    def __str__(self) -> str:
        return f"{self.kind}:{self.name}"

    def seed(self, *path: object) -> int:
        """A seed of 62 bits for a use, by its path."""
        words = "\0".join(["gap exam", self.kind, self.name, *map(str, path)])
        return int.from_bytes(hashlib.sha256(words.encode()).digest()[:8], "big") >> 2

    def rng(self, *path: object) -> np.random.Generator:
        """A generator for a use, by its path."""
        return np.random.default_rng(self.seed(*path))


def domain_of(text: str) -> Domain:
    """'exam:COMMIT' or 'dev:NAME'."""
    kind, _, name = text.partition(":")
    return Domain(kind, name)
