"""Grade any log of a vehicle against a reference path: the 42 metrics by aspect, a score where there can be one."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import load
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.config.load import load_vehicle, load_weights
from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.episode.recording import Recording, save_recording
from tunefree_hil.grade.align import Align
from tunefree_hil.grade.profile import Beside, Value, profile
from tunefree_hil.grade.reference import Reference, read_reference
from tunefree_hil.grade.score import MISSING_TICKS, GradeVehicle, ScenarioGrade, grade, vehicle_of
from tunefree_hil.grade.table import PUBLISHED, TABLE, by_aspect
from tunefree_hil.jobs.drive import DEFAULT_ROOT, find_scenario
from tunefree_hil.jobs.log.drive import LogDrive, beside_of, manual_s, read_drive, refuse_jump
from tunefree_hil.jobs.log.files import codec_for, load_log
from tunefree_hil.jobs.preconditions import require_number
from tunefree_hil.jobs.report_text import early
from tunefree_hil.jobs.run_folder import RunFolder, read_json, write_json

SCHEMA = "tunefree.grade/1"
MOST_START_S = 1e9  # thirty years; beyond the end of a log anyway
LEAST_MANUAL_S = 0.5  # the handshake at the start of a drive takes less
SAID = {"std": "RMS of ", "peak": "peak of ", "mean": "mean of ", "share": ""}  # before a metric's words


def grade_log(
    log: Path,
    *,
    vehicle: str | None,
    path: str | None,
    align: Align,
    start_s: float | None,
    weights: str,
    out: Path | None,
) -> Iterator[Event]:
    """One line a metric on stdout; writes a run folder with columns, grade.json and figures.

    path: None where the log is a run's own, which knows what was driven.
    """
    require_number("--start-s", start_s, most=MOST_START_S, zero=True)
    path = path or own_scenario(log)
    codec, where = codec_for(log, vehicle)
    yield Event("note", f"{log}, read as {where}")
    weighing, car = load_weights(weights), vehicle_of(load_vehicle(where))
    reference = read_reference(path, codec.tick_ms * 1e-3, car.rear_axle_m)
    drive = yield from _read(log, codec, car, reference, align, start_s)
    beside = beside_of(log.parent)
    shown = {"against": weighing.against, "as_published": weighing.as_published, "beside": beside}
    values = profile(drive.recording, drive.course, car, **shown)
    yield from (Event("line", line) for line in lines_of(values))
    graded, words = _score(drive, weighing, car, reference.name, beside)
    record = {"command": "grade", "log": str(log), "vehicle": where, "path": path, "weights": weighing.name}
    run = RunFolder.create(out or DEFAULT_ROOT, f"grade-{log.stem}", record)
    data = _data(values, graded, reference, drive, weighing)
    save_recording(drive.recording, run.episode(0) / "columns.npz")
    write_json(run.path / "grade.json", {"schema": SCHEMA, **data})
    figures = _figures(run, reference.name, drive, graded, values)
    run.finish(score=data["score"])
    had = sum(values[name].value is not None for name in PUBLISHED)
    sentence = f"{had} of {len(PUBLISHED)} metrics could be had; {words}"
    yield Event("result", sentence, {"sentence": sentence, "run": str(run.path), "figures": figures, **data})


def _read(
    log: Path, codec: Codec, car: GradeVehicle, reference: Reference, align: Align, start_s: float | None
) -> Generator[Event, None, LogDrive]:
    """The drive in a log; all that is to be known of it said, and in its notes."""
    read = load_log(log)
    if read.cut:
        yield Event("warning", read.cut)
    refuse_jump(read.frames, log)
    drive = read_drive(read.frames, codec, car, reference, align=align, start_s=start_s, folder=log.parent)
    notes = [*drive.notes, *_more_notes(drive.recording, manual_s(read.frames, codec, drive.span_s))]
    yield from (Event("note", note) for note in notes)
    return drive._replace(notes=notes)


def _more_notes(recording: Recording, by_hand_s: float) -> Iterator[str]:
    for column, source in recording.instead.items():
        yield f"{column}: from {source}, as the log has no report of it"
    if by_hand_s >= LEAST_MANUAL_S:
        yield f"by-wire was not enabled for {by_hand_s:.1f} s of this; those rows count as well"


def own_scenario(log: Path) -> str:
    """Path of the scenario that a log of our own bench was driven in. Raises InputError for any other log."""
    if not log.exists():
        raise InputError("there is no such file", code="no_log", file=str(log), hint="give a log, or a run folder")
    summary = log.parent / "episode.json"
    if not summary.is_file():
        raise InputError(
            "the log lies in no run folder, so what it was to follow is not known",
            code="which_path",
            file=str(log),
            key="--path",
            hint="name a scenario, or a CSV with x_m, y_m, speed_mps (and t_s): --path reference.csv",
        )
    stored = read_json(summary)
    scenario = find_scenario(load(log.parents[2] / "bench.toml"), str(stored["scenario"]))
    if stored.get("scenario_hash") != scenario.hash:
        hint = "drive it again, or name what it was to follow: --path"
        raise InputError("the scenario file changed since this drive", code="changed", file=scenario.path, hint=hint)
    return scenario.path


def lines_of(values: Mapping[str, Value]) -> list[str]:
    """A table for people: by aspect, with the formula, or why there is no value."""
    lines = []
    for aspect, names in by_aspect().items():
        lines.append(f"{aspect}")
        for name in names:
            value, row = values[name], TABLE[name]
            number = "-" if value.value is None else f"{value.value:.4g}"
            said = value.why or f"{SAID[row.how]}{row.words}" + (" (ours)" if row.ours else "")
            lines.append(f"  {name:<32}{number:>10}  n {value.n:<7} {said}")
    return lines


def _score(
    drive: LogDrive, weights: WeightsSpec, car: GradeVehicle, name: str, beside: Beside
) -> tuple[ScenarioGrade | None, str]:
    """The grade by these weights, where the log is whole, and what to say of it."""
    recording, course = drive.recording, drive.course
    if not beside.error and recording.ticks < course.ticks - MISSING_TICKS:
        held, planned = recording.ticks * recording.dt_s, course.ticks * course.dt_s
        return None, f"no score: the log holds {held:.1f} s of the {planned:.1f} s that are planned"
    try:
        graded = grade(recording, course, weights, car, scenario=name, error=beside.error or "")
    except InputError as error:
        if error.code != "nothing_to_grade":
            raise
        return None, f"no score: {error.message}"
    dropped = f" (without {len(graded.dropped)} weighed metrics that are null)" if graded.dropped else ""
    replans = f", {graded.replans} re-plans" if graded.replans else ""
    return graded, f"score {graded.score:.3f} by weights {weights.name!r}{dropped}, {graded.outcome}{replans}"


def _data(
    values: Mapping[str, Value],
    graded: ScenarioGrade | None,
    reference: Reference,
    drive: LogDrive,
    weights: WeightsSpec,
) -> dict[str, Any]:
    """What grade.json and --json hold."""
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
    run: RunFolder, name: str, drive: LogDrive, graded: ScenarioGrade | None, values: Mapping[str, Value]
) -> list[str]:
    from tunefree_hil.figures.profile import write_profile
    from tunefree_hil.figures.scenario import Drive, write_scenario

    score, ended = (None, "") if graded is None else (graded.score, early(graded.outcome))
    one = Drive("log", drive.recording.columns, score, ended)
    plain = {"log": {key: value.value for key, value in values.items()}}
    folder = run.figures()
    written = [write_scenario(folder / "drive.png", name, [one])]
    written.append(write_profile(folder / "profile.png", plain, f"{name}: all metrics of one log"))
    return [str(path) for path in written]
