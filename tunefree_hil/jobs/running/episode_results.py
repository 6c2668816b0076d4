"""Read an episode's logs into columns, frame hash and grade, and its reception warnings from timing.npz."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.bench import Bench, follower_of
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.control.mpc.plan import SolveCounts, plan_failure_text
from tunefree_hil.episode.candump import read_candump
from tunefree_hil.episode.columns import columns_from_placed, place_vehicle
from tunefree_hil.episode.frame_hash import hash_of
from tunefree_hil.episode.real_time import run_zero_s
from tunefree_hil.episode.recording import Recording, save_recording
from tunefree_hil.grade.score import ScenarioEnd, ScenarioGrade, combine_scores, grade_drive, grade_vehicle_from_spec
from tunefree_hil.jobs.run_folder import write_json
from tunefree_hil.nodes.reception import in_words
from tunefree_hil.nodes.runner import Outcome
from tunefree_hil.tune.trial import Evaluation


class EpisodeResult(NamedTuple):
    """One drive, read and graded. error_code: as sent on the bench channel; a foreign controller's own unchanged."""

    recording: Recording
    grade: ScenarioGrade
    hash: str
    foreign: dict[int, int]
    error_code: int = 0


class DrivenEpisode(NamedTuple):
    """A drive whose logs are in `folder`: what was driven, and how it ended."""

    scenario: ScenarioSpec
    values: Mapping[str, float]
    outcome: Outcome
    folder: Path
    seed: int = 0
    realtime: bool = False


def read_episode(bench: Bench, driven: DrivenEpisode) -> EpisodeResult:
    """Read `vehicle.log` of a drive, and write columns.npz and episode.json beside it."""
    scenario, values, outcome, folder, _, realtime = driven
    zero_s = run_zero_s(folder / "bench.log") if realtime else 0.0
    placed = place_vehicle(read_candump(folder / "vehicle.log"), bench.codec, bench.dt_s, zero_s)
    hashed = hash_of(placed)
    follower, late_ticks = follower_of(bench, scenario, values), 1 if realtime else 0
    recording = columns_from_placed(
        placed, bench.codec, follower, bench.dt_s, ticks=outcome.ticks, late_ticks=late_ticks
    )
    save_recording(recording, folder / "columns.npz")
    course, car = bench.course(scenario), grade_vehicle_from_spec(bench.vehicle)
    graded = grade_drive(recording, course, bench.weights, car, ScenarioEnd(scenario.name, outcome.error))
    write_json(folder / "episode.json", _summary(driven, graded, hashed.hex))
    return EpisodeResult(recording, graded, hashed.hex, dict(hashed.foreign), outcome.error_code)


def _summary(driven: DrivenEpisode, graded: ScenarioGrade, sha256: str) -> dict[str, Any]:
    return {
        "schema": "tunefree.episode/1",
        "scenario": driven.scenario.name,
        "scenario_hash": driven.scenario.hash,
        "seed": driven.seed,
        "parameters": dict(driven.values),
        "ticks": driven.outcome.ticks,
        "error": driven.outcome.error,
        "error_code": driven.outcome.error_code,
        "score": graded.score,
        "metrics": graded.metrics,
        "replans": graded.replans,
        "outcome": graded.outcome,
        "frame_hash": sha256,
    }


def evaluation_from_episodes(episodes: Mapping[str, EpisodeResult]) -> Evaluation:
    """Eq. 7 over the episodes, with each grade as plain data."""
    grades = [episode.grade for episode in episodes.values()]
    scenarios = {name: {**episode.grade.as_data(), "frame_hash": episode.hash} for name, episode in episodes.items()}
    return Evaluation(combine_scores(grades), scenarios)


ROLES = ("ecu", "controller")
RECEPTION_KEY = "_heard_"
PLANS_KEY = "controller_plans_"


def reception_warnings(episode: Path) -> list[str]:
    """A text for each message that was received late, lost or damaged, by receiving node.

    episode: folder of an episode. Empty without its timing.npz, which a foreign controller does not write.
    """
    file = episode / "timing.npz"
    if not file.is_file():
        return []
    with np.load(file, allow_pickle=False) as data:
        rows = {name: data[name].tolist() for name in data.files if RECEPTION_KEY in name}
    return [
        f"{role} received {name.removeprefix(role + RECEPTION_KEY)}: {in_words(row)}"
        for role in ROLES
        for name, row in sorted(rows.items())
        if name.startswith(role + RECEPTION_KEY)
    ]


def plan_counts(episode: Path) -> dict[str, SolveCounts]:
    """Counts of the controller's optimisers in an episode's timing.npz, by part; empty where none planned."""
    file = episode / "timing.npz"
    if not file.is_file():
        return {}
    with np.load(file, allow_pickle=False) as data:
        names = [name for name in data.files if name.startswith(PLANS_KEY)]
        return {name.removeprefix(PLANS_KEY): SolveCounts(*map(int, data[name])) for name in names}


def plan_warnings(episode: Path) -> list[str]:
    """A text for each part whose optimiser was without a solution at some tick."""
    return [plan_failure_text(name, counts) for name, counts in plan_counts(episode).items() if counts.failed]
