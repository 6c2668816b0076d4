"""Options of the commands that learn from logs: `calibrate`, `learn`, `map`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

from tunefree_hil.jobs.options.option import LOGS, NEW_MODEL, VEHICLE, Argument, Option

DEFAULT_SEED = 1


class CalibrateOptions(NamedTuple):
    """Options of `calibrate`. seed: of the choice of the held-out parts."""

    logs: Annotated[Sequence[Path], LOGS]
    vehicle: Annotated[str, VEHICLE]
    out: Annotated[Path, NEW_MODEL]
    seed: Annotated[int, Option("of the choice of the held-out parts", minimum=0)] = DEFAULT_SEED


class LearnOptions(NamedTuple):
    """Options of `learn`.

    Attributes:
        minutes: Approximate training time; None for the default number of steps.
        physics: Calibrated model folder; None to calibrate first, in a folder beside `out`.
        sample_spacing_s: Time between samples, of kind paper.
    """

    logs: Annotated[Sequence[Path], LOGS]
    vehicle: Annotated[str, VEHICLE]
    out: Annotated[Path, NEW_MODEL]
    kind: Annotated[
        str,
        Option("hybrid: fitted physics with a small LSTM", choices=("hybrid", "lstm", "mlp", "rule_based", "paper")),
    ] = "hybrid"
    seed: Annotated[int, Option("of the net, its batches, and the held-out parts", minimum=0)] = DEFAULT_SEED
    minutes: Annotated[
        float | None, Option("approximate training time on a free core; sets the number of steps", minimum=0.01)
    ] = None
    physics: Annotated[Path | None, Option("model folder of calibrate; default: calibrate now, into OUT-physics")] = (
        None
    )
    sample_spacing_s: Annotated[
        float, Option("s between samples, kind paper", "--sample-spacing", minimum=0.01, maximum=0.5)
    ] = 0.01


class MapOptions(NamedTuple):
    """Options of `map`. out: a file ending in .npz, or a folder; a model folder gets the map that it is driven with."""

    logs: Annotated[Sequence[Path], Argument("logs of the vehicle, in any format", metavar="LOG...")]
    vehicle: Annotated[str, VEHICLE]
    out: Annotated[Path, Option("a file ending in .npz, or a folder (a model folder: its own map)")]
    seed: Annotated[int, Option("of the nets and the held-out cells", minimum=0)] = DEFAULT_SEED
