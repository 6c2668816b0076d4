"""Verify: the winner and every baseline on the verify model, over scenarios that the tuner never saw.

Over the bus first, which alone says who is better; then their margins, in the batch (jobs/tune/margins.py).
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Mapping
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, is_heavy, load
from tunefree_hil.jobs.command_text import pasted
from tunefree_hil.jobs.drive import own_session
from tunefree_hil.jobs.learn.report_text import outside_data, outside_words
from tunefree_hil.jobs.progress import left_s
from tunefree_hil.jobs.report_text import comparison, early, failures, table
from tunefree_hil.jobs.run_folder import JOINED, RunFolder, open_run, write_json
from tunefree_hil.jobs.running.episode_results import Episode, evaluation_of
from tunefree_hil.jobs.running.foreign import joined_name, program_of
from tunefree_hil.jobs.running.session import lanes_of, open_lanes
from tunefree_hil.jobs.running.trial_driver import Track
from tunefree_hil.jobs.tune.candidates import TUNED, baseline_vectors, winner_of
from tunefree_hil.jobs.tune.margins import find_margins, margin_data, margin_table, margin_words, steering_data
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
    data["next"] = [pasted("replay", run, verify=True)]
    yield Event("result", found["sentence"], data)


def verify_winner(
    bench: Bench, run: RunFolder, *, bus: str, bench_bus: str, session: str, join: bool = False
) -> Generator[Event, None, dict[str, Any]]:
    """The comparison as data; events on the way. Writes verify.json and figures of the run."""
    model = bench.spec.verify_model
    if not model or not bench.spec.verify_scenarios:
        raise InputError("names no verify_model with verify_scenarios", file=bench.file, key="verify_model")
    vectors = {TUNED: winner_of(bench, run), **baseline_vectors(bench)}
    with open_lanes(
        lanes_of(join, bus),
        Path(bench.file),
        run.words(),
        session=session if join else f"{session}-verify",
        model=model,
        bus=bus,
        bench_bus=bench_bus,
        join=join,
        jitted_ecu=is_heavy(bench, model),
        controller_command=program_of(bench),
    ) as lanes:
        track = Track(lanes, bench, RunFolder(run.path / "verify", run.record))
        columns = yield from _driven(track, bench, vectors)
        joined = joined_name(lanes) if join else run.record.get(JOINED)
    results = {name: evaluation_of(episodes) for name, episodes in columns.items()}
    found = _compare(results)
    for line in table({n: e.scenarios for n, e in results.items()}, found["scores"]):
        yield Event("note", line)
    found["margins"] = yield from _margins(bench, model, vectors, columns, results, joined)
    # The model that was tuned on must know what the winner does on the vehicle.
    winning = {name: episode.recording for name, episode in columns[TUNED].items()}
    found["outside"] = outside_data(bench, bench.spec.model, winning)
    more = (margin_words(found["margins"], TUNED), outside_words(found["outside"]))
    found["sentence"] = "; ".join(words for words in (found["sentence"], *more) if words)
    found["figures"] = _figures(run, columns, found)
    write_json(run.path / "verify.json", {"schema": "tunefree.verify/1", **found})
    return found


def _driven(
    track: Track, bench: Bench, vectors: Mapping[str, Mapping[str, float]]
) -> Generator[Event, None, dict[str, Mapping[str, Episode]]]:
    """The episodes of every vector, by scenario. Closes the track."""
    scenarios = [bench.scenarios[name] for name in bench.spec.verify_scenarios]
    columns: dict[str, Mapping[str, Episode]] = {}
    started = time.monotonic()
    try:
        for i, (name, values) in enumerate(vectors.items()):
            columns[name] = track.drive_all(values, scenarios, i * len(scenarios))
            eta_s = left_s(started, (i + 1) / len(vectors))
            data = {"label": "verify", "done": i + 1, "total": len(vectors), "eta_s": eta_s, **track.pace}
            score = evaluation_of(columns[name]).score
            yield Event("progress", f"{name} scores {score:.3f} on {bench.spec.verify_model}", data)
    finally:
        track.close()
    return columns


def _margins(
    bench: Bench,
    model: str,
    vectors: Mapping[str, Mapping[str, float]],
    columns: Mapping[str, Mapping[str, Episode]],
    results: Mapping[str, Evaluation],
    joined: str | None,
) -> Generator[Event, None, dict[str, Any]]:
    """The value of "margins" in verify.json, its table as notes; a warning where batch and bus differ."""
    scenarios = [bench.scenarios[name] for name in bench.spec.verify_scenarios]
    found = yield from find_margins(bench, model, vectors, scenarios, joined)
    steering = {name: steering_data(one.recording for one in some.values()) for name, some in columns.items()}
    over_bus = {name: {key: one.grade.score for key, one in some.items()} for name, some in columns.items()}
    data = margin_data(found, steering, {name: one.score for name, one in results.items()}, over_bus)
    for line in margin_table(data, TUNED):
        yield Event("note", line)
    same = data["same_as_bus"]
    if same and same["equal"] < same["of"]:
        yield Event("warning", f"batch and bus agree in {same['equal']} of {same['of']} scores of the car as it is")
    return data


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
    from tunefree_hil.figures.scenario import Drive, write_scenario
    from tunefree_hil.figures.tuning.margins import write_margins

    manual, margins = found["manual"], found["margins"]
    written = [] if margins["reason"] else [str(write_margins(run.figures() / "margins.png", margins, TUNED))]
    for name in columns[TUNED]:
        drives = []
        for label, candidate in ((f"manual ({manual})", manual), (TUNED, TUNED)):
            episode = columns[candidate][name]
            graded = episode.grade
            drives.append(Drive(label, episode.recording.columns, graded.score, early(graded.outcome)))
        written.append(str(write_scenario(run.figures() / f"verify_{name}.png", f"{name} (verify)", drives)))
    return written
