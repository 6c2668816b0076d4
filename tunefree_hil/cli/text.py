"""Numbers of a running job as words: pure functions, one line each, made for 80 columns."""

from __future__ import annotations

import math
import os
import shlex
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

PROGRAM = "tunefree-hil"


def duration(seconds: float) -> str:
    """8 -> '8 s', 130 -> '2 min 10 s', 7500 -> '2 h 5 min'."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def number(data: Mapping[str, Any], key: str) -> float | None:
    """data[key] as a finite float, or None: what is not known is not shown."""
    value = data.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def counted(data: Mapping[str, Any]) -> str:
    """How far it is: 'trial 12/40'."""
    done, total = number(data, "done"), number(data, "total")
    label = str(data.get("label", "") or "")
    if done is None:
        return label
    count = f"{done:.0f}" if total is None else f"{done:.0f}/{total:.0f}"
    return f"{label} {count}".strip()


def time_left(data: Mapping[str, Any]) -> str:
    """'2 min 10 s left', or nothing."""
    eta_s = number(data, "eta_s")
    return "" if eta_s is None else f"{duration(eta_s)} left"


def scores(data: Mapping[str, Any]) -> str:
    """The best against the manual baseline: 'best 0.412, manual 0.655 (-37 %)'."""
    best, manual = number(data, "best"), number(data, "manual")
    parts = [f"best {best:.4g}"] if best is not None else []
    if manual is not None:
        change = f" ({100.0 * (best / manual - 1.0):+.0f} %)" if best is not None and manual > 0.0 else ""
        parts.append(f"manual {manual:.4g}{change}")
    return ", ".join(parts)


def pace(data: Mapping[str, Any]) -> str:
    """'12.3 x real time, 4,300 frames/s'."""
    speed, frames = number(data, "speed_x"), number(data, "frames_per_s")
    parts = [f"{speed:.3g} x real time"] if speed is not None else []
    if frames is not None:
        parts.append(f"{frames:,.0f} frames/s")
    return ", ".join(parts)


def progress_line(message: str, data: Mapping[str, Any]) -> str:
    """All of it on one line, for --plain and for logs."""
    parts = [counted(data), message, scores(data), pace(data), time_left(data)]
    return "; ".join(part for part in parts if part)


def pasteable(command: str) -> str:
    """A next command such that it works as pasted: a program of our own environment, not on PATH, gets its path."""
    first, _, rest = command.partition(" ")
    if shutil.which(first):
        return command
    beside = Path(sys.executable).parent / first
    if beside.is_file():
        return f"{shlex.quote(_short(beside))} {rest}".rstrip()
    if first == PROGRAM:
        return f"{shlex.quote(_short(Path(sys.executable)))} -m tunefree_hil {rest}".rstrip()
    return command


def _short(path: Path) -> str:
    """Relative to the current folder where it lies inside."""
    here = Path(os.getcwd())
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)
