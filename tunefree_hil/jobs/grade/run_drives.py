"""Read the drives of a run folder (drive, tune, verify, graded log) and profile them.

A run is named by its folder; a tune or verify may be followed by `:NAME` for one of its baselines (the winner is
`:tuned`): runs/x, runs/x:mrac_on, runs/x/verify, runs/x/verify:as_shipped.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, load
from tunefree_hil.config.load import load_weights
from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.episode.recording import Recording, load_recording
from tunefree_hil.grade.profile import MetricValue, ProfileSettings, combine_profiles, profile_drive
from tunefree_hil.grade.score import FINISHED, ScenarioEnd, grade_drive, grade_vehicle_from_spec
from tunefree_hil.grade.table import TABLE
from tunefree_hil.jobs.drive import find_scenario
from tunefree_hil.jobs.log.drive import read_extras
from tunefree_hil.jobs.run_folder import RunFolder, open_run, read_json
from tunefree_hil.jobs.tune.candidates import TUNED, compute_baseline_vectors, read_winner


class ProfiledDrive(NamedTuple):
    """One scenario of a run. score: None for an incomplete log."""

    scenario: str
    hash: str  # of the scenario; '' where it is not known
    values: dict[str, MetricValue]
    score: float | None
    replans: int
    outcome: str
    planned_samples: int
    recording: Recording


class ProfiledRun(NamedTuple):
    """The scenarios of a run by name."""

    label: str
    drives: dict[str, ProfiledDrive]
    weights: WeightsSpec
    vehicle: str = ""
    model: str = ""  # of the plant; '' where there is none (a log)

    def only(self, names: Sequence[str]) -> ProfiledRun:
        """The same run with these scenarios only."""
        return self._replace(drives={name: self.drives[name] for name in names})

    @property
    def failed(self) -> list[str]:
        """Scenarios that were not driven to their end."""
        return [name for name, drive in self.drives.items() if drive.outcome != FINISHED]

    def combined(self) -> dict[str, MetricValue]:
        """The metrics of all scenarios combined."""
        return combine_profiles([drive.values for drive in self.drives.values()])

    def score(self) -> float | None:
        """Eq. 7 over the scenarios; None where a scenario has no score."""
        drives = self.drives.values()
        scores = [drive.score for drive in drives if drive.score is not None]
        if len(scores) < len(drives):
            return None
        weighed = sum(score * drive.planned_samples for score, drive in zip(scores, drives, strict=True))
        return weighed / sum(drive.planned_samples for drive in drives)


def read_run(text: str, weights: WeightsSpec | None = None) -> ProfiledRun:
    """Read a run, graded by `weights` (None: its own). Raises InputError that names what is missing."""
    path, candidate = split_run(text)
    inside_verify = path.name == "verify" and not (path / "run.json").is_file()
    run = open_run(path.parent if inside_verify else path)
    if run.record.get("command") == "grade":
        return _read_graded_log(run, weights)
    _require_drives(run, candidate)
    bench = load(run.bench_file())
    weighing = weights or bench.weights
    source = RunFolder(run.path / "verify", run.record) if inside_verify else run
    drives = [_read_episode(source, bench, number, weighing) for number in _numbers(run, source, bench, candidate)]
    model = bench.spec.verify_model if inside_verify else str(run.record.get("model") or bench.spec.model)
    by_name = {drive.scenario: drive for drive in drives}
    return ProfiledRun(_label(path, candidate), by_name, weighing, Path(bench.vehicle.folder).name, model)


def split_run(text: str) -> tuple[Path, str]:
    """Folder and candidate of a run's name such as 'runs/x:mrac_on', unless a folder has exactly that name."""
    head, colon, name = text.rpartition(":")
    if colon and head and not Path(text).exists() and "/" not in name:
        return Path(head), name
    return Path(text), ""


def _label(path: Path, candidate: str) -> str:
    folder = path.resolve()
    name = f"{folder.parent.name}/verify" if folder.name == "verify" else folder.name
    return f"{name}:{candidate}" if candidate else name


def _numbers(run: RunFolder, source: RunFolder, bench: Bench, candidate: str) -> list[int]:
    """Episode numbers: all of a drive, those of one candidate of a tune or verify, found by their parameters."""
    wanted = None if run.record.get("command") == "drive" else _candidate_parameters(run, bench, candidate or TUNED)
    numbers = [number for number, parameters in _episodes(source) if wanted is None or parameters == wanted]
    if not numbers:
        message = f"contains no drive{f' of {candidate or TUNED}' if wanted else ''} with its columns"
        hint = "it was interrupted, or its logs were deleted; drive it again"
        raise InputError(message, code="no_columns", file=str(source.path), hint=hint)
    return numbers


def _require_drives(run: RunFolder, candidate: str) -> None:
    command = str(run.record.get("command"))
    if command not in ("drive", "tune") or (command == "drive" and candidate):
        message = f"is a run of {command!r}" + (f", which has no candidate {candidate!r}" if candidate else "")
        hint = "give a run of drive, tune, verify or grade"
        raise InputError(message, code="not_a_drive", file=str(run.path), hint=hint)


def _episodes(source: RunFolder) -> list[tuple[int, dict[str, float]]]:
    """Number and parameters of the complete episodes that have their columns."""
    whole = set(source.episodes_with("columns.npz"))
    numbers = [number for number in source.episodes_with("episode.json") if number in whole]
    return [(number, read_json(source.episode(number) / "episode.json").get("parameters", {})) for number in numbers]


def _candidate_parameters(run: RunFolder, bench: Bench, candidate: str) -> dict[str, float]:
    """The complete vector of the winner or of a baseline."""
    if candidate == TUNED:
        return read_winner(bench, run)
    vectors = compute_baseline_vectors(bench)
    if candidate not in vectors:
        hint = f"one of {', '.join([TUNED, *vectors])}"
        raise InputError(f"has no candidate {candidate!r}", code="no_candidate", file=str(run.path), hint=hint)
    return vectors[candidate]


def _read_episode(run: RunFolder, bench: Bench, number: int, weights: WeightsSpec) -> ProfiledDrive:
    """Profile and grade one episode by `weights`."""
    folder = run.path / "episodes" / str(number)
    stored = read_json(folder / "episode.json")
    scenario = find_scenario(bench, str(stored["scenario"]))
    if stored.get("scenario_hash") != scenario.hash:
        raise InputError(
            "the scenario file changed since this drive", code="changed", file=scenario.path, hint="drive it again"
        )
    recording, extras = load_recording(folder / "columns.npz"), read_extras(folder)
    course, car = bench.course(scenario), grade_vehicle_from_spec(bench.vehicle)
    graded = grade_drive(recording, course, weights, car, ScenarioEnd(scenario.name, extras.error or ""))
    settings = ProfileSettings(weights.against, weights.as_published)
    values = profile_drive(recording, course, car, settings, extras)
    return ProfiledDrive(
        scenario.name, scenario.hash, values, graded.score, graded.replans, graded.outcome, course.ticks, recording
    )


def _read_graded_log(run: RunFolder, weights: WeightsSpec | None) -> ProfiledRun:
    """The drive of a graded log, as recorded in grade.json."""
    data = read_json(run.path / "grade.json")
    used = load_weights(str(run.record["weights"]))
    if weights is not None and weights.name != used.name:
        message = f"was graded by weights {used.name!r}, the first run by {weights.name!r}"
        hint = f"grade it again with --weights {weights.name}"
        raise InputError(message, code="other_weights", file=str(run.path), hint=hint)
    missing = MetricValue(None, 0, "not in grade.json")
    values = {name: MetricValue(**data["metrics"][name]) if name in data["metrics"] else missing for name in TABLE}
    drive = ProfiledDrive(
        str(data["scenario"]),
        str(data.get("scenario_hash", "")),
        values,
        data["score"],
        int(data["replans"]),
        str(data["outcome"]) or FINISHED,
        int(data["planned_samples"]),
        load_recording(run.path / "episodes" / "0" / "columns.npz"),
    )
    vehicle = Path(str(run.record.get("vehicle", ""))).name
    return ProfiledRun(_label(run.path, ""), {drive.scenario: drive}, used, vehicle)
