"""Calibrates a model on logs: by-wire actuators and physical constants, each with an interval, in a model folder.

No torch. What the logs cannot show keeps the data sheet's value, widened, and is said.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from tunefree_hil.base.events import Event
from tunefree_hil.jobs.gap.own_logs import ask_own_logs
from tunefree_hil.jobs.learn.calibrate_words import channel_words, closing
from tunefree_hil.jobs.learn.calibrated import STOPPED, Fitted, card_of, fit_all, split_of, write
from tunefree_hil.jobs.learn.logs import read
from tunefree_hil.learn.drives import Split
from tunefree_hil.learn.level import offset_words
from tunefree_hil.learn.worker import Worker
from tunefree_hil.learn.write_model import require_new

FIGURES = "figures"
# What is too little to learn from may be enough to calibrate a channel: the fit itself says what it lacks.
LACKING = ("too_short", "one_speed", "no_braking", *STOPPED)


def calibrate(logs: Sequence[Path], vehicle: str, out: Path, seed: int = 1) -> Iterator[Event]:
    """Fit and write `out`. seed: of the choice of what is held out.

    Raises InputError for logs that cannot be used (another vehicle's, too short, no pairs of command and output,
    commands that never move), and for a folder that is there already.
    """
    from tunefree_hil.config.load import load_vehicle

    spec = load_vehicle(vehicle)
    require_new(out)
    began = time.monotonic()
    drives = yield from read(logs, spec, excused=LACKING)
    split = yield from split_of(drives, seed)
    for words in offset_words(drives, spec):
        yield Event("warning", words)
    with Worker() as worker:
        fitted = yield from fit_all(worker, split, spec)
    seconds = time.monotonic() - began
    card = card_of(drives, split, spec, fitted, seed, seconds)
    write(out, spec, fitted, split, card)
    figures = draw(out / FIGURES, fitted, split)
    yield from ask_own_logs(out, spec, drives)
    data = {**card, "model": str(out), "figures": [str(path) for path in figures]}
    yield Event("result", "", {**data, **closing(out, spec, logs, fitted.actuators, fitted.physics, fitted.judged)})


def draw(folder: Path, fitted: Fitted, split: Split) -> list[Path]:
    """Both pictures."""
    from tunefree_hil.figures.calibrate import Channel, Growth, Stretch, write_channels, write_growth
    from tunefree_hil.learn.windows import TARGETS

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
