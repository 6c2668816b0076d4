"""Text of progress and results: pure functions, one line each, for 80 columns."""

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


def format_duration(seconds: float) -> str:
    """8 -> '8 s', 130 -> '2 min 10 s', 7500 -> '2 h 5 min'."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def finite_number(data: Mapping[str, Any], key: str) -> float | None:
    """data[key] as a finite float, or None."""
    value = data.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def count_text(data: Mapping[str, Any]) -> str:
    """'trial 12/40'."""
    done, total = finite_number(data, "done"), finite_number(data, "total")
    label = str(data.get("label", "") or "")
    if done is None:
        return label
    count = f"{done:.0f}" if total is None else f"{done:.0f}/{total:.0f}"
    return f"{label} {count}".strip()


def time_left_text(data: Mapping[str, Any]) -> str:
    """'2 min 10 s left', or '' without an estimate."""
    eta_s = finite_number(data, "eta_s")
    return "" if eta_s is None else f"{format_duration(eta_s)} left"


def scores_text(data: Mapping[str, Any]) -> str:
    """'best 0.412, manual 0.655 (-37 %)'."""
    best, manual = finite_number(data, "best"), finite_number(data, "manual")
    parts = [f"best {best:.4g}"] if best is not None else []
    if manual is not None:
        change = f" ({100.0 * (best / manual - 1.0):+.0f} %)" if best is not None and manual > 0.0 else ""
        parts.append(f"manual {manual:.4g}{change}")
    return ", ".join(parts)


def pace_text(data: Mapping[str, Any]) -> str:
    """'12.3 x real time, 4,300 frames/s'."""
    speed, frames = finite_number(data, "speed_x"), finite_number(data, "frames_per_s")
    parts = [f"{speed:.3g} x real time"] if speed is not None else []
    if frames is not None:
        parts.append(f"{frames:,.0f} frames/s")
    return ", ".join(parts)


def format_progress(message: str, data: Mapping[str, Any]) -> str:
    """All of it on one line, for --plain and for logs."""
    parts = [count_text(data), message, scores_text(data), pace_text(data), time_left_text(data)]
    return "; ".join(part for part in parts if part)


def make_pasteable(command: str) -> str:
    """A command that works when pasted: with its path where the program is in our environment but not on PATH."""
    first, _, rest = command.partition(" ")
    if shutil.which(first):
        return command
    beside = Path(sys.executable).parent / first
    if beside.is_file():
        return f"{shlex.quote(_relative_path(beside))} {rest}".rstrip()
    if first == PROGRAM:
        return f"{shlex.quote(_relative_path(Path(sys.executable)))} -m tunefree_hil {rest}".rstrip()
    return command


def _relative_path(path: Path) -> str:
    """Relative to the current folder where it is inside."""
    current = Path(os.getcwd())
    return str(path.relative_to(current)) if path.is_relative_to(current) else str(path)
