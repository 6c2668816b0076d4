"""Values of an export, made from a bench of a few seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.bench.tiny import write_bench
from tunefree_hil.jobs.export.values import ExportValues, collect_values

PREVIEW = '[controller]\nlateral = "lqr_preview"\nlongitudinal = "pid_preview"\ninner = "mrac_robust"\n'


def make_values(folder: Path, more: str = "", **chosen: float) -> ExportValues:
    """The bench's own values, `chosen` in their place (names with _ for the first dot)."""
    source = collect_values(write_bench(folder, more=more), None)
    changes = {name.replace("__", "."): value for name, value in chosen.items()}
    assert set(changes) <= set(source.values)
    return source._replace(values={**source.values, **changes})


def texts(export: Any) -> dict[str, str]:
    """Text of each file by name."""
    return {file.name: file.text for file in export.files}
