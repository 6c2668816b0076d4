"""The command of a Python process of the package, which ignores modules in the working folder."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]  # the folder of the package


def own_python(module: str, *words: str) -> list[str]:
    """`python -m module words`, without the working folder in the module path.

    With it, a `can.py` or a `signal.py` of the user would hide the library's, and a second checkout the installed
    package. In the checkout of this package it is kept, as the package need not be installed there.
    """
    return [sys.executable, *([] if _in_checkout() else ["-P"]), "-m", module, *words]


def _in_checkout() -> bool:
    try:
        return Path.cwd() == ROOT
    except FileNotFoundError:  # the working folder was removed
        return False
