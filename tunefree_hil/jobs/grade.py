"""Grade any log of a vehicle against a reference path: the 42 metrics by aspect, a score where there can be one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.config.load import load_vehicle, load_weights
from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.episode.recording import save_recording
from tunefree_hil.grade.align import Align
from tunefree_hil.grade.profile import Beside, Value, profile
from tunefree_hil.grade.reference import Reference, read_reference
from tunefree_hil.grade.score import MISSING_TICKS, GradeVehicle, ScenarioGrade, grade, vehicle_of
from tunefree_hil.grade.table import PUBLISHED, TABLE, by_aspect
from tunefree_hil.jobs.drive import DEFAULT_ROOT
from tunefree_hil.jobs.log_drive import LogDrive, beside_of, read_drive
from tunefree_hil.jobs.log_files import codec_for, load_log
from tunefree_hil.jobs.run_folder import RunFolder, write_json

SCHEMA = "tunefree.grade/1"


def grade_log(
    log: Path,
    *,
    vehicle: str | None,
    path: str,
    align: Align,
    start_s: float | None,
    weights: str,
    out: Path | None,
) -> Iterator[Event]:
    """One line a metric on stdout; writes a run folder with columns, grade.json and figures."""
    codec, where = codec_for(log, vehicle)
    yield Event("note", f"{log}, read as {where}")
    spec, weighing = load_vehicle(where), load_weights(weights)
    car = vehicle_of(spec)
    read = load_log(log)
    if read.cut:
        yield Event("warning", read.cut)
    reference = read_reference(path, codec.tick_ms * 1e-3)
    drive = read_drive(read.frames, codec, car, reference, align=align, start_s=start_s, folder=log.parent)
    yield from (Event("note", note) for note in drive.notes)
    beside = beside_of(log.parent)
    values = profile(
        drive.recording,
        drive.course,
        car,
        against=weighing.against,
        as_published=weighing.as_published,
        beside=beside,
    )
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


def lines_of(values: Mapping[str, Value]) -> list[str]:
    """A table for people: by aspect, with the formula, or why there is no value."""
    lines = []
    for aspect, names in by_aspect().items():
        lines.append(f"{aspect}")
        for name in names:
            value, row = values[name], TABLE[name]
            number = "-" if value.value is None else f"{value.value:.4g}"
            said = value.why or f"{row.how} of {row.words}" + (" (ours)" if row.ours else "")
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

    ended = graded.outcome if graded is not None and graded.outcome != "finished" else ""
    one = Drive("log", drive.recording.columns, None if graded is None else graded.score, ended)
    plain = {"log": {key: value.value for key, value in values.items()}}
    folder = run.figures()
    written = [write_scenario(folder / "drive.png", name, [one])]
    written.append(write_profile(folder / "profile.png", plain, f"{name}: all metrics of one log"))
    return [str(path) for path in written]
