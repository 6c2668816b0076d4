"""Run folders as `drive` and `tune` leave them, made in one process: the same frames, harvested the same way."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tools.measures._in_process import InProcess
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bus.bench_channel import ErrorCode
from tunefree_hil.config.dump import to_toml
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.jobs.identity import resolved_toml
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.running.episode_results import (
    DrivenEpisode,
    EpisodeResult,
    evaluation_from_episodes,
    read_episode,
)
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors
from tunefree_hil.nodes.runner import Outcome
from tunefree_hil.tune.space import resolve_space
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.study import Evaluation, open_study
from tunefree_hil.tune.trial_loop import run_trials


def made_drive(bench_file: Path, root: Path, name: str, values: Mapping[str, float], *, last: int = 0) -> Path:
    """A drive of all scenarios of a bench file, or of the first `last`."""
    bench = load(bench_file)
    scenarios = [bench.scenarios[one] for one in bench.spec.scenarios][: last or None]
    run = _folder(bench, root, name, "drive", scenarios)
    drive_into(run, bench, InProcess(bench), parameters_of(bench, values), 0, scenarios)
    run.finish()
    return run.path


def made_tune(bench_file: Path, root: Path, trials: int, seed: int = 1) -> Path:
    """A tune with two baselines driven, and `trials` random trials, the winner driven, the others scored by formula."""
    bench = load(bench_file)
    scenarios = [bench.scenarios[one] for one in bench.spec.scenarios]
    run, vectors, one = (
        _folder(bench, root, "tune", "tune", scenarios),
        compute_baseline_vectors(bench),
        InProcess(bench),
    )
    settings = StudySettings(resolve_space(bench.spec.tune.set, []), seed, "random", "none", {})
    kept: dict[str, Evaluation] = {}
    with open_study(run.path / "study.db", settings) as study:
        for number, name in enumerate(list(vectors)[:2]):
            kept[name] = drive_into(run, bench, one, vectors[name], number * len(scenarios), scenarios)
            study.add_baseline(name, vectors[name], kept[name])
        best = min(kept.values(), key=lambda each: each.score)

        def evaluate(searched: Mapping[str, float]) -> Evaluation:
            away = sum(abs(math.log(value)) for value in searched.values())
            return Evaluation(best.score * (1.0 + away), best.scenarios)

        for _ in run_trials(study, trials, evaluate):
            pass
        winner = study.best()
    assert winner is not None
    drive_into(run, bench, one, parameters_of(bench, winner.parameters), 99 * len(scenarios), scenarios)
    best_toml = {"slot": winner.slot, "score": winner.score, "parameters": parameters_of(bench, winner.parameters)}
    (run.path / "best.toml").write_text(to_toml(best_toml))
    run.finish()
    return run.path


def drive_into(
    run: RunFolder,
    bench: Bench,
    one: InProcess,
    values: Mapping[str, float],
    first: int,
    scenarios: list[ScenarioSpec],
) -> Evaluation:
    """Episodes first, first + 1, ... of a run folder: logs, columns, summary, compute times."""
    episodes: dict[str, EpisodeResult] = {}
    for number, scenario in enumerate(scenarios, first):
        folder = run.episode(number)
        drive = one.drive(scenario, values)
        lines = [
            f"({frame.time_s:.6f}) {frame.channel} {frame.can_id:03X}#{frame.data.hex().upper()}\n"
            for frame in drive.frames
        ]
        (folder / "vehicle.log").write_text("".join(lines))
        np.savez(folder / "timing.npz", controller_control_time_s=np.full(drive.ticks, 0.001))
        code = next((one for one in ErrorCode if one.name.lower() == drive.error), ErrorCode.NONE)
        outcome = Outcome(drive.ticks, int(code) if drive.error else 0, {}, 0.0)
        episodes[scenario.name] = read_episode(bench, DrivenEpisode(scenario, values, outcome, folder))
    return evaluation_from_episodes(episodes)


def _folder(bench: Bench, root: Path, name: str, command: str, scenarios: list[Any]) -> RunFolder:
    run = RunFolder.create(root, name, {"command": command, "model": bench.spec.model})
    (run.path / "bench.toml").write_text(resolved_toml(bench, scenarios))
    return run
