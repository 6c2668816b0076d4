"""Drive scenarios of a bench file over the bus, with given parameters, and score them."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import (
    Bench,
    is_heavy,
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
from tunefree_hil.grade.score import FINISHED, combine
from tunefree_hil.jobs.command_text import pasted
from tunefree_hil.jobs.identity import identity_of, resolved_toml
from tunefree_hil.jobs.learn.report_text import drive_warning, model_words, outside_data, outside_words
from tunefree_hil.jobs.report_text import early
from tunefree_hil.jobs.run_folder import JOINED, RunFolder, write_text
from tunefree_hil.jobs.running.episode_results import Episode, heard_of
from tunefree_hil.jobs.running.foreign import joined_name, program_of, with_command
from tunefree_hil.jobs.running.lateness import judge_realtime
from tunefree_hil.jobs.running.node_links import bus_for
from tunefree_hil.jobs.running.session import Session
from tunefree_hil.jobs.running.trial_driver import Track

DEFAULT_ROOT = Path("runs")


class Asked(NamedTuple):
    """The command line of `drive`. scenario: none for all of the bench file; session: '' for one of its own."""

    bench: Path
    scenario: Sequence[str] = ()
    model: str | None = None
    bus: str = "auto"
    bench_bus: str = ""
    seed: int | None = None
    realtime: bool = False
    join: bool = False
    session: str = ""
    out: Path | None = None
    parameters: Sequence[str] = ()
    controller: str = ""


class Wish(NamedTuple):
    """What was asked for, resolved."""

    asked: Asked
    bench: Bench
    model: str
    scenarios: list[ScenarioSpec]
    values: dict[str, float]
    session: str


def drive(asked: Asked) -> Iterator[Event]:
    """Drive the scenarios that are named, or all of the bench file. Real time: exit 4 when it was not."""
    wish = _resolved(asked)
    run = _folder_of(wish)
    yield Event("note", f"run folder {run.path}")
    yield Event("note", model_words(model_of(wish.bench, wish.model)))
    episodes, pace = yield from _driven(wish, run)
    figures = draw(run, episodes)
    numbers, faults = range(len(wish.scenarios)), wish.bench.spec.faults
    verdict = judge_realtime(run, numbers, wish.bench.codec, faults=faults) if asked.realtime else None
    score = combine([episode.grade for episode in episodes.values()])
    run.finish(score=score, frame_hashes={name: episode.hash for name, episode in episodes.items()})
    beyond = outside_data(wish.bench, wish.model, {name: episode.recording for name, episode in episodes.items()})
    yield _result(run, episodes, score, figures, verdict, {**pace, "outside": beyond})


def _resolved(asked: Asked) -> Wish:
    """Read and check everything. Raises InputError that names what does not fit, before any process starts."""
    bench = with_command(load(asked.bench), asked.controller)
    values = parameters_of(bench, chosen_parameters(asked.parameters, own_parameters(bench)))
    model = asked.model or bench.spec.model
    scenarios = [find_scenario(bench, name) for name in dict.fromkeys(asked.scenario or bench.spec.scenarios)]
    require_buildable(bench, model, scenarios, values, realtime=asked.realtime)
    session = asked.session or own_session()
    bus_for(bench, asked.bus, session, asked.bench_bus)
    return Wish(asked, bench, model, scenarios, values, session)


def _folder_of(wish: Wish) -> RunFolder:
    """A new run folder, with the bench file as it was understood."""
    asked, bench = wish.asked, wish.bench
    identity = identity_of(bench, wish.model, wish.scenarios)
    record = {"command": "drive", "bench": str(asked.bench), "model": wish.model, "realtime": asked.realtime}
    record |= {**identity, "seed": asked.seed, "parameters": wish.values}
    run = RunFolder.create(asked.out or DEFAULT_ROOT, f"drive-{asked.bench.stem}", record)
    write_text(run.path / "bench.toml", resolved_toml(bench, wish.scenarios))
    return run


def _driven(wish: Wish, run: RunFolder) -> Generator[Event, None, tuple[dict[str, Episode], dict[str, float]]]:
    """(episodes by scenario, the pace that was kept)."""
    asked, bench = wish.asked, wish.bench
    with Session(
        run.path / "bench.toml",
        run.words(),
        session=wish.session,
        model=wish.model,
        bus=asked.bus,
        bench_bus=asked.bench_bus,
        realtime=asked.realtime,
        join=asked.join,
        jitted_ecu=is_heavy(bench, wish.model),
        controller_command=program_of(bench),
    ) as session:
        yield Event("note", f"bus: {session.choice.why}")
        if asked.join:
            run.note(**{JOINED: joined_name([session])})
        track = Track(session, bench, run, seed=asked.seed)
        episodes: dict[str, Episode] = {}
        try:
            for i, one in enumerate(wish.scenarios):
                episodes |= track.drive_all(wish.values, [one], i)
                yield from _told(wish, run, i, episodes[one.name], track.pace)
        finally:
            track.close()
        yield from (Event("warning", words) for words in session.notes)
    return episodes, track.pace


def _told(wish: Wish, run: RunFolder, i: int, episode: Episode, pace: Mapping[str, float]) -> Iterator[Event]:
    """How scenario i went, and what is to be known of it."""
    bench, name = wish.bench, wish.scenarios[i].name
    rest_s = sum(bench.course(later).ticks for later in wish.scenarios[i + 1 :]) * bench.dt_s
    eta_s = rest_s / pace.get("speed_x", 1.0)
    data = {"label": "scenario", "done": i + 1, "total": len(wish.scenarios), "eta_s": eta_s, **pace}
    yield Event("progress", _line(name, episode), data)
    yield from (Event("warning", f"{name}: {words}") for words in heard_of(run.episode(i)))
    words = drive_warning(bench, wish.model, name, episode.recording)
    yield from [Event("warning", words)] * bool(words)


def own_session() -> str:
    """A session name of our own, so that two runs on one machine do not meet."""
    return f"run-{os.getpid()}"


def chosen_parameters(texts: Iterable[str], own: Iterable[str] = ()) -> dict[str, float]:
    """NAME=VALUE pairs; own: names of somebody else's controller. Raises InputError that names a wrong one."""
    known = [*NAMES, *own]
    chosen = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name not in known:
            raise InputError(
                f"no parameter {name!r}", code="unknown_parameter", key="--parameter", hint=f"one of {', '.join(known)}"
            )
        try:
            chosen[name] = float(value)
        except ValueError:
            raise InputError(
                f"{text!r} gives no number", code="bad_parameter", key="--parameter", hint=f"--parameter {name}=0.1"
            ) from None
        require_in_box(name, chosen[name], key="--parameter")
    return chosen


def find_scenario(bench: Bench, name: str) -> ScenarioSpec:
    """A scenario of the bench file by its name there or its own, or any other file of that name or path."""
    own = {scenario.name: scenario for scenario in bench.scenarios.values()} | dict(bench.scenarios)
    return own[name] if name in own else load_scenario(name, bench.file)


def draw(run: RunFolder, episodes: Mapping[str, Episode], label: str = "drive") -> list[str]:
    """One figure a scenario."""
    from tunefree_hil.figures.scenario import Drive, write_scenario

    written = []
    for name, episode in episodes.items():
        graded = episode.grade
        one = Drive(label, episode.recording.columns, graded.score, early(graded.outcome))
        written.append(str(write_scenario(run.figures() / f"{name}.png", name, [one])))
    return written


def _line(name: str, episode: Episode) -> str:
    grade = episode.grade
    peak = grade.metrics.get("lateral_err_peak")
    lateral = f", lateral peak {0.5 * peak:.2f} m" if peak is not None else ""
    replans = f", {grade.replans} re-plans" if grade.replans else ""
    ended = error_text(episode.error_code) if episode.error_code else grade.outcome
    return f"{name}: score {grade.score:.3f}{lateral}{replans}, {ended}"


def _result(
    run: RunFolder,
    episodes: Mapping[str, Episode],
    score: float,
    figures: list[str],
    verdict: dict[str, Any] | None,
    more: dict[str, Any],
) -> Event:
    """more: goes into the data as it is; "outside" is said too."""
    failed = [name for name, episode in episodes.items() if episode.grade.outcome != FINISHED]
    many = "1 scenario" if len(episodes) == 1 else f"{len(episodes)} scenarios"
    sentence = f"{many} driven, score {score:.3f}"
    if failed:
        sentence += f"; not driven to the end: {', '.join(failed)}"
    beyond = outside_words(more["outside"])
    sentence += f"; {beyond}" if beyond else ""
    data: dict[str, Any] = {
        "run": str(run.path),
        "score": score,
        "scenarios": {name: episode.grade._asdict() for name, episode in episodes.items()},
        "hashes": {name: episode.hash for name, episode in episodes.items()},
        "figures": figures,
        "next": [
            pasted("replay", run.path, verify=True),
            pasted("log check", run.path / "episodes" / "0" / "vehicle.log"),
        ],
        **more,
    }
    if verdict is not None:
        data["realtime"] = verdict
        sentence += f"; {verdict['sentence']}"
        data["next"] = data["next"][1:]
        if not verdict["valid"]:
            data["exit"] = 4
    foreign = {hex(can_id): count for episode in episodes.values() for can_id, count in episode.foreign.items()}
    if foreign:
        data["foreign_frames"] = foreign
        sentence += f"; frames of other nodes on the bus: {foreign}"
    return Event("result", sentence, {"sentence": sentence, **data})
