"""What `drive` and `tune` say of the model before they drive it: its kind, and of a learned one what its card says."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tunefree_hil.config.schema import ModelSpec

AFTER_S = "10"


def model_words(model: ModelSpec) -> str:
    """'model mkz_learned: hybrid, from 29 min of logs; after 10 s of free run 0.6 m off ...'; one line.

    A model without a card, which nobody learned, has its kind only.
    """
    words = f"model {Path(model.folder).name}: {model.plant.kind}"
    path = Path(model.folder) / (model.plant.card or "")
    if not model.plant.card or not path.is_file():
        return words
    try:
        card = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        return f"{words}; its {path.name} cannot be read ({error})"
    if not isinstance(card, dict):
        return f"{words}; its {path.name} holds no table"
    minutes = sum(float(one["seconds"]) for one in card.get("logs") or []) / 60.0
    words += f", learned from {minutes:.0f} min of logs" if minutes else ""
    off_m = off_after(card)
    if off_m is not None:
        words += f"; {off_m:.1f} m off after {AFTER_S} s of free run where it was not trained"
    return words


def off_after(card: Mapping[str, Any]) -> float | None:
    """Mean position error after 10 s of free run on held-out level ground, m; None where the card does not say."""
    found: Any = card.get("free_run")
    for key in (card.get("kind"), "level", AFTER_S, "position_m", "mean"):
        found = found.get(key) if isinstance(found, Mapping) else None
    return float(found) if isinstance(found, int | float) and math.isfinite(found) else None
