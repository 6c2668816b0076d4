"""Drive scenarios of a bench file over the bus, with given parameters, and score them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

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
from tunefree_hil.config.load import load_scenario
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.control.parameters import NAMES
from tunefree_hil.grade.score import combine
from tunefree_hil.jobs.identity import identity_of, resolved_toml
from tunefree_hil.jobs.learn.model_words import model_words
from tunefree_hil.jobs.learn.outside import drive_warning, outside_data, outside_words
from tunefree_hil.jobs.run_folder import RunFolder, write_text
from tunefree_hil.jobs.running.foreign import command_of, with_command
from tunefree_hil.jobs.running.harvest import Episode
from tunefree_hil.jobs.running.heard import heard_of
from tunefree_hil.jobs.running.lateness import judge_realtime
from tunefree_hil.jobs.running.node_links import bus_for
from tunefree_hil.jobs.running.session import Session
from tunefree_hil.jobs.running.track import Track

DEFAULT_ROOT = Path("runs")


def drive(
    bench: Path,
    *,
    scenario: Sequence[str],
    model: str | None,
    bus: str,
    bench_bus: str,
    seed: int | None,
    realtime: bool,
    join: bool,
    session: str,
    out: Path | None,
    parameters: list[str],
    controller: str = "",
) -> Iterator[Event]:
    """Drive the scenarios that are named, or all of the bench file. Real time: exit 4 when it was not."""
    loaded = with_command(load(bench), controller)
    chosen = chosen_parameters(parameters, own_parameters(loaded))
    values = parameters_of(loaded, chosen)
    model_name = model or loaded.spec.model
    scenarios = [find_scenario(loaded, name) for name in dict.fromkeys(scenario or loaded.spec.scenarios)]
    require_buildable(loaded, model_name, scenarios, values, realtime=realtime)
    session = session or own_session()
    bus_for(loaded, bus, session, bench_bus)
    identity = identity_of(loaded, model_name, scenarios)
    record = {"command": "drive", "bench": str(bench), "model": model_name, "realtime": realtime, **identity}
    run = RunFolder.create(out or DEFAULT_ROOT, f"drive-{bench.stem}", {**record, "seed": seed, "parameters": values})
    write_text(run.path / "bench.toml", resolved_toml(loaded, scenarios))
    yield Event("note", f"run folder {run.path}")
    yield Event("note", model_words(model_of(loaded, model_name)))
    with Session(
        run.path / "bench.toml",
        run.words(),
        session=session,
        model=model_name,
        bus=bus,
        bench_bus=bench_bus,
        realtime=realtime,
        join=join,
        jitted_ecu=is_heavy(loaded, model_name),
        controller_command=command_of(loaded),
    ) as bench_session:
        yield Event("note", f"bus: {bench_session.choice.why}")
        track = Track(bench_session, loaded, run, seed=seed)
        episodes: dict[str, Episode] = {}
        try:
            for i, one in enumerate(scenarios):
                episodes |= track.drive_all(values, [one], i)
                rest_s = sum(loaded.course(later).ticks for later in scenarios[i + 1 :]) * loaded.dt_s
                eta_s = rest_s / track.pace.get("speed_x", 1.0)
                data = {"label": "scenario", "done": i + 1, "total": len(scenarios), "eta_s": eta_s, **track.pace}
                yield Event("progress", _line(one.name, episodes[one.name]), data)
                yield from (Event("warning", f"{one.name}: {words}") for words in heard_of(run.episode(i)))
                words = drive_warning(loaded, model_name, one.name, episodes[one.name].recording)
                yield from [Event("warning", words)] * bool(words)
        finally:
            track.close()
        yield from (Event("warning", words) for words in bench_session.notes)
    figures = draw(run, episodes)
    verdict = judge_realtime(run, range(len(scenarios)), loaded.codec) if realtime else None
    score = combine([episode.grade for episode in episodes.values()])
    run.finish(score=score, frame_hashes={name: episode.hash for name, episode in episodes.items()})
    beyond = outside_data(loaded, model_name, {name: episode.recording for name, episode in episodes.items()})
    yield _result(run, episodes, score, figures, verdict, {**track.pace, "outside": beyond})


def own_session() -> str:
    """A session name of our own, so that two runs on one machine do not meet."""
    return f"run-{os.getpid()}"


def chosen_parameters(texts: list[str], own: Iterable[str] = ()) -> dict[str, float]:
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

    return [
        str(
            write_scenario(
                run.figures() / f"{name}.png",
                name,
                [Drive(label, episode.recording.columns, episode.grade.score, _early(episode))],
            )
        )
        for name, episode in episodes.items()
    ]


def _early(episode: Episode) -> str:
    return "" if episode.grade.outcome == "finished" else episode.grade.outcome


def _line(name: str, episode: Episode) -> str:
    grade = episode.grade
    peak = grade.metrics.get("lateral_err_peak")
    lateral = f", lateral peak {0.5 * peak:.2f} m" if peak is not None else ""
    replans = f", {grade.replans} re-plans" if grade.replans else ""
    return f"{name}: score {grade.score:.3f}{lateral}{replans}, {grade.outcome}"


def _result(
    run: RunFolder,
    episodes: Mapping[str, Episode],
    score: float,
    figures: list[str],
    verdict: dict[str, Any] | None,
    more: dict[str, Any],
) -> Event:
    """more: goes into the data as it is; "outside" is said too."""
    failed = [name for name, episode in episodes.items() if episode.grade.outcome != "finished"]
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
            f"tunefree-hil replay {run.path} --verify",
            f"tunefree-hil log check {run.path}/episodes/0/vehicle.log",
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
