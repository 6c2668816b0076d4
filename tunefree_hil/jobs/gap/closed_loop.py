"""Closed loop: repeats the drive of a log on the original, the recalibrated and the repaired model.

Only a log in a run folder (docs/reference/files.md) names the controller that drove it; a drive of a person or of a
foreign program cannot be repeated. A difference is the RMS of simulated minus measured values, over the rows that the
measured drive and the drives on all models have. A drive that ends early is a result, and is reported.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Generator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.gap.validation.repair import write_repaired_model
from tunefree_hil.jobs.gap.report_text import join_names

if TYPE_CHECKING:
    from tunefree_hil.bench.simulator import SimulatedDrive
    from tunefree_hil.jobs.gap.options import GapInputs
    from tunefree_hil.jobs.gap.repair import RepairOutcome

SIGNALS = {  # columns of a recording that show the tracking, with their units
    "lateral_error_m": "m",
    "heading_error_rad": "rad",
    "station_error_m": "m",
    "speed_error_mps": "m/s",
    "out_steer_rad": "rad",
    "speed_mps": "m/s",
    "yaw_rate_radps": "rad/s",
}
TRACKING = tuple(SIGNALS)[:4]
NO_DIFFERENCE = 1e-3  # of a signal's RMS in the measured drive; a smaller difference counts as none
MEASURED = "measured"
VARIANT_TEXTS = {
    MEASURED: "as measured",
    "before": "on the original model",
    "recalibrated": "with recalibration only",
    "after": "on the repaired model",
}
DRIVE_KEY = "drive"  # value of `worst` for a drive that fails
MIN_DRIVE_S = 1.0  # a drive that ends sooner on every model was not driven, unless the vehicle failed
VERIFY_FOLDER = "verify"  # folder of a tune's run with the drives on the vehicle
UNKNOWN_CONTROLLER = "the controller that drove this is unknown, as the log is not in a run folder"


class SquareSum(NamedTuple):
    """Sum of squares over rows, of a measured signal or of a simulated drive's difference from it."""

    squares: float
    rows: int


class DriveEnd(NamedTuple):
    """How far a drive came. error: what ended it early, '' for nothing."""

    log: str
    ticks: int
    dt_s: float
    error: str = ""


SignalSums = dict[str, dict[str, list[SquareSum]]]  # by signal and variant (or MEASURED), one for each drive
DriveEnds = Mapping[str, DriveEnd]  # of one log, by variant (or MEASURED)


def replay_drives(
    logs: Sequence[Path], inputs: GapInputs, outcome: RepairOutcome
) -> Generator[Event, None, tuple[dict[str, Any] | None, str]]:
    """Repeat the drives of all logs that lie in run folders.

    Returns:
        `closed_loop` of gap.json (None where nothing could be repeated), and the reason where there is none.
    """
    run_logs = [log for log in logs if _find_run_folder(log) is not None]
    if outcome.model is None or not run_logs:
        return None, "" if outcome.model is None else UNKNOWN_CONTROLLER
    sums: SignalSums = {}
    ends: list[DriveEnds] = []
    with tempfile.TemporaryDirectory(prefix="tunefree-gap-") as scratch:
        folder = Path(scratch) / "recalibrated"
        recalibrated = write_repaired_model(folder, inputs.model, outcome.recalibrated.model, {})
        models = {"before": inputs.model.folder, "recalibrated": recalibrated.folder, "after": outcome.model.folder}
        for log in run_logs:
            yield Event("note", f"closed loop: {log}")
            try:
                drives = _drive_again(log, models)
            except InputError as error:
                return None, f"{log} cannot be driven again: {error.message}"
            _add_signals(sums, drives)
            ends.append(
                {key: DriveEnd(str(log), one.ticks, one.recording.dt_s, one.error) for key, one in drives.items()}
            )
    result = compare_drives(sums, len(run_logs), ends)
    if _failure_growth(ends) > 0.0:
        yield Event("warning", f"closed loop: {result['words']}")
    return result, ""


def _find_run_folder(log: Path) -> Path | None:
    """The run folder that a log lies in: RUN/episodes/K/vehicle.log, or RUN/verify/episodes/K/vehicle.log of a tune,
    whose bench file both were driven with.
    """
    folder = log.resolve().parent
    if folder.parent.name != "episodes" or not (folder / "episode.json").is_file():
        return None
    run = folder.parent.parent
    run = run.parent if run.name == VERIFY_FOLDER and not (run / "run.json").is_file() else run
    return run if (run / "run.json").is_file() and (run / "bench.toml").is_file() else None


def _drive_again(log: Path, models: Mapping[str, str]) -> dict[str, SimulatedDrive]:
    """The measured drive, and the same on all models.

    The [[effects]] of the bench file are left out: the measured vehicle had them, and they are what is looked for.

    Raises:
        InputError: The drive cannot be simulated.
    """
    from tunefree_hil.bench import load
    from tunefree_hil.bench.simulator import Job, SimulatedDrive, Simulator
    from tunefree_hil.episode.recording import load_recording
    from tunefree_hil.grade.score import DIVERGED, LEFT_LANE
    from tunefree_hil.jobs.drive import find_scenario
    from tunefree_hil.jobs.run_folder import JOINED, open_run, read_json
    from tunefree_hil.jobs.tune.margins import find_batch_obstacle

    folder = _find_run_folder(log)
    assert folder is not None
    run = open_run(folder)
    bench = load(run.bench_file())
    if reason := find_batch_obstacle(bench, run.record.get(JOINED)):
        raise InputError(reason, code="not_in_batch")
    spec = bench.spec
    bare = type(spec)(**{name: getattr(spec, name) for name in spec.__struct_fields__ if name != "effects"})
    episode = read_json(log.parent / "episode.json")
    job = Job(episode["parameters"], find_scenario(bench, episode["scenario"]), episode["seed"])
    measured = load_recording(log.parent / "columns.npz")
    drives = {name: Simulator(replace(bench, spec=bare), model).drive(job) for name, model in models.items()}
    vehicle_ends = ("", LEFT_LANE, DIVERGED)
    if all(one.error not in vehicle_ends and one.ticks * bench.dt_s < MIN_DRIVE_S for one in drives.values()):
        errors = join_names(sorted({one.error for one in drives.values()}))
        raise InputError(f"no model drives for {MIN_DRIVE_S:g} s, the drives end with {errors}", code="not_driven")
    return {MEASURED: SimulatedDrive(measured, measured.ticks, name_end(episode["error_code"])), **drives}


def name_end(error_code: int) -> str:
    """What ended a drive, as a simulated drive says it: '' for nothing, one name for all of a user's controller."""
    from tunefree_hil.bus.bench_channel import ErrorCode

    error = ErrorCode(error_code)
    return "" if error is ErrorCode.NONE else error.name.lower()


def _add_signals(sums: SignalSums, drives: Mapping[str, SimulatedDrive]) -> None:
    """Add the signals of one log, over the rows that all its drives have."""
    import numpy as np

    from tunefree_hil.learn.evaluation.motion import wrap_angle

    rows = min(one.recording.ticks for one in drives.values())
    for signal in SIGNALS:
        recorded = {key: one.recording.get(signal) for key, one in drives.items()}
        values_by_key = {key: values[:rows] for key, values in recorded.items() if values is not None}
        if len(values_by_key) < len(recorded):
            continue
        is_finite = np.logical_and.reduce([np.isfinite(values) for values in values_by_key.values()])
        if not is_finite.any():
            continue
        measured = values_by_key.pop(MEASURED)
        differences = {key: values - measured for key, values in values_by_key.items()}
        if signal == "heading_error_rad":
            differences = {key: wrap_angle(values) for key, values in differences.items()}
        for key, values in {MEASURED: measured, **differences}.items():
            sums.setdefault(signal, {}).setdefault(key, []).append(_sum_squares(values[is_finite]))


def _sum_squares(values: Any) -> SquareSum:
    return SquareSum(float(values @ values), len(values))


def compare_drives(
    sums: Mapping[str, Mapping[str, Sequence[SquareSum]]], n_drives: int, ends: Sequence[DriveEnds] = ()
) -> dict[str, Any]:
    """`closed_loop` of gap.json.

    The four tracking errors are combined in units of their measured RMS, with squares summed before they are compared:
    an error that was close to none before then counts next to nothing.

    Returns:
        Among others `down_frac`, the share by which the tracking's difference from the measured drive shrinks, and
        `worst_frac`, the share by which the worst signal (or the failure of a drive) grows.
    """
    signals = {
        name: {"unit": SIGNALS[name], **{key: _rms(values) for key, values in by_key.items()}}
        for name, by_key in sums.items()
    }
    result: dict[str, Any] = {"signals": signals, "drives": n_drives, "ended": _list_early_ends(ends)}
    tracking = [signal for name in TRACKING if (signal := signals.get(name)) and signal[MEASURED] > 0.0]
    before, after = (sum((signal[key] / signal[MEASURED]) ** 2 for signal in tracking) for key in ("before", "after"))
    growths = {name: growth for name, signal in signals.items() if (growth := _relative_growth(signal)) is not None}
    has_no_difference, failure = before <= NO_DIFFERENCE**2 * len(tracking), _failure_growth(ends)
    if failure > 0.0:
        growths[DRIVE_KEY] = failure
    if not growths or (has_no_difference and DRIVE_KEY not in growths):
        text = "no difference" + _describe_early_ends(result["ended"], ends)
        return {**result, "down_frac": None, "worst_frac": None, "words": text}
    down = None if has_no_difference else 1.0 - math.sqrt(after / before)
    worst = max(growths, key=lambda name: growths[name])
    text = _describe_comparison(down, growths, worst) + _describe_early_ends(result["ended"], ends)
    return {**result, "down_frac": down, "worst_frac": growths[worst], "worst": worst, "words": text}


def _describe_comparison(down: float | None, growths: Mapping[str, float], worst: str) -> str:
    text = "the tracking's difference from the measured drive "
    text += "is none in the rows that all drives have" if down is None else f"is {_format_change(-down)}"
    if DRIVE_KEY in growths:
        text += ", and the repaired model fails where the measured vehicle did not"
    if worst != DRIVE_KEY:
        text += f", {worst} {'is ' if growths[worst] > 0.0 else 'least, '}{_format_change(growths[worst])}"
    return text


def _list_early_ends(ends: Sequence[DriveEnds]) -> dict[str, list[dict[str, Any]]]:
    """The drives that ended early, by variant (or MEASURED); variants without any are left out."""
    early = {
        key: [
            {"log": end.log, "how": end.error, "t_s": round(end.ticks * end.dt_s, 6)}
            for end in (by_key[key] for by_key in ends)
            if end.error
        ]
        for key in VARIANT_TEXTS
    }
    return {key: entries for key, entries in early.items() if entries}


def _describe_early_ends(early: Mapping[str, Sequence[Mapping[str, Any]]], ends: Sequence[DriveEnds]) -> str:
    """The early ends as text, with the share of the measured rows that was compared."""
    texts = []
    for key, entries in early.items():
        first = min(entries, key=lambda entry: entry["t_s"])
        count = f"{len(entries)} of {len(ends)} drives, first " if len(ends) > 1 else ""
        texts.append(f"{VARIANT_TEXTS[key]} ({count}{first['how']} after {first['t_s']:.4g} s)")
    if not texts:
        return ""
    compared = sum(min(end.ticks for end in by_key.values()) for by_key in ends)
    share = compared / max(sum(by_key[MEASURED].ticks for by_key in ends), 1)
    rows = f"; compared are the rows that all have, {100.0 * share:.0f} % of the measured ones" if share < 1.0 else ""
    return f"; the drive ends early {join_names(texts)}{rows}"


def _failure_growth(ends: Sequence[DriveEnds]) -> float:
    """By how much more a drive fails on the repaired model than on the original, in the log in which it does most."""
    measures = [
        {key: _failure_measure(by_key[key], by_key[MEASURED]) for key in ("before", "after")} for by_key in ends
    ]
    return max((_relative_growth({MEASURED: 1.0, **measure}) or 0.0 for measure in measures), default=0.0)


def _failure_measure(end: DriveEnd, measured: DriveEnd) -> float:
    """0.0 for a drive that came to its end, or as far as a measured drive that ended early, or ended as that did;
    else 1.0 plus the share of the measured drive that it lacks.
    """
    lacks = max(0.0, 1.0 - end.ticks / max(measured.ticks, 1))
    if end.error in ("", measured.error) or (measured.error and lacks == 0.0):
        return 0.0
    return 1.0 + lacks


def _relative_growth(signal: Mapping[str, Any]) -> float | None:
    """By which share of itself a signal's difference grows; None where there is none before and after."""
    least = NO_DIFFERENCE * signal[MEASURED]
    if max(signal["before"], signal["after"]) <= least or signal["before"] == least == 0.0:
        return None
    return signal["after"] / max(signal["before"], least) - 1.0


def _format_change(growth: float) -> str:
    return f"{'up' if growth > 0.0 else 'down'} by {100.0 * abs(growth):.0f} %"


def _rms(sums: Sequence[SquareSum]) -> float:
    return math.sqrt(sum(one.squares for one in sums) / max(sum(one.rows for one in sums), 1))
