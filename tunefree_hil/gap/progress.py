"""The stages of a search, as it yields them."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class SearchStage(Enum):
    """The value is the share of a search's time that is over as the stage begins."""

    RECALIBRATION = 0.0
    CANDIDATES = 0.24
    FURTHER_EFFECTS = 0.86
    ELIMINATION = 0.94
    REMAINDER = 0.97


class SearchProgress(NamedTuple):
    """What a search is doing now."""

    stage: SearchStage
    text: str
