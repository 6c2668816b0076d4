"""Options of the commands that learn from logs: `calibrate`, `learn`, `map`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

DEFAULT_SEED = 1


class CalibrateOptions(NamedTuple):
    """Options of `calibrate`. seed: of the choice of the held-out parts."""

    logs: Sequence[Path]
    vehicle: str
    out: Path
    seed: int = DEFAULT_SEED


class LearnOptions(NamedTuple):
    """Options of `learn`.

    Attributes:
        minutes: Approximate training time; None for the default number of steps.
        physics: Calibrated model folder; None to calibrate first, in a folder beside `out`.
        sample_spacing_s: Time between samples, of kind paper.
    """

    logs: Sequence[Path]
    vehicle: str
    out: Path
    kind: str = "hybrid"
    seed: int = DEFAULT_SEED
    minutes: float | None = None
    physics: Path | None = None
    sample_spacing_s: float = 0.01


class MapOptions(NamedTuple):
    """Options of `map`. out: a file ending in .npz, or a folder; a model folder gets the map that it is driven with."""

    logs: Sequence[Path]
    vehicle: str
    out: Path
    seed: int = DEFAULT_SEED
