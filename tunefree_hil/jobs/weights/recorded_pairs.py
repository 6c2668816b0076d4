"""Reads a file of pairs: runs of human drives and runs of generated ones, compared scenario by scenario."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_weights
from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.config.tuning.pairs_schema import PairSpec, load_pairs
from tunefree_hil.grade.score import FINISHED, SCORE_METRICS, weighted_mean
from tunefree_hil.grade.weight_regression.pairs import DrivePair, DriverKind, RankedDrive
from tunefree_hil.jobs.grade.run_drives import ProfiledDrive, ProfiledRun, read_run, split_run
from tunefree_hil.jobs.weights.driven_pairs import COMPARED

OTHER_WEIGHTS = "other_weights"  # code of a graded log whose metrics are those of other weights


class EntryPlace(NamedTuple):
    """Where a generated run is named: file, key, and its text."""

    file: str
    key: str
    text: str


def read_pairs(path: Path, base: WeightsSpec) -> list[DrivePair]:
    """All pairs of a file. Raises InputError that names the runs of an entry without a common scenario."""
    compared = [load_weights(name) for name in COMPARED if name != base.name]
    pairs: list[DrivePair] = []
    for number, entry in enumerate(load_pairs(path).pairs):
        human = _read_drives(_resolve(entry.human, path), base, compared)
        for text in entry.generated:
            generated = _read_drives(_resolve(text, path), base, compared)
            pairs += _pair_runs(human, generated, entry, EntryPlace(str(path), f"pairs[{number}]", text))
    return pairs


def _pair_runs(
    human: Mapping[str, RankedDrive],
    generated: Mapping[str, RankedDrive],
    entry: PairSpec,
    place: EntryPlace,
) -> list[DrivePair]:
    """A pair for each common task."""
    common = [task for task in human if task in generated]
    if not common:
        raise InputError(
            f"{entry.human} drove {_tasks_text(human)}, {place.text} drove {_tasks_text(generated)}",
            code="unlike_tasks",
            file=place.file,
            key=place.key,
            hint="pair drives of the same scenario file, or logs graded against the same reference path",
        )
    return [
        DrivePair(human[task], generated[task], entry.group or human[task].task, DriverKind(entry.kind))
        for task in common
    ]


def _read_drives(text: str, base: WeightsSpec, compared: list[WeightsSpec]) -> dict[str, RankedDrive]:
    """The drives of a run by task."""
    run = read_run(text, base)
    others = {spec.name: _read_other(text, spec) for spec in compared}
    drives = {}
    for name, drive in run.drives.items():
        if drive.score is None:
            continue
        scores = {
            other: score
            for other, read in others.items()
            if read is not None and (score := _weighted_score(read.drives.get(name), read.weights)) is not None
        }
        measured = RankedDrive(f"{text} {name}", _task(drive), _metrics(drive), drive.outcome, drive.replans, scores)
        drives[measured.task] = measured
    if not drives:
        raise InputError(
            "no drive of it has a score",
            code="nothing_to_grade",
            file=text,
            hint="the log must hold the whole reference path, and some of the weighted metrics",
        )
    return drives


def _read_other(text: str, spec: WeightsSpec) -> ProfiledRun | None:
    """The run graded by other weights; None for a graded log, which has the metrics of its own weights only."""
    try:
        return read_run(text, spec)
    except InputError as error:
        if error.code != OTHER_WEIGHTS:
            raise
        return None


def _metrics(drive: ProfiledDrive) -> dict[str, float | None]:
    return {name: drive.values[name].value for name in SCORE_METRICS if name in drive.values}


def _weighted_score(drive: ProfiledDrive | None, spec: WeightsSpec) -> float | None:
    if drive is None or drive.outcome != FINISHED:
        return None
    metrics = dict.fromkeys(spec.metrics) | _metrics(drive)
    return weighted_mean(metrics, spec) if any(metrics[name] is not None for name in spec.metrics) else None


def _task(drive: ProfiledDrive) -> str:
    """Scenario and its content; a CSV path has no hash, so its name and length count."""
    return f"{drive.scenario}@{drive.hash[:12] or drive.planned_samples}"


def _tasks_text(drives: Mapping[str, RankedDrive]) -> str:
    return ", ".join(drives) or "nothing"


def _resolve(text: str, file: Path) -> str:
    """A run beside the file of pairs, else as it is written."""
    beside = str(file.parent / text)
    return beside if split_run(beside)[0].exists() else text
