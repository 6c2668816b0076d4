"""Guided collection over the bus: drive after drive, each from standstill to standstill, until every cell is full.

Each drive is a plain CAN log in `logs/`. What has been covered is counted from these logs alone, so a collection that
was cut off anywhere goes on with the drive that it lost.
"""

from __future__ import annotations

import os
import shlex
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import BenchError, NoAnswer, PeerGone
from tunefree_hil.base.events import Event
from tunefree_hil.bench import is_heavy
from tunefree_hil.bus.bench_channel import ErrorCode
from tunefree_hil.collect.coverage import map_lines
from tunefree_hil.collect.envelope import Beyond
from tunefree_hil.collect.features import lacking
from tunefree_hil.config.load import load_scenario
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.jobs.collect.picture import draw_map
from tunefree_hil.jobs.collect.plan import (
    Asked,
    Start,
    drive_name,
    open_folder,
    prepare,
    record_of,
    require_room,
    vehicle_and_model,
    write_plan,
)
from tunefree_hil.jobs.collect.state import IDLE_DRIVES, Collection
from tunefree_hil.jobs.command_text import PROGRAM, given, pasted
from tunefree_hil.jobs.run_folder import RunFolder, remove_parts
from tunefree_hil.jobs.running.node_links import bus_for
from tunefree_hil.jobs.running.session import Session

ANY_PARAMETER = {"mrac.p": 0.01}  # the planner has none; a node begins to load with the first it is told
HELD = "worker"  # its lock is held as long as a process collects
REPEATS = 2  # of a drive that lost a node, before the collection gives up
NOT_FULL = 1  # exit status: what was asked for does not hold


def collect(asked: Asked) -> Iterator[Event]:
    """Drive until every cell is full. Exit 1 where drives bring nothing more; the logs stand in the run folder."""
    from tunefree_hil.tune.store import alone  # brings Optuna

    vehicle, model, effects = vehicle_and_model(asked)
    require_room(vehicle, asked)
    record = record_of(vehicle, model, asked, effects)
    run = open_folder(vehicle, asked, record)
    with alone(run.path / HELD):  # two processes would write the same drives
        yield from _collected(run, vehicle, model, asked, effects)


def _collected(run: RunFolder, vehicle: VehicleSpec, model: str, asked: Asked, effects: list[Any]) -> Iterator[Event]:
    """In its run folder: what is there already, and what is still to be driven."""
    remove_parts(run.path)
    bench = prepare(run, vehicle, model, asked, effects)
    collection = Collection(run, bench, asked)
    yield Event("note", f"run folder {run.path}", {"resume": again(asked._replace(out=run.path))})
    yield from (Event("warning", words) for words in lacking(vehicle))
    collection.take_up()
    if collection.driven:
        yield Event("note", f"{len(collection.driven)} drives are there already: {collection.words}")
    if collection.wants_more:
        yield from _drive_on(collection)
    yield from _finish(collection)


def _drive_on(collection: Collection) -> Iterator[Event]:
    """Drive until all is full or nothing more comes."""
    asked, bench, run = collection.asked, collection.bench, collection.run
    session = asked.session or f"collect-{os.getpid()}"
    bus_for(bench, asked.bus, session, asked.bench_bus)
    with Session(
        run.path / "bench.toml",
        run.words(),
        session=session,
        bus=asked.bus,
        bench_bus=asked.bench_bus,
        realtime=asked.realtime,
        jitted_ecu=is_heavy(bench, bench.spec.model),
        controller_role="collector",
    ) as open_session:
        yield Event("note", f"bus: {open_session.choice.why}")
        started, had_s, drives = time.monotonic(), collection.coverage.had_s, len(collection.driven)
        while collection.wants_more:
            yield from _one(collection, open_session)
            collection.write()
            wall_s = time.monotonic() - started
            gained_s = collection.coverage.had_s - had_s
            left_s = collection.coverage.needed_s - collection.coverage.had_s
            driven_s = sum(one.seconds for one in collection.driven[drives:])
            data = {
                "label": "cells",
                "done": collection.coverage.full,
                "total": collection.coverage.wanted,
                "speed_x": driven_s / max(wall_s, 1e-6),
                "block": map_lines(collection.coverage),
                **({"eta_s": wall_s * left_s / gained_s} if gained_s > 0.0 else {}),
            }
            yield Event("progress", f"{collection.driven[-1].name}: {collection.words}", data)
        yield from (Event("warning", words) for words in open_session.notes)


def _one(collection: Collection, session: Session) -> Iterator[Event]:
    """The next drive into logs/; it is repeated where a node was lost. Raises BenchError where that does not help."""
    number, run = len(collection.driven) + 1, collection.run
    start = collection.driven[-1].end if collection.driven else Start()
    path = write_plan(
        run, number, collection.asked, start, collection.centre, collection.coverage, collection.next_stretches
    )
    scenario = load_scenario(path)
    folder = run.episode(number)
    for lost in range(REPEATS + 1):
        try:
            outcome = session.drive(scenario, scenario.noise_seed, ANY_PARAMETER, folder)
            break
        except BenchError as error:
            if lost == REPEATS or not isinstance(error, PeerGone | NoAnswer):
                raise
            first = error.message.splitlines()[0]
            yield Event("warning", f"{drive_name(number)}: {first} The bench is started anew, the drive repeated.")
            session.reopen()
    require_stopped(outcome.error_code, drive_name(number), folder)
    os.replace(folder / "vehicle.log", collection.logs / f"{drive_name(number)}.log")
    taken = collection.take(number)
    if taken.beyond.total_s > 0.0:
        yield Event(
            "warning", f"{taken.name}: {taken.beyond.total_s:.2f} s beyond the envelope: {_where(taken.beyond)}"
        )


def require_stopped(code: int, name: str, folder: Path) -> None:
    """A drive ends by the planner's own word, standing; anything else is no drive, and raises BenchError."""
    if code == ErrorCode.STOPPED:
        return
    why = ErrorCode(code).sentence if code else "the vehicle did not come to a stop in time"
    raise BenchError(
        f"{name}: {why}",
        code=ErrorCode(code).name.lower() if code else "not_stopped",
        file=str(folder),
        hint="the same command drives it again; the frames of this one: vehicle.log there",
    )


def _finish(collection: Collection) -> Iterator[Event]:
    """Files, picture, map, and how it ended."""
    run, coverage = collection.run, collection.coverage
    collection.write()
    title = f"{coverage.vehicle.name}: {coverage.full} of {coverage.wanted} cells after {len(collection.driven)} drives"
    figure = draw_map(run.figures() / "coverage.png", coverage, title)
    yield from (Event("line", line) for line in map_lines(coverage))
    missing = coverage.missing()
    out_s = sum(one.beyond.total_s for one in collection.driven)
    sentence = f"{collection.words}; {out_s:.2f} s beyond the envelope"
    if missing:
        sentence += f"; the last {IDLE_DRIVES} drives filled nothing more, missing: {'; '.join(missing[:6])}"
        sentence += f" and {len(missing) - 6} more" if len(missing) > 6 else ""
    run.finish(cells_full=coverage.full, cells_wanted=coverage.wanted, simulated_s=collection.simulated_s)
    logs = str(collection.logs)
    yield Event(
        "result",
        sentence,
        {
            "sentence": sentence,
            "run": str(run.path),
            "logs": [f"{logs}/{one.name}.log" for one in collection.driven],
            "cells_full": coverage.full,
            "cells_wanted": coverage.wanted,
            "missing": missing,
            "simulated_s": collection.simulated_s,
            "beyond_envelope_s": out_s,
            "figures": [str(figure)],
            "exit": NOT_FULL if missing else 0,
            "next": [_next(collection)],
        },
    )


def _next(collection: Collection) -> str:
    """What to do with the logs, which the shell finds: there are many."""
    logs = f"{shlex.quote(str(collection.logs))}/*.log"
    return f"{PROGRAM} calibrate {logs} --vehicle {shlex.quote(collection.coverage.vehicle.folder)} --out MODEL"


def _where(out: Beyond) -> str:
    return ", ".join(f"{name.removesuffix('_s')} {value:.2f} s" for name, value in out._asdict().items() if value > 0.0)


def again(asked: Asked) -> str:
    """The command once more; with the run folder as `out` it goes on there."""
    return pasted("collect", asked.bench, **given(asked, leave=["bench"]))
