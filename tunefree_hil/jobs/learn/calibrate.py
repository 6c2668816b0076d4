"""Calibrates a model on logs: by-wire actuators and physical constants, each with an interval, in a model folder.

A parameter that the logs do not identify keeps the value of the data sheet with a wider interval, and is reported.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tunefree_hil.base.events import Event
from tunefree_hil.jobs.command_text import changed_options, shell_command
from tunefree_hil.jobs.gap.calibration_logs import analyse_calibration_logs, is_analysed
from tunefree_hil.jobs.learn.calibration import (
    SHORT_STEERING,
    CalibrationFit,
    calibrate_into,
    has_same_logs,
    read_calibration_card,
    split_drives_for_fit,
)
from tunefree_hil.jobs.learn.logs import read_logs
from tunefree_hil.jobs.learn.options import CalibrateOptions
from tunefree_hil.jobs.learn.report_text import describe_channel, summarise_calibration
from tunefree_hil.jobs.learn.steering import learn_steering_of_folder
from tunefree_hil.learn.drives.drive import Drive, DriveSplit
from tunefree_hil.learn.model_folder import require_new_folder

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

FitAndSplit = tuple[CalibrationFit, DriveSplit]
FIGURES = "figures"
# Logs that are too little to learn from may be enough to calibrate a channel; the fit reports what they lack.
TOLERATED = ("too_short", "one_speed", "no_braking", *SHORT_STEERING)


def calibrate(options: CalibrateOptions) -> Iterator[Event]:
    """Fit and write `options.out`, or continue a run on the same logs that was interrupted in their analysis.

    Raises:
        InputError: The logs cannot be used (another vehicle, too short, no pairs of command and output, commands that
            never move), or the folder is there already.
    """
    from tunefree_hil.config.load import load_vehicle

    out, vehicle = options.out, load_vehicle(options.vehicle)
    if not read_calibration_card(out) or is_analysed(out):
        require_new_folder(out)
    drives = yield from read_logs(options.logs, vehicle, tolerated=TOLERATED)
    fit_and_split = None
    if not _is_interrupted(out, vehicle, drives, options.seed):
        require_new_folder(out)
        fit_and_split = yield from _fit_and_write(out, vehicle, drives, options.seed)
    yield from learn_steering_of_folder(out, vehicle, drives)
    text = f"{out} is written; its calibration logs are analysed next, for a later `gap`"
    yield Event("note", text, {"resume": build_command(options)})
    if fit_and_split is not None:
        draw_figures(out / FIGURES, *fit_and_split)
    yield from analyse_calibration_logs(out, vehicle, drives)
    figures = [str(path) for path in sorted((out / FIGURES).glob("*.png"))]
    card = read_calibration_card(out)
    summary = summarise_calibration(out, vehicle, options.logs, card)
    yield Event("result", "", {**card, "model": str(out), "figures": figures, **summary})


def build_command(options: CalibrateOptions) -> str:
    """The same command again."""
    return shell_command("calibrate", *options.logs, **changed_options(options, ["logs"]))


def _is_interrupted(out: Path, vehicle: VehicleSpec, drives: Sequence[Drive], seed: int) -> bool:
    """Whether a folder is left by an interrupted calibration on the same logs."""
    card = read_calibration_card(out)
    if not card or is_analysed(out):
        return False
    return has_same_logs(card, drives) and (card["vehicle_hash"], card["seed"]) == (f"sha256:{vehicle.hash}", seed)


def _fit_and_write(
    out: Path, spec: VehicleSpec, drives: Sequence[Drive], seed: int
) -> Generator[Event, None, FitAndSplit]:
    """Write the model folder; its calibration logs are analysed later."""
    split = yield from split_drives_for_fit(drives, spec, seed)
    fitted = yield from calibrate_into(out, spec, drives, split, seed)
    return fitted, split


def draw_figures(folder: Path, fitted: CalibrationFit, split: DriveSplit) -> list[Path]:
    """Draw the actuators, and the growth of the free-run error where parts were held out."""
    from tunefree_hil.figures.learning.calibrate import (
        ChannelFit,
        ChannelTrace,
        ErrorGrowth,
        draw_channels,
        draw_growth,
    )
    from tunefree_hil.figures.style import save
    from tunefree_hil.learn.physics.windows import TARGETS

    channels = [
        ChannelFit(name, describe_channel(fit), [ChannelTrace(*trace) for trace in fitted.traces[name]])
        for name, fit in fitted.actuators.items()
    ]
    part = "held-out parts" if split.held_out else "the logs"
    paths = [save(draw_channels(channels, f"By-wire actuators on {part}"), folder / "actuators.png")]
    evaluation = fitted.evaluation
    if evaluation is not None:
        growth = ErrorGrowth(
            evaluation.time_s,
            {name: evaluation.before_by_time[:, i] for i, name in enumerate(TARGETS) if name in evaluation.before},
            {name: evaluation.after_by_time[:, i] for i, name in enumerate(TARGETS) if name in evaluation.after},
            evaluation.n_windows,
        )
        title = f"Free runs on {evaluation.n_windows} held-out windows (RMS), recorded actuator outputs in"
        paths.append(save(draw_growth(growth, title), folder / "free_run.png"))
    return paths
