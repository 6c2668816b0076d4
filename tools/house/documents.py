"""Words of README and docs, and references to documents that a reader of the repository cannot open."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

_ABSENT = re.compile(
    r"\binterfaces,? \d|\bdesign,? D\d"
    r"|\b(?:apollo_facts|can_hil_anchors|style_anchors|gap_anchors|opt_anchors|requirements_anchors)\b"
)


def absent_references(text: str) -> list[tuple[int, str]]:
    """(line, reference) of each mention of a working document that is not in the repository."""
    return [(number, found[0]) for number, line in enumerate(text.splitlines(), 1) for found in _ABSENT.finditer(line)]


def count_words(paths: Iterable[Path]) -> int:
    """Words of several text files, as `wc -w` counts them."""
    return sum(len(path.read_text(encoding="utf-8").split()) for path in paths)
