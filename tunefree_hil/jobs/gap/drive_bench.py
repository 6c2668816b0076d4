"""The bench of `gap --drive`: its folder, and one manoeuvre after the other, from standstill to standstill.

Over the bus it is the bench of a collection (its ECU, and its planner in place of the controller). With `--bus virtual`
both nodes are stepped in turn within this process; the frames are the same.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, cast

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bench import Bench, VehicleFor, is_heavy, needed_messages
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.formats.rows import FD, Row
from tunefree_hil.bus.link import Sending
from tunefree_hil.bus.recording.frame_attribution import can_key
from tunefree_hil.collect.bounds import DriveBounds
from tunefree_hil.collect.plan import DrivePlan, plan_as_dict
from tunefree_hil.config.load import load_scenario
from tunefree_hil.config.schema import ScenarioSpec, VehicleSpec
from tunefree_hil.episode.candump import write_candump
from tunefree_hil.gap.experiment_design import AREA_M, Manoeuvre, plan_manoeuvre
from tunefree_hil.jobs.collect import plan as collect_plan
from tunefree_hil.jobs.collect.collect import FIRST_PARAMETER, require_stopped
from tunefree_hil.jobs.collect.plan import StartPose, drive_name, open_folder, resolve_setup, run_record, write_bench
from tunefree_hil.jobs.collector import PlannerAssigner
from tunefree_hil.jobs.gap.options import GapDriveOptions
from tunefree_hil.jobs.run_folder import RunFolder, write_json
from tunefree_hil.jobs.running.node_links import resolve_vehicle_bus
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession
from tunefree_hil.nodes.controller import ControllerPart
from tunefree_hil.nodes.ecu import EcuPart
from tunefree_hil.nodes.exchange import Exchange
from tunefree_hil.nodes.timing import CycleTimes

IN_PROCESS_BUS = "virtual"  # value of --bus: both nodes in this process
QUOTA_S, SEED = 6.0, 1  # for the record of the folder; each manoeuvre has its own duration


class ManoeuvreJob(NamedTuple):
    """A manoeuvre to drive: its number in the folder, its plan, and the file of its log."""

    number: int
    manoeuvre: Manoeuvre
    plan: DrivePlan
    log: Path


def require_same_vehicle(options: GapDriveOptions, vehicle: VehicleSpec) -> None:
    """Raise InputError for a bench of another vehicle than the logs, or of this vehicle from another folder."""
    bench_vehicle = resolve_setup(_collection_options(options, Path())).vehicle
    if bench_vehicle.name != vehicle.name:
        message = f"drives {bench_vehicle.name!r}, the logs are of {vehicle.name!r}"
    elif bench_vehicle.hash != vehicle.hash:
        message = f"drives {bench_vehicle.name!r} from another folder than {vehicle.folder}: {bench_vehicle.folder}"
    else:
        return
    hint = "name a bench file of the logs' vehicle"
    raise InputError(message, code="bench_of_other_vehicle", file=str(options.bench), key="--bench", hint=hint)


def open_bench(options: GapDriveOptions, folder: Path) -> tuple[RunFolder, Bench]:
    """Open the folder of the drives and its bench, new or continued. Raises InputError for another bench's folder."""
    collection = _collection_options(options, folder)
    setup = resolve_setup(collection)
    run = open_folder(setup.vehicle, collection, {**run_record(setup, collection), "command": "gap"})
    return run, write_bench(run, setup, collection)


def require_same_bench(options: GapDriveOptions, folder: Path) -> None:
    """Raise InputError where the drives in a folder were made by another bench."""
    collection = _collection_options(options, folder)
    setup = resolve_setup(collection)
    if (folder / "run.json").is_file():
        open_folder(setup.vehicle, collection, {**run_record(setup, collection), "command": "gap"})


def _collection_options(options: GapDriveOptions, folder: Path) -> collect_plan.CollectOptions:
    return collect_plan.CollectOptions(
        bench=options.bench,
        bus=options.bus,
        out=folder,
        quota_s=QUOTA_S,
        area_m=AREA_M,
        seed=SEED,
    )


def plan_jobs(
    run: RunFolder, bench: Bench, manoeuvres: Sequence[Manoeuvre], before: int, bounds: DriveBounds | None = None
) -> list[ManoeuvreJob]:
    """The manoeuvres that the vehicle can drive within bounds, numbered after the `before` drives in the folder."""
    jobs: list[ManoeuvreJob] = []
    for manoeuvre in manoeuvres:
        plan = plan_manoeuvre(bench.vehicle, manoeuvre, bench.dt_s, bounds)
        if plan is not None:
            number = before + len(jobs) + 1
            log = run.path / "logs" / f"{drive_name(number)}-{manoeuvre.name}.log"
            jobs.append(ManoeuvreJob(number, manoeuvre, plan, log))
    return jobs


def drive_jobs(run: RunFolder, bench: Bench, jobs: Sequence[ManoeuvreJob], options: GapDriveOptions) -> Iterator[Event]:
    """Drive the jobs that have no log yet. Raises BenchError for a drive that does not come to its end."""
    missing = [job for job in jobs if not job.log.is_file()]
    if not missing:
        return
    if options.bus == IN_PROCESS_BUS:
        yield Event("note", "bus: none, both nodes in this process")
        for job in missing:
            yield from _drive_job(job, lambda scenario, folder: _drive_in_process(bench, scenario, folder), run)
        return
    session = f"gap-{os.getpid()}"
    resolve_vehicle_bus(bench, options.bus, session, "")
    heavy = is_heavy(bench, bench.spec.model)
    with BenchSession(
        run.path / "bench.toml",
        run.node_output(),
        BenchLaunch(session=session, bus=options.bus, jitted_ecu=heavy, controller_role="collector"),
    ) as opened:
        yield Event("note", f"bus: {opened.choice.why}")
        for job in missing:
            yield from _drive_job(
                job,
                lambda scenario, folder: (
                    opened.drive(scenario, scenario.noise_seed, FIRST_PARAMETER, folder).error_code
                ),
                run,
            )
        yield from (Event("warning", words) for words in opened.notes)


def _drive_job(job: ManoeuvreJob, drive: Callable[[ScenarioSpec, Path], int], run: RunFolder) -> Iterator[Event]:
    """Drive one job, and move its log to its place."""
    yield Event("note", f"driving {job.manoeuvre.description}")
    folder = run.episode(job.number)
    code = drive(_write_scenario(run, job), folder)
    require_stopped(code, job.manoeuvre.name, folder)
    os.replace(folder / "vehicle.log", job.log)


def _write_scenario(run: RunFolder, job: ManoeuvreJob) -> ScenarioSpec:
    """Write the scenario of a drive, and its plan beside it, where the planner reads them."""
    path = run.path / "scenarios" / f"{drive_name(job.number)}.toml"
    collect_plan.write_scenario(path, job.number, StartPose(), SEED, job.manoeuvre.drive_s)
    write_json(path.with_suffix(".json"), plan_as_dict(job.plan))
    return load_scenario(path)


def _drive_in_process(bench: Bench, scenario: ScenarioSpec, folder: Path) -> int:
    """Step both nodes in turn and write vehicle.log. Returns: the error code of the drive."""
    messages: list[str] = []
    codec, start = bench.codec, bytes.fromhex(scenario.hash)[:6]
    ecu = EcuPart(codec, VehicleFor(bench, bench.spec.model), CycleTimes(), messages.append)
    planner = ControllerPart(codec, needed_messages(codec), PlannerAssigner(bench), CycleTimes(), messages.append)
    ecu.load(start, scenario.noise_seed, {})
    planner.load(start, scenario.noise_seed, {})
    planner.decoder.reception.expect_every_period()
    turn = InProcessExchange(planner)
    ecu.lockstep(cast(Exchange, turn), lambda message: False)
    write_candump(folder / "vehicle.log", turn.rows)
    return turn.code


class InProcessExchange:
    """An exchange for the ECU's lockstep in which the reply to its frames is the next cycle of the planner."""

    def __init__(self, planner: ControllerPart) -> None:
        self.planner = planner
        self.rows: list[Row] = []
        self.code = 0
        self._sent: list[CanFrame] = []

    def prepare(self, k: int, phase: int, frames: list[CanFrame], *before: Any) -> Sending:
        """Take the ECU's frames of a tick, when it calls what is returned."""
        return partial(self._announce, frames)

    def _announce(self, frames: list[CanFrame]) -> None:
        self._sent = self._logged(frames)

    def await_phase(self, k: int, phase: int, interrupt: Callable[[Any], bool]) -> list[CanFrame]:
        """The planner's frames of the same tick; its messages about the end of a drive come first."""
        reply, messages = self.planner.cycle(k, self._sent)
        for message in messages:
            interrupt(message)
        return self._logged(reply)

    def send_messages(self, *messages: Any, k: int = 0) -> None:
        """Keep the error code of the ECU's last status."""
        statuses = [message for message in messages if isinstance(message, bc.Status)]
        self.code = next((status.error_code for status in statuses), self.code)

    def _logged(self, frames: list[CanFrame]) -> list[CanFrame]:
        ordered = sorted(frames, key=can_key)
        self.rows += [Row(one.time_s, "can0", can_key(one), one.data, FD if one.fd else 0) for one in ordered]
        return ordered
