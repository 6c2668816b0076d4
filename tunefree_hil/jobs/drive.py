"""Drive scenarios of a bench file over the bus, with given parameters, and score them."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import (
    Bench,
    load,
    model_of,
    own_parameters,
    parameters_of,
    require_buildable,
    require_in_box,
)
from tunefree_hil.bus.bench_channel import error_text
from tunefree_hil.config.load import load_scenario
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.control.parameters import NAMES
from tunefree_hil.grade.score import FINISHED, combine_scores
from tunefree_hil.jobs.command_text import shell_command
from tunefree_hil.jobs.identity import compute_identity, resolved_toml
from tunefree_hil.jobs.learn.report_text import describe_model, describe_outside, measure_outside, warn_of_outside
from tunefree_hil.jobs.options.records import DriveOptions
from tunefree_hil.jobs.run_folder import JOINED, RunFolder, write_text
from tunefree_hil.jobs.running.episode_results import EpisodeResult, plan_warnings, reception_warnings
from tunefree_hil.jobs.running.foreign import joined_controller_name, make_launch, with_controller_command
from tunefree_hil.jobs.running.lateness import judge_realtime
from tunefree_hil.jobs.running.node_links import resolve_vehicle_bus
from tunefree_hil.jobs.running.session import BenchSession
from tunefree_hil.jobs.running.trial_driver import TrialDriver

DEFAULT_ROOT = Path("runs")


class ResolvedDrive(NamedTuple):
    """The options with the files they name."""

    options: DriveOptions
    bench: Bench
    model: str
    scenarios: list[ScenarioSpec]
    values: dict[str, float]
    session: str


def drive(options: DriveOptions) -> Iterator[Event]:
    """Drive the named scenarios, or all of the bench file. Exit 4 when real time was wanted and not kept."""
    resolved = _resolve_options(options)
    run = _create_run_folder(resolved)
    yield Event("note", f"run folder {run.path}")
    yield Event("note", describe_model(model_of(resolved.bench, resolved.model)))
    episodes, pace = yield from _drive_scenarios(resolved, run)
    yield _finish(resolved, run, episodes, pace)


def _resolve_options(options: DriveOptions) -> ResolvedDrive:
    """Read and check all inputs before any process starts. Raises InputError for a fault."""
    bench = with_controller_command(load(options.bench), options.controller)
    values = parameters_of(bench, parse_parameters(options.parameters, own_parameters(bench)))
    model = options.model or bench.spec.model
    scenarios = [find_scenario(bench, name) for name in dict.fromkeys(options.scenario or bench.spec.scenarios)]
    require_buildable(bench, model, scenarios, values, realtime=options.realtime)
    session = options.session or new_session_name()
    resolve_vehicle_bus(bench, options.bus, session, options.bench_bus)
    return ResolvedDrive(options, bench, model, scenarios, values, session)


def _create_run_folder(resolved: ResolvedDrive) -> RunFolder:
    """Create the run folder with the resolved bench file."""
    options, bench = resolved.options, resolved.bench
    identity = compute_identity(bench, resolved.model, resolved.scenarios)
    record = {"command": "drive", "bench": str(options.bench), "model": resolved.model, "realtime": options.realtime}
    record |= {**identity, "seed": options.seed, "parameters": resolved.values}
    run = RunFolder.create(options.out or DEFAULT_ROOT, f"drive-{options.bench.stem}", record)
    write_text(run.path / "bench.toml", resolved_toml(bench, resolved.scenarios))
    return run


def _drive_scenarios(
    resolved: ResolvedDrive, run: RunFolder
) -> Generator[Event, None, tuple[dict[str, EpisodeResult], dict[str, float]]]:
    """Drive all scenarios. Returns the episodes by scenario, and the speed (TrialDriver.pace)."""
    options, bench = resolved.options, resolved.bench
    bus = {"bus": options.bus, "bench_bus": options.bench_bus, "join": options.join, "realtime": options.realtime}
    launch = make_launch(bench, resolved.model, session=resolved.session, **bus)
    with BenchSession(run.path / "bench.toml", run.node_output(), launch) as session:
        yield Event("note", f"bus: {session.choice.why}")
        if options.join:
            run.add_to_record(**{JOINED: joined_controller_name([session])})
        episodes: dict[str, EpisodeResult] = {}
        with closing(TrialDriver(session, bench, run, seed=options.seed)) as driver:
            for i, scenario in enumerate(resolved.scenarios):
                episodes |= driver.drive_scenarios(resolved.values, [scenario], i)
                yield from _report_scenario(resolved, run, i, episodes[scenario.name], driver.pace)
        yield from (Event("warning", text) for text in session.notes)
    return episodes, driver.pace


def _report_scenario(
    resolved: ResolvedDrive, run: RunFolder, i: int, episode: EpisodeResult, pace: Mapping[str, float]
) -> Iterator[Event]:
    """Events for the result of scenario i: progress, and warnings."""
    bench, name = resolved.bench, resolved.scenarios[i].name
    rest_s = sum(bench.course(later).ticks for later in resolved.scenarios[i + 1 :]) * bench.dt_s
    eta_s = rest_s / pace.get("speed_x", 1.0)
    data = {"label": "scenario", "done": i + 1, "total": len(resolved.scenarios), "eta_s": eta_s, **pace}
    yield Event("progress", _score_line(name, episode), data)
    troubles = [*reception_warnings(run.episode(i)), *plan_warnings(run.episode(i))]
    yield from (Event("warning", f"{name}: {text}") for text in troubles)
    text = warn_of_outside(bench, resolved.model, name, episode.recording)
    yield from [Event("warning", text)] * bool(text)


def new_session_name() -> str:
    """A session name that is unique on this machine."""
    return f"run-{os.getpid()}"


def parse_parameters(texts: Iterable[str], extra_names: Iterable[str] = ()) -> dict[str, float]:
    """Parse NAME=VALUE pairs; extra_names: parameters of a foreign controller. Raises InputError for a wrong one."""
    known = [*NAMES, *extra_names]
    chosen = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name not in known:
            message = f"unknown parameter {name!r}"
            raise InputError(message, code="unknown_parameter", key="--parameter", hint=f"one of {', '.join(known)}")
        try:
            chosen[name] = float(value)
        except ValueError:
            raise InputError(
                f"{text!r} has no number", code="bad_parameter", key="--parameter", hint=f"--parameter {name}=0.1"
            ) from None
        require_in_box(name, chosen[name], key="--parameter")
    return chosen


def find_scenario(bench: Bench, name: str) -> ScenarioSpec:
    """A scenario of the bench file by its name there or in its file, or any other scenario by name or path."""
    known = {scenario.name: scenario for scenario in bench.scenarios.values()} | dict(bench.scenarios)
    return known[name] if name in known else load_scenario(name, bench.file)


def draw_drives(run: RunFolder, episodes: Mapping[str, EpisodeResult]) -> list[str]:
    """Draw one figure a scenario."""
    from tunefree_hil.figures.scenario import DrivePicture, draw_scenario
    from tunefree_hil.figures.style import save

    written = []
    for name, episode in episodes.items():
        shown = DrivePicture("drive", episode.recording.columns, episode.grade.score, episode.grade.outcome)
        written.append(str(save(draw_scenario(name, [shown]), run.figures() / f"{name}.png")))
    return written


def _score_line(name: str, episode: EpisodeResult) -> str:
    grade = episode.grade
    peak = grade.metrics.get("lateral_err_peak")
    lateral = f", lateral peak {0.5 * peak:.2f} m" if peak is not None else ""
    replans = f", {grade.replans} re-plans" if grade.replans else ""
    ended = error_text(episode.error_code) if episode.error_code else grade.outcome
    return f"{name}: score {grade.score:.3f}{lateral}{replans}, {ended}"


def _finish(
    resolved: ResolvedDrive, run: RunFolder, episodes: Mapping[str, EpisodeResult], pace: Mapping[str, float]
) -> Event:
    """Draw the figures, judge real time, and mark the run complete. Returns the result event."""
    bench, hashes = resolved.bench, {name: episode.hash for name, episode in episodes.items()}
    figures = draw_drives(run, episodes)
    verdict: dict[str, Any] = {}
    if resolved.options.realtime:
        verdict = judge_realtime(run, range(len(resolved.scenarios)), bench.codec, faults=bench.spec.faults)
    score = combine_scores([episode.grade for episode in episodes.values()])
    run.finish(score=score, frame_hashes=hashes)
    outside = measure_outside(bench, resolved.model, {name: one.recording for name, one in episodes.items()})
    foreign = {hex(can_id): count for episode in episodes.values() for can_id, count in episode.foreign.items()}
    replay = [] if verdict else [shell_command("replay", run.path, verify=True)]
    data: dict[str, Any] = {
        "run": str(run.path),
        "score": score,
        "scenarios": {name: episode.grade.as_data() for name, episode in episodes.items()},
        "hashes": hashes,
        "figures": figures,
        "next": [*replay, shell_command("log check", run.path / "episodes" / "0" / "vehicle.log")],
        **pace,
        "outside": outside,
    }
    data |= {"realtime": verdict} if verdict else {}
    data |= {"exit": 4} if verdict and not verdict["valid"] else {}
    data |= {"foreign_frames": foreign} if foreign else {}
    failed = ", ".join(name for name, episode in episodes.items() if episode.grade.outcome != FINISHED)
    parts = [
        f"{len(episodes)} scenario{'' if len(episodes) == 1 else 's'} driven, score {score:.3f}",
        f"not driven to the end: {failed}" if failed else "",
        describe_outside(outside),
        verdict.get("sentence", ""),
        f"frames of other nodes on the bus: {foreign}" if foreign else "",
    ]
    sentence = "; ".join(part for part in parts if part)
    return Event("result", sentence, {"sentence": sentence, **data})
