"""The interpreter's command of a process of ours: what lies in a person's folder is not what it runs."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]  # the folder that the package lies in


def own_python(module: str, *words: str) -> list[str]:
    """`python -m module words`, without the working folder among the places of modules.

    `-m` alone would take a `can.py` or a `signal.py` of a person's folder for the library's, and a second checkout's
    package for the installed one. In our checkout's own folder it stays: there the package need not be installed.
    """
    return [sys.executable, *([] if _in_checkout() else ["-P"]), "-m", module, *words]


def _in_checkout() -> bool:
    try:
        return Path.cwd() == ROOT
    except FileNotFoundError:  # a folder that was removed under whoever works in it
        return False
