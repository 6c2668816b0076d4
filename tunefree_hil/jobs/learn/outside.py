"""Beside every result: how much of its drives lies outside the region that the model's data covered."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tunefree_hil.bench import Bench, model_of
from tunefree_hil.episode.recording import Recording
from tunefree_hil.episode.valid import Outside, outside, together


def outside_data(bench: Bench, model: str, drives: Mapping[str, Recording]) -> dict[str, Any]:
    """Plain data for a result: {"model", "share", "by", "drives"}; share None where the model names no region.

    share: of all ticks; by: the same by quantity of [valid]; drives: the share of each drive that leaves the region.
    """
    valid = model_of(bench, model).valid
    found = {name: outside(recording, valid) for name, recording in drives.items()}
    whole = together(found.values())
    if whole is None:
        return {"model": model, "share": None, "by": {}, "drives": {}}
    left = {name: one.share for name, one in found.items() if one is not None and one.share > 0.0}
    return {"model": model, "share": whole.share, "by": whole.by, "drives": left}


def outside_words(data: Mapping[str, Any]) -> str:
    """'0.0 % of its ticks outside the valid region of hybrid_1 ...'; '' where nothing is known."""
    if data["share"] is None:
        return ""
    by = ", ".join(f"{name} {_percent(share)}" for name, share in data["by"].items())
    where = f" ({by})" if by else ""
    return f"{_percent(data['share'])} of the ticks outside the valid region of model {data['model']}{where}"


def drive_warning(bench: Bench, model: str, name: str, recording: Recording) -> str:
    """The flag on one drive that leaves the region; '' for one that does not."""
    found: Outside | None = outside(recording, model_of(bench, model).valid)
    if found is None or found.share == 0.0:
        return ""
    by = ", ".join(f"{key} {_percent(share)}" for key, share in found.by.items())
    return f"{name}: {_percent(found.share)} of it is outside the region that the model's data covered ({by})"


def _percent(share: float) -> str:
    """'<0.1 %' where it is not quite nothing."""
    return "<0.1 %" if 0.0 < share < 0.0005 else f"{100.0 * share:.1f} %"
