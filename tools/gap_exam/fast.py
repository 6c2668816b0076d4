"""The compiler of this package's loops; machine code is kept on disk under a hash of the package's own files.

numba's cache does not see that a function of another file has changed, so each state of the files has a folder of its
own. GAP_EXAM_CACHE moves it. GAP_EXAM_JIT=0 leaves the functions as they are (a node of a bench).
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent


def source_hash() -> str:
    """SHA-256 over the names and bytes of the package's Python files."""
    digest = hashlib.sha256()
    for path in sorted(FOLDER.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _cache() -> str:
    root = Path(os.environ.get("GAP_EXAM_CACHE", Path.home() / ".cache" / "gap_exam"))
    return str(root / f"{source_hash()[:16]}-{metadata.version('numba')}")


JIT = os.environ.get("GAP_EXAM_JIT", "1") != "0"
_CACHE = _cache() if JIT else ""


def fast(function: Callable[..., Any]) -> Any:
    """The function, compiled where it is first called and kept for the next process."""
    if not JIT:
        return function
    import numba

    config: Any = getattr(numba, "config")  # noqa: B009  (a module without stubs)
    before = config.CACHE_DIR
    config.CACHE_DIR = _CACHE  # read while the dispatcher is made; other users' caches stay where they are
    try:
        return numba.njit(cache=True, error_model="numpy")(function)
    finally:
        config.CACHE_DIR = before
