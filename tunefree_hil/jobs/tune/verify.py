"""Verify: the winner and every baseline on the verify model, over scenarios that the tuner never saw.

Over the bus first, which alone says who is better; then their margins, in the batch (jobs/tune/margins.py).
"""

from __future__ import annotations

import time
import tomllib
from collections.abc import Generator, Iterator, Mapping
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, is_heavy, load, parameters_of
from tunefree_hil.jobs.drive import own_session
from tunefree_hil.jobs.learn.outside import outside_data, outside_words
from tunefree_hil.jobs.run_folder import RunFolder, open_run, write_json
from tunefree_hil.jobs.running.foreign import command_of
from tunefree_hil.jobs.running.harvest import Episode, evaluation_of
from tunefree_hil.jobs.running.session import lanes_of, open_lanes
from tunefree_hil.jobs.running.track import Track
from tunefree_hil.jobs.tune.candidates import TUNED, baseline_vectors
from tunefree_hil.jobs.tune.margins import find_margins
from tunefree_hil.jobs.tune.margins_report import margin_data, steering_data
from tunefree_hil.jobs.tune.margins_words import margin_table, margin_words
from tunefree_hil.jobs.words import comparison, failures, table
from tunefree_hil.tune.trial import Evaluation

NOT_HOLDING = 1  # exit status


def verify(run: Path, *, bus: str, bench_bus: str, join: bool, session: str) -> Iterator[Event]:
    """Drive again what `tune` verified at its end. Exit 1 when the winner does not hold: when a manual set is better,
    or a road is not driven to its end. That it holds says nothing of how good the best manual set is there.
    """
    folder = open_run(run)
    if folder.record.get("command") != "tune":
        raise InputError(
            f"is a run of {folder.record.get('command')!r}", file=str(run), hint="give the run folder of a tune"
        )
    loaded = load(folder.bench_file())
    found = yield from verify_winner(
        loaded, folder, bus=bus, bench_bus=bench_bus, session=session or own_session(), join=join
    )
    data = {"exit": 0 if found["holds"] else NOT_HOLDING, "run": str(run), **found}
    data["next"] = [f"tunefree-hil replay {run} --verify"]
    yield Event("result", found["sentence"], data)


def verify_winner(
    bench: Bench, run: RunFolder, *, bus: str, bench_bus: str, session: str, join: bool = False
) -> Generator[Event, None, dict[str, Any]]:
    """The comparison as data; events on the way. Writes verify.json and figures of the run."""
    model = bench.spec.verify_model
    if not model or not bench.spec.verify_scenarios:
        raise InputError("names no verify_model with verify_scenarios", file=bench.file, key="verify_model")
    vectors = {TUNED: parameters_of(bench, winner_of(run)), **baseline_vectors(bench)}
    results: dict[str, Evaluation] = {}
    columns: dict[str, Mapping[str, Episode]] = {}
    own = RunFolder(run.path / "verify", run.record)
    with open_lanes(
        lanes_of(join, bus),
        Path(bench.file),
        run.words(),
        session=f"{session}-verify",
        model=model,
        bus=bus,
        bench_bus=bench_bus,
        join=join,
        jitted_ecu=is_heavy(bench, model),
        controller_command=command_of(bench),
    ) as lanes:
        track = Track(lanes, bench, own)
        scenarios = [bench.scenarios[name] for name in bench.spec.verify_scenarios]
        started = time.monotonic()
        try:
            for i, (name, values) in enumerate(vectors.items()):
                episodes = track.drive_all(values, scenarios, i * len(scenarios))
                columns[name], results[name] = episodes, evaluation_of(episodes)
                eta_s = (time.monotonic() - started) / (i + 1) * (len(vectors) - i - 1)
                data = {"label": "verify", "done": i + 1, "total": len(vectors), "eta_s": eta_s, **track.pace}
                yield Event("progress", f"{name} scores {results[name].score:.3f} on {model}", data)
        finally:
            track.close()
    found = _compare(results)
    for line in table({n: e.scenarios for n, e in results.items()}, found["scores"]):
        yield Event("note", line)
    found["margins"] = yield from _margins(bench, model, vectors, columns, results)
    words = margin_words(found["margins"], TUNED)
    found["sentence"] += f"; {words}" if words else ""
    # The model that was tuned on must know what the winner does on the vehicle.
    winning = {name: episode.recording for name, episode in columns[TUNED].items()}
    found["outside"] = outside_data(bench, bench.spec.model, winning)
    beyond = outside_words(found["outside"])
    found["sentence"] += f"; {beyond}" if beyond else ""
    found["figures"] = _figures(run, columns, found)
    write_json(run.path / "verify.json", {"schema": "tunefree.verify/1", **found})
    return found


def _margins(
    bench: Bench,
    model: str,
    vectors: Mapping[str, Mapping[str, float]],
    columns: Mapping[str, Mapping[str, Episode]],
    results: Mapping[str, Evaluation],
) -> Generator[Event, None, dict[str, Any]]:
    """The value of "margins" in verify.json, its table as notes; a warning where batch and bus differ."""
    scenarios = [bench.scenarios[name] for name in bench.spec.verify_scenarios]
    found = yield from find_margins(bench, model, vectors, scenarios)
    steering = {name: steering_data(one.recording for one in some.values()) for name, some in columns.items()}
    over_bus = {name: {key: one.grade.score for key, one in some.items()} for name, some in columns.items()}
    data = margin_data(found, steering, {name: one.score for name, one in results.items()}, over_bus)
    for line in margin_table(data, TUNED):
        yield Event("note", line)
    same = data["same_as_bus"]
    if same and same["equal"] < same["of"]:
        yield Event("warning", f"batch and bus agree in {same['equal']} of {same['of']} scores of the car as it is")
    return data


def winner_of(run: RunFolder) -> dict[str, float]:
    """The complete winning vector of best.toml."""
    path = run.path / "best.toml"
    if not path.is_file():
        raise InputError(
            "has no best.toml: the study is not finished", file=str(run.path), hint="run the same tune command again"
        )
    return {name: float(value) for name, value in tomllib.loads(path.read_text())["parameters"].items()}


def _compare(results: Mapping[str, Evaluation]) -> dict[str, Any]:
    tuned = results[TUNED]
    others = {name: result for name, result in results.items() if name != TUNED}
    manual = min(others, key=lambda name: others[name].score)
    best = others[manual]
    sentence = comparison(manual, best.scenarios, tuned.scenarios, (best.score, tuned.score))
    return {
        "sentence": sentence,
        "holds": tuned.score < best.score and not failures(tuned.scenarios),
        "manual": manual,
        "ratio": tuned.score / best.score,
        "scores": {name: result.score for name, result in results.items()},
        "scenarios": {name: result.scenarios for name, result in results.items()},
    }


def _figures(run: RunFolder, columns: Mapping[str, Mapping[str, Episode]], found: Mapping[str, Any]) -> list[str]:
    from tunefree_hil.figures.margins import write_margins
    from tunefree_hil.figures.scenario import Drive, write_scenario

    manual, margins = found["manual"], found["margins"]
    written = [] if margins["reason"] else [str(write_margins(run.figures() / "margins.png", margins, TUNED))]
    for name in columns[TUNED]:
        drives = []
        for label, candidate in ((f"manual ({manual})", manual), (TUNED, TUNED)):
            episode = columns[candidate][name]
            early = "" if episode.grade.outcome == "finished" else episode.grade.outcome
            drives.append(Drive(label, episode.recording.columns, episode.grade.score, early))
        written.append(str(write_scenario(run.figures() / f"verify_{name}.png", f"{name} (verify)", drives)))
    return written
