"""Results as JSON lines under runs/measures/<name>/, written as they come: a measure that was cut off goes on.

A line is found again by the hash of all that its result depends on: files of the bench, and the code that makes the
numbers. So a result never outlives a change, and nothing has to be thrown away by hand.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
FOLDER = "runs/measures"  # of the options of every measure that writes as it goes
FIGURES = "docs/figures"
# What a score depends on. The hub and the processes carry the frames, but cannot change what is in them.
COUNTED = (
    "base", "bus", "config", "control", "effects", "plant", "episode", "grade", "nodes", "bench", "tune",
    "jobs/running/episode_results.py",
)  # fmt: skip
CARRIERS = "bus/tfhub/"


class Ledger:
    """The lines of one measure. Each writer has its own file, all read all; a line cut off by a kill is dropped."""

    def __init__(self, folder: Path, writer: str = "main") -> None:
        self.folder = folder
        self.path = folder / f"{writer}.jsonl"
        folder.mkdir(parents=True, exist_ok=True)
        self._lines: dict[str, Any] = {}
        self.refresh()

    def refresh(self) -> None:
        """Read what other writers have written since."""
        for path in sorted(self.folder.glob("*.jsonl")):
            for line in path.read_bytes().split(b"\n")[:-1]:
                try:
                    entry = json.loads(line)
                except ValueError:  # the rest of a line that was cut off, and went on after a resume
                    continue
                self._lines[entry["key"]] = entry["result"]

    def find(self, depends: Mapping[str, Any]) -> Any:
        """The result that depends on exactly this, or None."""
        return self._lines.get(key_of(depends))

    def keep(self, depends: Mapping[str, Any], result: Any) -> Any:
        """Add a line, on disk before this returns; the result as it will be read again."""
        key = key_of(depends)
        line = json.dumps({"key": key, "depends": dict(depends), "result": result}) + "\n"
        cut = self.path.is_file() and not self.path.read_bytes().endswith(b"\n") and self.path.stat().st_size > 0
        with self.path.open("ab") as file:
            file.write((b"\n" if cut else b"") + line.encode())
            file.flush()
            os.fsync(file.fileno())
        self._lines[key] = json.loads(line)["result"]
        return self._lines[key]


def key_of(depends: Mapping[str, Any]) -> str:
    """SHA-256 over plain data, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(depends, sort_keys=True).encode()).hexdigest()


@lru_cache(maxsize=1)
def code_hash() -> str:
    """SHA-256 over the code that makes a score; comments, docstrings and layout do not count."""
    digest = hashlib.sha256()
    package = ROOT / "tunefree_hil"
    for name in COUNTED:
        for path in sorted((package / name).rglob("*.py")) or [package / name]:
            place = path.relative_to(package).as_posix()
            if not place.startswith(CARRIERS):
                digest.update(place.encode() + meaning(path.read_text(encoding="utf-8")).encode())
    return digest.hexdigest()


def meaning(source: str) -> str:
    """A module without comments, docstrings and layout."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body = node.body[1:]
    return ast.dump(tree)
