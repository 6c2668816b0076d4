"""Guided collection over the bus: drives from standstill to standstill, until every cell is full.

Each drive is a CAN log in `logs/`. Coverage is counted from these logs only, so an interrupted collection continues
with the lost drive.
"""

from __future__ import annotations

import os
import shlex
import time
from collections.abc import Iterator
from pathlib import Path

from tunefree_hil.base.errors import BenchError, NoAnswer, PeerGone
from tunefree_hil.base.events import Event
from tunefree_hil.bench import is_heavy
from tunefree_hil.bus.bench_channel import ErrorCode
from tunefree_hil.collect.coverage import coverage_map_lines
from tunefree_hil.collect.envelope import EnvelopeExcess
from tunefree_hil.collect.features import describe_missing_reports
from tunefree_hil.config.load import load_scenario
from tunefree_hil.jobs.collect.picture import draw_map
from tunefree_hil.jobs.collect.plan import (
    CollectSetup,
    drive_name,
    open_folder,
    require_area,
    resolve_setup,
    run_record,
    write_bench,
)
from tunefree_hil.jobs.collect.state import IDLE_DRIVES, Collection
from tunefree_hil.jobs.command_text import PROGRAM, changed_options, shell_command
from tunefree_hil.jobs.options.records import CollectOptions
from tunefree_hil.jobs.run_folder import RunFolder, remove_partial_files
from tunefree_hil.jobs.running.node_links import resolve_vehicle_bus
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession

# The planner has no parameters; a node starts loading with the first one that it receives.
FIRST_PARAMETER = {"mrac.p": 0.01}
LOCK = "worker"  # locked while a process collects
REPEATS = 2  # of a drive that lost a node
EXIT_NOT_FULL = 1  # exit status


def collect(options: CollectOptions) -> Iterator[Event]:
    """Drive until every cell is full. Exit 1 where further drives fill no more cells."""
    from tunefree_hil.tune.store import exclusive_lock  # imports Optuna

    setup = resolve_setup(options)
    require_area(setup.vehicle, options)
    run = open_folder(setup.vehicle, options, run_record(setup, options))
    with exclusive_lock(run.path / LOCK):  # two processes must not write the same drives
        yield from _collect_in(run, setup, options)


def _collect_in(run: RunFolder, setup: CollectSetup, options: CollectOptions) -> Iterator[Event]:
    """Collect in a run folder: count the existing drives, then drive the missing ones."""
    remove_partial_files(run.path)
    collection = Collection(run, write_bench(run, setup, options), options)
    yield Event("note", f"run folder {run.path}", {"resume": resume_command(options._replace(out=run.path))})
    yield from (Event("warning", text) for text in describe_missing_reports(setup.vehicle))
    collection.count_existing()
    if collection.driven:
        yield Event("note", f"{len(collection.driven)} existing drives: {collection.progress_text}")
    if collection.wants_more:
        yield from _drive_until_full(collection)
    yield from _finish(collection)


def _drive_until_full(collection: Collection) -> Iterator[Event]:
    """Drive until all cells are full, or further drives fill no more."""
    options, bench, run = collection.options, collection.bench, collection.run
    session = options.session or f"collect-{os.getpid()}"
    resolve_vehicle_bus(bench, options.bus, session, options.bench_bus)
    bus = {"bus": options.bus, "bench_bus": options.bench_bus, "realtime": options.realtime}
    jitted_ecu = is_heavy(bench, bench.spec.model)
    launch = BenchLaunch(session, jitted_ecu=jitted_ecu, controller_role="collector", **bus)
    with BenchSession(run.path / "bench.toml", run.node_output(), launch) as open_session:
        yield Event("note", f"bus: {open_session.choice.why}")
        started, had_s, drives = time.monotonic(), collection.coverage.collected_s, len(collection.driven)
        while collection.wants_more:
            yield from _drive_next(collection, open_session)
            collection.write()
            wall_s = time.monotonic() - started
            gained_s = collection.coverage.collected_s - had_s
            left_s = collection.coverage.needed_s - collection.coverage.collected_s
            driven_s = sum(one.seconds for one in collection.driven[drives:])
            data = {
                "label": "cells",
                "done": collection.coverage.full,
                "total": collection.coverage.wanted,
                "speed_x": driven_s / max(wall_s, 1e-6),
                "block": coverage_map_lines(collection.coverage),
                **({"eta_s": wall_s * left_s / gained_s} if gained_s > 0.0 else {}),
            }
            yield Event("progress", f"{collection.driven[-1].name}: {collection.progress_text}", data)
        yield from (Event("warning", text) for text in open_session.notes)


def _drive_next(collection: Collection, session: BenchSession) -> Iterator[Event]:
    """Drive the next log; repeated where a node was lost. Raises BenchError after REPEATS repetitions."""
    number = len(collection.driven) + 1
    scenario, folder = load_scenario(collection.write_plan(number)), collection.run.episode(number)
    for lost in range(REPEATS + 1):
        try:
            outcome = session.drive(scenario, scenario.noise_seed, FIRST_PARAMETER, folder)
            break
        except BenchError as error:
            if lost == REPEATS or not isinstance(error, PeerGone | NoAnswer):
                raise
            first = error.message.splitlines()[0]
            yield Event("warning", f"{drive_name(number)}: {first} The bench is restarted and the drive repeated.")
            session.reopen()
    require_stopped(outcome.error_code, drive_name(number), folder)
    os.replace(folder / "vehicle.log", collection.logs / f"{drive_name(number)}.log")
    taken = collection.count_drive(number)
    if taken.beyond.total_s > 0.0:
        text = f"{taken.beyond.total_s:.2f} s beyond the envelope: {_excess_text(taken.beyond)}"
        yield Event("warning", f"{taken.name}: {text}")


def require_stopped(code: int, name: str, folder: Path) -> None:
    """Raise BenchError where a drive was not ended by the planner at standstill."""
    if code == ErrorCode.STOPPED:
        return
    why = ErrorCode(code).sentence if code else "the vehicle did not come to a stop in time"
    message = f"{name}: {why}"
    hint = "the same command drives it again; its frames are in vehicle.log there"
    raise BenchError(message, code=ErrorCode(code).name.lower() if code else "not_stopped", file=str(folder), hint=hint)


def _finish(collection: Collection) -> Iterator[Event]:
    """Write coverage.json and the figure, print the map and the result."""
    run, coverage = collection.run, collection.coverage
    collection.write()
    title = f"{coverage.vehicle.name}: {coverage.full} of {coverage.wanted} cells after {len(collection.driven)} drives"
    figure = draw_map(run.figures() / "coverage.png", coverage, title)
    yield from (Event("line", line) for line in coverage_map_lines(coverage))
    missing = coverage.missing()
    out_s = sum(one.beyond.total_s for one in collection.driven)
    sentence = f"{collection.progress_text}; {out_s:.2f} s beyond the envelope"
    if missing:
        sentence += f"; the last {IDLE_DRIVES} drives filled no more cells; missing: {'; '.join(missing[:6])}"
        sentence += f" and {len(missing) - 6} more" if len(missing) > 6 else ""
    run.finish(cells_full=coverage.full, cells_wanted=coverage.wanted, simulated_s=collection.simulated_s)
    data = {
        "sentence": sentence,
        "run": str(run.path),
        "logs": [f"{collection.logs}/{one.name}.log" for one in collection.driven],
        "cells_full": coverage.full,
        "cells_wanted": coverage.wanted,
        "missing": missing,
        "simulated_s": collection.simulated_s,
        "beyond_envelope_s": out_s,
        "figures": [str(figure)],
        "exit": EXIT_NOT_FULL if missing else 0,
        "next": [_next(collection)],
    }
    yield Event("result", sentence, data)


def _next(collection: Collection) -> str:
    """The next command; the logs as a shell pattern, because there are many."""
    logs = f"{shlex.quote(str(collection.logs))}/*.log"
    return f"{PROGRAM} calibrate {logs} --vehicle {shlex.quote(collection.coverage.vehicle.folder)} --out MODEL"


def _excess_text(out: EnvelopeExcess) -> str:
    return ", ".join(f"{name.removesuffix('_s')} {value:.2f} s" for name, value in out._asdict().items() if value > 0.0)


def resume_command(options: CollectOptions) -> str:
    """The command to continue; with the run folder as `out` it continues there."""
    return shell_command("collect", options.bench, **changed_options(options, skip=["bench"]))
