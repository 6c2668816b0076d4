"""The interpreter's command of a process of ours: it runs the code of whoever starts it, wherever it is started."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]  # the folder that the package lies in


def own_python(module: str, *words: str) -> list[str]:
    """`python -m module words`, without the working folder among the places of modules.

    `-m` alone would take a `can.py` or a `signal.py` of a person's folder for the library's, and a second checkout's
    package for ours. In a checkout's own folder it stays: there the package need not be installed.
    """
    apart = [] if Path.cwd() == ROOT else ["-P"]
    return [sys.executable, *apart, "-m", module, *words]
