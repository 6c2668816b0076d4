"""How long a person waits for the first word of the command line."""

from __future__ import annotations

import subprocess
import sys
import time
from typing import Any

from tools.measures._summary import summary

VALUE = "s from starting `tunefree-hil` to its first visible line (median of runs)"


def measure(runs: int = 10) -> dict[str, Any]:
    """Start the program `runs` times and read its first line."""
    return summary([_first_line_s() for _ in range(runs)], "s", {"python": sys.version.split()[0]})


def _first_line_s() -> float:
    started = time.perf_counter()
    with subprocess.Popen([sys.executable, "-m", "tunefree_hil"], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        seconds = time.perf_counter() - started
        process.stdout.read()
    return seconds
