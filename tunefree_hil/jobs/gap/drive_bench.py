"""The bench that drives what separates: its folder, and one manoeuvre after the other, from standstill to standstill.

Over the bus it is the bench of a collection (its ECU, its planner in the controller's place). With `--bus virtual` both
nodes are stepped in turn within this process; the frames are the same.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bench import Bench, VehicleFor, is_heavy, needed_messages
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.formats.rows import FD, Row
from tunefree_hil.bus.recording.frame_attribution import can_key
from tunefree_hil.collect.bounds import Bounds
from tunefree_hil.collect.plan import DrivePlan, as_dict
from tunefree_hil.config.load import load_scenario
from tunefree_hil.config.schema import ScenarioSpec, VehicleSpec
from tunefree_hil.episode.candump import write_candump
from tunefree_hil.gap.experiment_design import AREA_M, Manoeuvre, plan_for
from tunefree_hil.jobs.collect import plan as collect_plan
from tunefree_hil.jobs.collect.collect import ANY_PARAMETER, require_stopped
from tunefree_hil.jobs.collect.plan import Start, drive_name, open_folder, prepare, record_of, vehicle_and_model
from tunefree_hil.jobs.collector import PlannerFor
from tunefree_hil.jobs.run_folder import RunFolder, write_json
from tunefree_hil.jobs.running.node_links import bus_for
from tunefree_hil.jobs.running.session import Session
from tunefree_hil.nodes.controller import ControllerPart
from tunefree_hil.nodes.ecu import EcuPart
from tunefree_hil.nodes.exchange import Exchange
from tunefree_hil.nodes.timing import CycleTimes

INSIDE = "virtual"  # --bus: no process but this one
QUOTA_S, SEED = 6.0, 1  # as the folder's record has them; each manoeuvre has its own quota


class Wish(NamedTuple):
    """What `--drive` asks for: a bench file, and over which bus."""

    bench: Path
    bus: str = "auto"
    session: str = ""


class Job(NamedTuple):
    """A manoeuvre to drive: its number among all of the folder, its plan, and where its log goes."""

    number: int
    manoeuvre: Manoeuvre
    plan: DrivePlan
    log: Path


def require_same_vehicle(wish: Wish, vehicle: VehicleSpec) -> None:
    """Raises InputError for a bench of another vehicle than the logs', or of this one with another folder."""
    found, _, _ = vehicle_and_model(_collection(wish, Path()))
    if found.name != vehicle.name:
        what = f"drives {found.name!r}, the logs are of {vehicle.name!r}"
    elif found.hash != vehicle.hash:
        what = f"drives {found.name!r} by another folder than {vehicle.folder}: {found.folder}"
    else:
        return
    raise InputError(
        what, code="bench_of_other_vehicle", file=str(wish.bench), key="--bench",
        hint="name a bench file of the logs' vehicle",
    )  # fmt: skip


def open_bench(wish: Wish, folder: Path) -> tuple[RunFolder, Bench]:
    """The folder of the drives and its bench, new or gone on with. Raises InputError where it is another bench's."""
    asked = _collection(wish, folder)
    vehicle, model, effects = vehicle_and_model(asked)
    run = open_folder(vehicle, asked, {**record_of(vehicle, model, asked, effects), "command": "gap"})
    return run, prepare(run, vehicle, model, asked, effects)


def require_same_bench(wish: Wish, folder: Path) -> None:
    """Raises InputError where the drives in a folder are another bench's: what was answered with them is not of it."""
    asked = _collection(wish, folder)
    vehicle, model, effects = vehicle_and_model(asked)
    if (folder / "run.json").is_file():
        open_folder(vehicle, asked, {**record_of(vehicle, model, asked, effects), "command": "gap"})


def _collection(wish: Wish, folder: Path) -> collect_plan.Asked:
    return collect_plan.Asked(
        bench=wish.bench, bus=wish.bus, session=wish.session, out=folder, quota_s=QUOTA_S, area_m=AREA_M, seed=SEED
    )


def jobs_of(
    run: RunFolder, bench: Bench, manoeuvres: Sequence[Manoeuvre], before: int, bounds: Bounds | None = None
) -> list[Job]:
    """What of these the vehicle can drive inside of bounds, numbered after the `before` drives that there are."""
    found: list[Job] = []
    for one in manoeuvres:
        plan = plan_for(bench.vehicle, one, bench.dt_s, bounds)
        if plan is not None:
            number = before + len(found) + 1
            found.append(Job(number, one, plan, run.path / "logs" / f"{drive_name(number)}-{one.name}.log"))
    return found


def drive_all(run: RunFolder, bench: Bench, jobs: Sequence[Job], wish: Wish) -> Iterator[Event]:
    """Drive what has no log yet. Raises BenchError for a drive that did not come to its end."""
    missing = [job for job in jobs if not job.log.is_file()]
    if not missing:
        return
    if wish.bus == INSIDE:
        yield Event("note", "bus: none, both nodes within this process")
        for job in missing:
            yield from _told(job, lambda scenario, folder: _drive_inside(bench, scenario, folder), run)
        return
    session = wish.session or f"gap-{os.getpid()}"
    bus_for(bench, wish.bus, session, "")
    heavy = is_heavy(bench, bench.spec.model)
    with Session(
        run.path / "bench.toml", run.words(), session=session, bus=wish.bus, jitted_ecu=heavy,
        controller_role="collector",
    ) as opened:  # fmt: skip
        yield Event("note", f"bus: {opened.choice.why}")
        for job in missing:
            yield from _told(
                job,
                lambda scenario, folder: opened.drive(scenario, scenario.noise_seed, ANY_PARAMETER, folder).error_code,
                run,
            )
        yield from (Event("warning", words) for words in opened.notes)


def _told(job: Job, drive: Callable[[ScenarioSpec, Path], int], run: RunFolder) -> Iterator[Event]:
    """One drive, its log where it belongs."""
    yield Event("note", f"driving {job.manoeuvre.words}")
    folder = run.episode(job.number)
    code = drive(_write(run, job), folder)
    require_stopped(code, job.manoeuvre.name, folder)
    os.replace(folder / "vehicle.log", job.log)


def _write(run: RunFolder, job: Job) -> ScenarioSpec:
    """The scenario of a drive with its plan beside it, where the planner looks for them."""
    path = run.path / "scenarios" / f"{drive_name(job.number)}.toml"
    collect_plan.write_scenario(path, job.number, Start(), SEED, job.manoeuvre.drive_s)
    write_json(path.with_suffix(".json"), as_dict(job.plan))
    return load_scenario(path)


def _drive_inside(bench: Bench, scenario: ScenarioSpec, folder: Path) -> int:
    """Both nodes stepped in turn; writes vehicle.log, gives the code by which the drive ended."""
    said: list[str] = []
    codec, start = bench.codec, bytes.fromhex(scenario.hash)[:6]
    ecu = EcuPart(codec, VehicleFor(bench, bench.spec.model), CycleTimes(), said.append)
    planner = ControllerPart(codec, needed_messages(codec), PlannerFor(bench), CycleTimes(), said.append)
    ecu.load(start, scenario.noise_seed, {})
    planner.load(start, scenario.noise_seed, {})
    planner.hearing.reception.expect_every_period()
    turn = _InTurn(planner)
    ecu.lockstep(cast(Exchange, turn), lambda message: False)
    write_candump(folder / "vehicle.log", turn.rows)
    return turn.code


class _InTurn:
    """What the ECU's lockstep asks of its exchange: the answer to its frames is the other node's next cycle."""

    def __init__(self, planner: ControllerPart) -> None:
        self.planner = planner
        self.rows: list[Row] = []
        self.code = 0
        self._sent: list[CanFrame] = []

    def announce(self, k: int, phase: int, frames: list[CanFrame], *before: Any) -> None:
        """The ECU's frames of a tick."""
        self._sent = self._logged(frames)

    def await_phase(self, k: int, phase: int, interrupt: Callable[[Any], bool]) -> list[CanFrame]:
        """The planner's frames of the same tick; what it says of a drive's end is heard before them."""
        reply, words = self.planner.cycle(k, self._sent)
        for one in words:
            interrupt(one)
        return self._logged(reply)

    def say(self, *messages: Any, k: int = 0) -> None:
        """What the ECU says at last is how the drive ended."""
        self.code = next((one.error_code for one in messages if isinstance(one, bc.Status)), self.code)

    def _logged(self, frames: list[CanFrame]) -> list[CanFrame]:
        ordered = sorted(frames, key=can_key)
        self.rows += [Row(one.time_s, "can0", can_key(one), one.data, FD if one.fd else 0) for one in ordered]
        return ordered
