"""Calibrates a model on logs: by-wire actuators and physical constants, each with an interval, in a model folder.

No torch. What the logs cannot show keeps the data sheet's value, widened, and is said.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tunefree_hil.base.events import Event
from tunefree_hil.jobs.gap.calibration_logs import ask_own_logs, were_asked
from tunefree_hil.jobs.learn.calibration import STOPPED, Fitted, card_of, fit_all, said_of, split_of, write
from tunefree_hil.jobs.learn.logs import read
from tunefree_hil.jobs.learn.report_text import SEED, again, channel_words, closing
from tunefree_hil.learn.compiled_process import Worker
from tunefree_hil.learn.drives.drive import Drive, Split
from tunefree_hil.learn.drives.road_slope import offset_words
from tunefree_hil.learn.model_folder import require_new

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

Made = tuple[Fitted, Split]
FIGURES = "figures"
# What is too little to learn from may be enough to calibrate a channel: the fit itself says what it lacks.
LACKING = ("too_short", "one_speed", "no_braking", *STOPPED)


def calibrate(logs: Sequence[Path], vehicle: str, out: Path, seed: int = SEED) -> Iterator[Event]:
    """Fit and write `out`. seed: of the choice of what is held out. A model of these very logs that was cut off while
    it asked them is gone on with.

    Raises InputError for logs that cannot be used (another vehicle's, too short, no pairs of command and output,
    commands that never move), and for a folder that is there already.
    """
    from tunefree_hil.config.load import load_vehicle

    spec = load_vehicle(vehicle)
    if not said_of(out) or were_asked(out):
        require_new(out)
    drives = yield from read(logs, spec, excused=LACKING)
    made = None
    if not _is_left(out, spec, drives, seed):
        require_new(out)
        made = yield from _made(out, spec, drives, seed)
    goes_on = f"{out} is written; its own logs are asked now, and a later `gap` needs what they say"
    yield Event("note", goes_on, {"resume": again(logs, vehicle, out, seed)})
    if made is not None:
        draw(out / FIGURES, *made)
    yield from ask_own_logs(out, spec, drives)
    figures = [str(path) for path in sorted((out / FIGURES).glob("*.png"))]
    card = said_of(out)
    yield Event("result", "", {**card, "model": str(out), "figures": figures, **closing(out, spec, logs, card)})


def _is_left(out: Path, vehicle: VehicleSpec, drives: Sequence[Drive], seed: int) -> bool:
    """Whether a folder is what a calibration of these very logs was cut off at."""
    card = said_of(out)
    if not card or were_asked(out):
        return False
    same = [one["hash"] for one in card["logs"]] == [one.log_hash for one in drives]
    return same and (card["vehicle_hash"], card["seed"]) == (f"sha256:{vehicle.hash}", seed)


def _made(out: Path, spec: VehicleSpec, drives: Sequence[Drive], seed: int) -> Generator[Event, None, Made]:
    """Write the model folder, its own logs not asked yet; what its pictures are drawn of."""
    began = time.monotonic()
    split = yield from split_of(drives, seed)
    for words in offset_words(drives, spec):
        yield Event("warning", words)
    with Worker() as worker:
        fitted = yield from fit_all(worker, split, spec)
    seconds = time.monotonic() - began
    write(out, spec, fitted, split, card_of(drives, split, spec, fitted, seed, seconds))
    return fitted, split


def draw(folder: Path, fitted: Fitted, split: Split) -> list[Path]:
    """Both pictures."""
    from tunefree_hil.figures.learning.calibrate import Channel, Growth, Stretch, write_channels, write_growth
    from tunefree_hil.learn.physics.windows import TARGETS

    channels = [
        Channel(name, channel_words(name, found).partition(": ")[2], [Stretch(*one) for one in fitted.traces[name]])
        for name, found in fitted.actuators.items()
    ]
    part = "held-out parts" if split.held_out else "the logs"
    paths = [write_channels(folder / "actuators.png", channels, f"By-wire actuators on {part}")]
    judged = fitted.judged
    if judged is not None:
        growth = Growth(
            judged.time_s,
            {name: judged.before_at[:, i] for i, name in enumerate(TARGETS) if name in judged.before},
            {name: judged.after_at[:, i] for i, name in enumerate(TARGETS) if name in judged.after},
            judged.windows,
        )
        title = f"Free runs on {judged.windows} windows that no fit has seen (RMS), recorded actuator outputs in"
        paths.append(write_growth(folder / "free_run.png", growth, title))
    return paths
