"""The road sweep of a tune: its winner and the manual sets on roads that no search, choice or verification has driven.

Drives are appended to drives.jsonl as their chunks are finished. The same command continues an interrupted sweep, here
or on a cluster; the result follows from the drives alone and is that of an uninterrupted one.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, load
from tunefree_hil.config.check import parse_road_set
from tunefree_hil.grade.requirements.limits import RequirementLimits, requirement_limits
from tunefree_hil.jobs.command_text import changed_options, shell_command
from tunefree_hil.jobs.progress import count_data
from tunefree_hil.jobs.robustness.driving.chunk import DriveRow, FinishedChunk, drive_locally
from tunefree_hil.jobs.robustness.driving.drive_file import DriveFile
from tunefree_hil.jobs.robustness.judgement import DriveState, judge_row
from tunefree_hil.jobs.robustness.options import RobustnessOptions
from tunefree_hil.jobs.robustness.pictures import draw_sweep
from tunefree_hil.jobs.robustness.plan import (
    SWEEP_SEEDS,
    RoadSetOrder,
    SweepOrder,
    SweepPlan,
    has_known_shapes,
    make_plan,
)
from tunefree_hil.jobs.robustness.result import (
    SweepVerdict,
    decide_verdict,
    drive_data,
    find_worst_drives,
    judge_sweep,
    sweep_data,
)
from tunefree_hil.jobs.robustness.text import (
    drive_text,
    family_table,
    plan_text,
    set_table,
    sweep_sentence,
)
from tunefree_hil.jobs.robustness.worst_roads import MAX_ROADS, draw_worst_roads
from tunefree_hil.jobs.run_folder import JOINED, RunFolder, open_run, remove_partial_files, write_json
from tunefree_hil.jobs.tune.candidates import TUNED, compute_baseline_vectors, read_winner
from tunefree_hil.jobs.tune.margins import find_batch_obstacle
from tunefree_hil.roads.sets import PUBLIC
from tunefree_hil.tune.store import exclusive_lock

COMMAND, FOLDER = "robustness", "robustness"
DRIVES, RESULT, LOCK = "drives.jsonl", "robustness.json", "sweep"
SCHEMA = "tunefree.robustness/1"
EXIT_FAILED = 1  # exit status where the winner fails on more roads than allowed


class Sweep(NamedTuple):
    """A sweep in its folder. resume: the command that goes on."""

    options: RobustnessOptions
    bench: Bench
    plan: SweepPlan
    run: RunFolder
    resume: str


def sweep_roads(options: RobustnessOptions) -> Iterator[Event]:
    """Drive what is missing of a sweep, judge it, and draw it. Exit status 1 where the winner fails too often."""
    if options.scheduler:
        from tunefree_hil.jobs.robustness.driving.cluster import import_distributed, require_address

        require_address(options.scheduler)
        import_distributed()
    bench = _load_bench(options)
    plan = make_plan(bench, _make_order(options, bench))
    out = options.out or options.run / FOLDER / _folder_name(plan)
    resume = shell_command(COMMAND, options.run, **changed_options(options, skip=("run",)))
    out.mkdir(parents=True, exist_ok=True)
    with exclusive_lock(out / LOCK):
        file = DriveFile(out / DRIVES, plan.key)
        sweep = Sweep(options, bench, plan, _open_folder(out, plan), resume)
        yield Event("note", f"folder {out}", {"resume": resume, "saved": True})
        yield Event("note", plan_text(plan))
        if has_known_shapes(bench, plan.order):
            yield Event("warning", "the tune has driven the public roads too; only their starts and noise are new")
        yield from _drive_missing(sweep, file)
        yield (yield from _report(sweep, file))


def _load_bench(options: RobustnessOptions) -> Bench:
    """The bench of a finished tune. Raises InputError for another run, or a bench that the batch cannot drive."""
    run = open_run(options.run)
    command = run.record.get("command")
    if command != "tune":
        raise InputError(f"is a run of {command!r}", file=str(options.run), hint="give the run folder of a tune")
    bench = load(run.bench_file())
    obstacle = find_batch_obstacle(bench, run.record.get(JOINED))
    if obstacle:
        hint = "drive roads over the bus with `verify`"
        raise InputError(f"no road sweep: {obstacle}", code="not_in_batch", file=bench.file, hint=hint)
    return bench


def _make_order(options: RobustnessOptions, bench: Bench) -> SweepOrder:
    seed, chosen = SWEEP_SEEDS + options.seed, parse_road_set(options.roads)
    road_sets = [RoadSetOrder(chosen.name, chosen.count, seed)]
    if options.public and chosen.name != PUBLIC:
        public = parse_road_set(PUBLIC)
        road_sets.append(RoadSetOrder(public.name, public.count, seed))
    model = options.model or bench.spec.verify_model or bench.spec.model
    vectors = {TUNED: read_winner(bench, open_run(options.run)), **compute_baseline_vectors(bench)}
    return SweepOrder(model, tuple(road_sets), options.cars, seed, vectors)


def _folder_name(plan: SweepPlan) -> str:
    """'mkz_reference-robust1000-seed1'-like."""
    sets = "-".join(f"{one.name}{'' if one.name == PUBLIC else one.count}" for one in plan.order.road_sets)
    seed, cars = plan.order.seed - SWEEP_SEEDS, plan.order.cars
    return f"{Path(plan.order.model).name}-{sets}-{cars}cars-seed{seed}"


def _open_folder(out: Path, plan: SweepPlan) -> RunFolder:
    """The folder as a run, complete or not."""
    remove_partial_files(out)
    if (out / "run.json").is_file():
        return open_run(out)
    return RunFolder.begin(out, {"command": COMMAND, "identity": plan.key, "order": plan.order.as_data()})


def _drive_missing(sweep: Sweep, file: DriveFile) -> Iterator[Event]:
    """Drive the chunks that the file does not have."""
    plan = sweep.plan
    missing = [number for number in range(plan.chunks) if number not in file.chunks]
    if not missing:
        return
    if len(missing) < plan.chunks:
        yield Event("note", f"{plan.chunks - len(missing)} of {plan.chunks} chunks are driven already")
    where = sweep.options.scheduler or "this machine"
    yield Event("note", f"driven on {where}; a new bench is compiled first, which takes a minute")
    started, driven = time.monotonic(), 0
    limits = requirement_limits(sweep.bench.vehicle.limits, sweep.bench.spec.require)
    failed = {row.road for row in file.list_rows() if _is_failed_winner(row, limits)}
    total = sum(len(plan.list_drives(number)) for number in missing)
    for chunk in _finish_chunks(sweep, missing):
        file.append(chunk)
        driven += len(chunk.rows)
        failed |= {row.road for row in chunk.rows if _is_failed_winner(row, limits)}
        data = {**count_data("drive", driven, total, started), "failed_roads": len(failed)}
        rate = driven / (time.monotonic() - started)
        text = f"the winner has failed on {len(failed)} of {_count_roads(file)} roads; {rate:.0f} drives/s"
        yield Event("progress", text, {**data, "drives_per_s": rate, "resume": sweep.resume})


def _finish_chunks(sweep: Sweep, numbers: list[int]) -> Iterator[FinishedChunk]:
    """Drive chunks here or on the cluster."""
    if not sweep.options.scheduler:
        return drive_locally(sweep.plan, numbers)
    from tunefree_hil.jobs.robustness.driving.cluster import drive_on_cluster

    return drive_on_cluster(sweep.plan, numbers, sweep.options.scheduler)


def _is_failed_winner(row: DriveRow, limits: RequirementLimits) -> bool:
    return row.vector == 0 and judge_row(row, limits).state is not DriveState.PASSED


def _count_roads(file: DriveFile) -> int:
    return len({row.road for row in file.list_rows()})


def _report(sweep: Sweep, file: DriveFile) -> Generator[Event, None, Event]:
    """Judge the drives, draw, and write the result. Returns the result event."""
    options, plan, out = sweep.options, sweep.plan, sweep.run.path
    limits = requirement_limits(sweep.bench.vehicle.limits, sweep.bench.spec.require)
    result = judge_sweep(plan, file.list_rows(), limits)
    yield from (Event("note", line) for line in [*set_table(result), *family_table(plan, result)])
    worst = find_worst_drives(plan, result, MAX_ROADS)
    figures, commands, worst_data = draw_sweep(plan, result, out / "figures"), [], []
    texts = {drive: drive_text(drive, result.judgements[drive]) for drive in worst}
    for road in draw_worst_roads(plan, texts, result.best_manual, out):
        figures.append(road.figure)
        commands.append(road.command)
        worst_data.append(drive_data(plan, result, road.drive))
        yield Event("note", f"picture of a drive that was made again: {road.figure}")
    sentence = sweep_sentence(plan, result, worst, options.allowed)
    verdict = decide_verdict(result, options.allowed)
    data = {"verdict": verdict.value, "allowed": options.allowed, **sweep_data(plan, result)}
    data |= {"worst": worst_data, "sentence": sentence}
    write_json(out / RESULT, {"schema": SCHEMA, **data})
    sweep.run.finish()
    replayed = [{**entry, "command": command} for entry, command in zip(worst_data, commands, strict=True)]
    more = {"worst": replayed, "run": str(options.run), "out": str(out), "figures": figures, "next": commands[:1]}
    return Event("result", sentence, {**data, **more, "exit": EXIT_FAILED if verdict is SweepVerdict.FAILED else 0})
