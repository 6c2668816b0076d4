"""Grade a log of a vehicle against a reference path: the metrics by aspect, and a score for a complete drive."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import load
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.config.load import load_vehicle, load_weights
from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.episode.recording import Recording, save_recording
from tunefree_hil.grade.oscillation.report import OscillationReport, findings_as_data, oscillation_text
from tunefree_hil.grade.profile import (
    DriveExtras,
    MetricValue,
    ProfileSettings,
    find_drive_oscillations,
    find_steering_residual,
    profile_drive,
)
from tunefree_hil.grade.reference import ReferencePath, read_reference
from tunefree_hil.grade.score import (
    MAX_MISSING_TICKS,
    GradeVehicle,
    ScenarioEnd,
    ScenarioGrade,
    grade_drive,
    grade_vehicle_from_spec,
)
from tunefree_hil.grade.table import PUBLISHED, TABLE, names_by_aspect
from tunefree_hil.jobs.drive import DEFAULT_ROOT, find_scenario
from tunefree_hil.jobs.log.drive import (
    LogColumns,
    LogDrive,
    manual_driving_s,
    read_extras,
    read_log_drive,
    require_steady_clock,
)
from tunefree_hil.jobs.log.files import codec_for_log, load_log
from tunefree_hil.jobs.options.records import GradeOptions
from tunefree_hil.jobs.preconditions import require_number
from tunefree_hil.jobs.run_folder import RunFolder, read_json, write_json

SCHEMA = "tunefree.grade/1"
DEFAULT_WEIGHTS = "default"
MAX_START_S = 1e9  # thirty years; beyond the end of a log anyway
MIN_MANUAL_S = 0.5  # manual driving that is reported; the enable handshake at the start is shorter
AGGREGATION_TEXT = {"std": "RMS of ", "peak": "peak of ", "mean": "mean of ", "share": ""}  # before a metric's words


def grade_log(log: Path, options: GradeOptions) -> Iterator[Event]:
    """One line a metric on stdout; writes a run folder with columns, grade.json and figures."""
    require_number("--start-s", options.start_s, maximum=MAX_START_S, allow_zero=True)
    path = options.path or scenario_of_log(log)
    codec, where = codec_for_log(log, options.vehicle)
    yield Event("note", f"{log}, read as {where}")
    weighing, car = load_weights(options.weights or DEFAULT_WEIGHTS), grade_vehicle_from_spec(load_vehicle(where))
    reference = read_reference(path, codec.tick_ms * 1e-3, car.rear_axle_m)
    drive = yield from _read(log, codec, car, reference, options)
    extras = read_extras(log.parent)
    values = profile_drive(
        drive.recording,
        drive.course,
        car,
        ProfileSettings(weighing.against, weighing.as_published),
        extras,
    )
    oscillation = find_drive_oscillations(drive.recording, drive.course, car)
    yield from (Event("line", line) for line in (*metric_lines(values), *oscillation_lines(oscillation)))
    graded, score_text = _score(drive, weighing, car, reference.name, extras)
    record = {"command": "grade", "log": str(log), "vehicle": where, "path": path, "weights": weighing.name}
    run = RunFolder.create(options.out or DEFAULT_ROOT, f"grade-{log.stem}", record)
    data = {**_data(values, graded, reference, drive, weighing), "oscillation": findings_as_data(oscillation)}
    save_recording(drive.recording, run.episode(0) / "columns.npz")
    write_json(run.path / "grade.json", {"schema": SCHEMA, **data})
    figures = _figures(run, reference.name, drive, graded, values)
    figures += _oscillation_figure(run, reference.name, drive, car, oscillation)
    run.finish(score=data["score"])
    known = sum(values[name].value is not None for name in PUBLISHED)
    sentence = f"{known} of {len(PUBLISHED)} metrics available; {score_text}{oscillation_note(oscillation)}"
    yield Event("result", sentence, {"sentence": sentence, "run": str(run.path), "figures": figures, **data})


def _read(
    log: Path, codec: Codec, car: GradeVehicle, reference: ReferencePath, options: GradeOptions
) -> Generator[Event, None, LogDrive]:
    """Read the drive in a log; its notes are printed too."""
    read = load_log(log)
    if read.cut_warning:
        yield Event("warning", read.cut_warning)
    require_steady_clock(read.frames, log)
    columns = LogColumns(read.frames, codec, log.parent)
    drive = read_log_drive(columns, car, reference, align=options.align, start_s=options.start_s)
    notes = [*drive.notes, *_source_notes(drive.recording, manual_driving_s(read.frames, codec, drive.span_s))]
    yield from (Event("note", note) for note in notes)
    return drive._replace(notes=notes)


def _source_notes(recording: Recording, by_hand_s: float) -> Iterator[str]:
    for column, source in recording.instead.items():
        yield f"{column}: from {source}, because the log contains no report of it"
    if by_hand_s >= MIN_MANUAL_S:
        yield f"by-wire control was not enabled for {by_hand_s:.1f} s; these rows count as well"


def scenario_of_log(log: Path) -> str:
    """Path of the scenario of a run's log. Raises InputError for any other log."""
    if not log.exists():
        raise InputError("no such file", code="no_log", file=str(log), hint="give a log, or a run folder")
    summary = log.parent / "episode.json"
    if not summary.is_file():
        raise InputError(
            "the log is not in a run folder, so its reference path is not known",
            code="which_path",
            file=str(log),
            key="--path",
            hint="name a scenario, or a CSV with x_m, y_m, speed_mps (and t_s): --path reference.csv",
        )
    stored = read_json(summary)
    scenario = find_scenario(load(log.parents[2] / "bench.toml"), str(stored["scenario"]))
    if stored.get("scenario_hash") != scenario.hash:
        hint = "drive it again, or name the reference path: --path"
        raise InputError("the scenario file changed since this drive", code="changed", file=scenario.path, hint=hint)
    return scenario.path


def metric_lines(values: Mapping[str, MetricValue]) -> list[str]:
    """Text table by aspect, with the formula, or the reason why there is no value."""
    lines = []
    for aspect, names in names_by_aspect().items():
        lines.append(f"{aspect}")
        for name in names:
            value, row = values[name], TABLE[name]
            number = "-" if value.value is None else f"{value.value:.4g}"
            text = value.why or f"{AGGREGATION_TEXT[row.aggregation]}{row.description}"
            text += " (not in Apollo)" if row.ours and not value.why else ""
            lines.append(f"  {name:<32}{number:>10}  n {value.n:<7} {text}")
    return lines


def oscillation_lines(report: OscillationReport) -> list[str]:
    """Text of the largest sustained swing of each signal, the worst first."""
    findings = sorted(report.findings, key=lambda finding: -finding.ratio)
    return ["oscillation, the largest sustained swings"] + [
        f"  {oscillation_text(finding)}: {finding.ratio:.2g} of the limit" for finding in findings
    ]


def oscillation_note(report: OscillationReport) -> str:
    """The part of a sentence that says that a drive oscillates, empty where it does not."""
    worst = report.worst
    return f"; OSCILLATES: {oscillation_text(worst)}" if worst is not None and report.is_oscillating else ""


def _score(
    drive: LogDrive, weights: WeightsSpec, car: GradeVehicle, name: str, extras: DriveExtras
) -> tuple[ScenarioGrade | None, str]:
    """Grade of a complete log, and a text for it."""
    recording, course = drive.recording, drive.course
    if not extras.error and recording.ticks < course.ticks - MAX_MISSING_TICKS:
        logged_s, planned_s = recording.ticks * recording.dt_s, course.ticks * course.dt_s
        return None, f"no score: the log contains {logged_s:.1f} s of the planned {planned_s:.1f} s"
    try:
        graded = grade_drive(recording, course, weights, car, ScenarioEnd(name, extras.error or ""))
    except InputError as error:
        if error.code != "nothing_to_grade":
            raise
        return None, f"no score: {error.message}"
    dropped = f" (without {len(graded.dropped)} weighted metrics that are not available)" if graded.dropped else ""
    replans = f", {graded.replans} re-plans" if graded.replans else ""
    return graded, f"score {graded.score:.3f} by weights {weights.name!r}{dropped}, {graded.outcome}{replans}"


def _data(
    values: Mapping[str, MetricValue],
    graded: ScenarioGrade | None,
    reference: ReferencePath,
    drive: LogDrive,
    weights: WeightsSpec,
) -> dict[str, Any]:
    """Data of grade.json and --json."""
    return {
        "scenario": reference.name,
        "scenario_hash": reference.hash,
        "against": weights.against,
        "weights": weights.name,
        "notes": drive.notes,
        "instead": dict(drive.recording.instead),
        "seconds": drive.recording.ticks * drive.recording.dt_s,
        "planned_samples": drive.course.ticks,
        "score": None if graded is None else graded.score,
        "outcome": "" if graded is None else graded.outcome,
        "replans": 0 if graded is None else graded.replans,
        "dropped": [] if graded is None else list(graded.dropped),
        "metrics": {name: value._asdict() for name, value in values.items()},
    }


def _figures(
    run: RunFolder, name: str, drive: LogDrive, graded: ScenarioGrade | None, values: Mapping[str, MetricValue]
) -> list[str]:
    from tunefree_hil.figures.profile import draw_profile
    from tunefree_hil.figures.scenario import DrivePicture, draw_scenario
    from tunefree_hil.figures.style import save

    score, outcome = (None, "") if graded is None else (graded.score, graded.outcome)
    shown = DrivePicture("log", drive.recording.columns, score, outcome)
    plain = {"log": {key: value.value for key, value in values.items()}}
    folder = run.figures()
    written = [save(draw_scenario(name, [shown]), folder / "drive.png")]
    written.append(save(draw_profile(plain, f"{name}: all metrics of one log"), folder / "profile.png"))
    return [str(path) for path in written]


def _oscillation_figure(
    run: RunFolder, name: str, drive: LogDrive, car: GradeVehicle, report: OscillationReport
) -> list[str]:
    """The figure of the steering wheel; none for a log without it."""
    from tunefree_hil.figures.oscillation import WheelPicture, draw_oscillation
    from tunefree_hil.figures.style import save

    steering = find_steering_residual(drive.recording, drive.course, car)
    if steering is None:
        return []
    found = [finding for finding in report.findings if finding.signal is steering.signal]
    text = "; ".join(oscillation_text(finding) for finding in found) or "no sustained swing of the wheel"
    span_s = (found[0].from_s, found[0].to_s) if found else None
    wheel_deg, residual_deg = np.degrees(steering.wheel_rad), np.degrees(steering.residual_rad)
    picture = WheelPicture(f"{name}: {text}", wheel_deg, residual_deg, steering.dt_s, span_s)
    return [str(save(draw_oscillation(picture), run.figures() / "oscillation.png"))]
