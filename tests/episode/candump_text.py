"""Reads a candump log that a test wrote as text."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tunefree_hil.episode.candump import LogFrame, read_candump


def read_text(text: str, *, allow_cut: bool = False) -> list[LogFrame]:
    """`read_candump` of a file x.log that holds `text`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.log"
        path.write_bytes(text.encode("ascii"))
        return read_candump(path, allow_cut=allow_cut)
