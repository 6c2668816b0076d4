"""`gap --drive`: where logs leave a set of effects, the bench drives what separates them, and `gap` runs again.

There are at most MAX_ROUNDS rounds. The drives of a round are added to the logs as recordings of their own, and
`round-N/` in the folder holds the answer of that round. gap.json and gap.md of the folder itself are those of the last
round; the first ones are kept as gap-1.json and gap-1.md. Logs and rounds are the whole state, so that an interrupted
run continues with the drive or the search that was interrupted.

Drives stay inside the region of the model's data: outside it the model has errors of its own. They
may only decide between the effects of the set: any other answer means that drives and logs do not match, and the set
stands.
"""

from __future__ import annotations

import shutil
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.collect.bounds import bounds_from_valid_region
from tunefree_hil.effects import catalogue
from tunefree_hil.gap.estimation.candidates import indistinguishable_effects
from tunefree_hil.gap.experiment_design import MANOEUVRES, Manoeuvre, next_manoeuvres, plan_manoeuvre
from tunefree_hil.gap.selection.reasons import Criterion, reason_from_entry
from tunefree_hil.jobs.gap.drive_bench import (
    ManoeuvreJob,
    drive_jobs,
    open_bench,
    plan_jobs,
    require_same_bench,
    require_same_vehicle,
)
from tunefree_hil.jobs.gap.folder import ANSWER, LOCK, PAGE, GapFolder
from tunefree_hil.jobs.gap.gap import load_checked_model, run_gap
from tunefree_hil.jobs.gap.options import GapDriveOptions, GapOptions
from tunefree_hil.jobs.gap.report import write_page
from tunefree_hil.jobs.gap.report_text import CANNOT_TEST, SET, build_command, suggest_commands
from tunefree_hil.jobs.run_folder import read_json

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

MAX_ROUNDS = 3
UNDECIDED = (SET, CANNOT_TEST)
DRIVES_KEY = "drives"  # folder of the bench, with its logs in drives/logs; also the key of gap.json that lists them
FIRST_ANSWER, FIRST_PAGE = "gap-1.json", "gap-1.md"
COUNTED = (
    Criterion.NOT_EXCITED,
    Criterion.TOO_FEW_BLOCKS,
    Criterion.TOO_FEW_DRIVEN_BLOCKS,
    Criterion.IDLE_TIME,
)
OBSTACLES = (  # criteria that keep logs from being tested; of COUNTED ones the numbers matter
    *COUNTED,
    Criterion.UNMOVING,
    Criterion.UNOBSERVABLE,
    Criterion.NO_MOTION,
    Criterion.NOTHING_COMPARABLE,
    Criterion.LOG_WITHOUT_SPEED,
)
RESULT_KEYS = ("exit", "next")  # keys of a result that are not in gap.json


class Obstacle(NamedTuple):
    """What keeps logs from being tested: the criterion, its signal or quantity, and the numbers compared."""

    criterion: Criterion
    key: str
    value: float | None = None
    limit: float | None = None


class DriveTask(NamedTuple):
    """What all rounds share. resume: the command that continues after an interruption."""

    options: GapOptions
    drive_options: GapDriveOptions
    vehicle: VehicleSpec
    resume: str

    @property
    def resume_data(self) -> dict[str, Any]:
        """Data of an event after which a result is stored."""
        return {"resume": self.resume, "saved": True}


class DriveHistory(NamedTuple):
    """The drives so far, with the round of each. unfit_rounds: rounds whose drives do not match the logs."""

    rounds: list[int]
    jobs: list[ManoeuvreJob]
    unfit_rounds: set[int]

    @property
    def names(self) -> set[str]:
        """Names of the manoeuvres."""
        return {job.manoeuvre.name for job in self.jobs}

    @property
    def logs(self) -> list[Path]:
        """Logs of the drives."""
        return [job.log for job in self.jobs]


def run_gap_with_drives(options: GapOptions, drive_options: GapDriveOptions) -> Iterator[Event]:
    """Run `gap`; where the answer is a set, or nothing could be tested, drive and run it again.

    Raises:
        InputError: As `run_gap`; the bench is of another vehicle, or the folder holds drives of another bench.
        BenchError: A drive does not come to its end.
    """
    from tunefree_hil.config.load import load_vehicle
    from tunefree_hil.tune.store import exclusive_lock

    _require_naming(options)
    vehicle = load_vehicle(options.vehicle)
    require_same_vehicle(drive_options, vehicle)
    task = DriveTask(options, drive_options, vehicle, build_command(options, drive=drive_options))
    answer = yield from _run_gap_again(options, task.resume, saved=False)
    if DRIVES_KEY in answer:
        require_same_bench(drive_options, options.out / DRIVES_KEY)
    if DRIVES_KEY in answer or not next_manoeuvres(answer, (), catalogue()):
        yield Event("result", "", {**answer, "next": suggest_drive_commands(task, answer)})
        return
    with exclusive_lock(options.out / LOCK):
        history = DriveHistory([], [], set())
        last = yield from _drive_rounds(task, answer, history)
        complete = {**last, DRIVES_KEY: _list_drives(history)}
        complete["next"] = suggest_drive_commands(task, complete)
        _store_answer(options, complete, task.resume)
    yield Event("result", "", complete)


def suggest_drive_commands(task: DriveTask, answer: Mapping[str, Any]) -> list[str]:
    """The commands to go on with: with the drives that match the logs, and with the same bench."""
    options, drives = task.options, answer.get(DRIVES_KEY, ())
    logs = [*options.logs, *(Path(drive["log"]) for drive in drives if drive.get("fits", True))]
    return suggest_commands(options._replace(logs=logs), answer, task.vehicle, task.drive_options)


def _require_naming(options: GapOptions) -> None:
    if options.until == "locate":
        message = "--until locate names no effects, so there is nothing to separate"
        raise InputError(message, code="usage", key="--drive", hint="leave out --until")


def _run_gap_again(options: GapOptions, resume: str, *, saved: bool) -> Generator[Event, None, dict[str, Any]]:
    """Run `gap`; its events name the command with `--drive`.

    Args:
        options: Options of this run of `gap`.
        resume: The command that continues after an interruption.
        saved: Whether a result of an earlier round is stored.

    Returns:
        The answer with its exit status and the next commands.
    """
    answer = dict[str, Any]()
    for event in run_gap(options):
        if event.kind == "result":
            answer = dict(event.data)
        else:
            more = {"resume": resume, "saved": saved or event.data.get("saved", True)}
            yield event._replace(data={**event.data, **more}) if saved or "resume" in event.data else event
    return answer


def _drive_rounds(
    task: DriveTask, answer: dict[str, Any], history: DriveHistory
) -> Generator[Event, None, dict[str, Any]]:
    """Drive until the effects are separated, or nothing is left to drive; fills `history`. Returns: the last answer."""
    options, effects = task.options, catalogue()
    run, bench = open_bench(task.drive_options, options.out / DRIVES_KEY)
    bounds = bounds_from_valid_region(task.vehicle, load_checked_model(options.model, task.vehicle).valid)
    plans = {name: plan_manoeuvre(bench.vehicle, one, bench.dt_s, bounds) for name, one in MANOEUVRES.items()}
    not_drivable = {name for name, plan in plans.items() if plan is None}
    reported = set[str]()
    for number in range(1, MAX_ROUNDS + 1):
        for manoeuvre in next_manoeuvres(answer, history.names | reported, effects):
            if manoeuvre.name in not_drivable:
                reported.add(manoeuvre.name)
                yield Event("note", f"not driven, as beyond the vehicle or the model's data: {manoeuvre.description}")
        manoeuvres = next_manoeuvres(answer, history.names | not_drivable, effects)
        jobs = plan_jobs(run, bench, manoeuvres, len(history.jobs), bounds)
        if not jobs:
            if answer["verdict"] in UNDECIDED:
                yield Event("note", f"no further manoeuvre would separate the effects: {answer['sentence']}")
            return answer
        yield Event("note", _describe_round(number, answer, [job.manoeuvre for job in jobs]), task.resume_data)
        for event in drive_jobs(run, bench, jobs, task.drive_options):
            yield event._replace(data={**event.data, **task.resume_data})
        history.jobs.extend(jobs)
        history.rounds.extend([number] * len(jobs))
        before = answer
        more = options._replace(logs=[*options.logs, *history.logs], out=options.out / f"round-{number}")
        answer = yield from _run_gap_again(more, task.resume, saved=True)
        if is_conflict(before, answer):
            history.unfit_rounds.add(number)
            text = describe_conflict(answer)
            yield Event("warning", text)
            return {**before, "words": [*before["words"], text]}
        if answer["verdict"] == CANNOT_TEST and has_same_obstacles(before, answer):
            yield Event("note", "the drives did not change why these logs cannot tell")
            return answer
    return answer


def has_same_obstacles(before: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    """Whether the same keeps both logs from being tested, to the digits that are shown. An answer without reasons is of
    an older program, and the next drives are made.
    """
    obstacles = _test_obstacles(answer)
    return bool(obstacles) and obstacles == _test_obstacles(before)


def _test_obstacles(answer: Mapping[str, Any]) -> frozenset[Obstacle]:
    """What keeps logs from being tested, of whatever effect."""
    reasons = [reason_from_entry(entry) for entry in answer.get("reasons", ())]
    return frozenset(
        Obstacle(reason.criterion, reason.key, *(_round_shown(number) for number in (reason.value, reason.limit)))
        if reason.criterion in COUNTED
        else Obstacle(reason.criterion, reason.key)
        for reason in reasons
        if reason.criterion in OBSTACLES
    )


def _round_shown(number: float | None) -> float | None:
    return None if number is None else float(f"{number:.3g}")


def is_conflict(before: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    """Whether the answer with the drives is neither a decision within the set of before nor leaves it open."""
    if before["verdict"] != SET or answer["verdict"] == CANNOT_TEST:
        return False
    # Effects that no log can tell from an effect of the set (the widest classes) are no other answer.
    candidates = frozenset[str]().union(*(indistinguishable_effects(name, has_lateral=False) for name in before["set"]))
    names = [effect["name"] for effect in answer["effects"]]
    is_open = answer["verdict"] == SET and not candidates.isdisjoint(answer["set"])
    return not (is_open or (bool(names) and candidates.issuperset(names)))


def describe_conflict(answer: Mapping[str, Any]) -> str:
    """That drives and logs do not match."""
    result = f"with the drives of the bench it would be none of the set ({answer['sentence']})"
    return f"{result}: drives and logs do not match, and the set stands"


def _describe_round(number: int, answer: Mapping[str, Any], manoeuvres: Sequence[Manoeuvre]) -> str:
    drives = "; ".join(manoeuvre.description for manoeuvre in manoeuvres)
    purpose = f" to separate {', '.join(answer['set'])}" if answer["set"] else f"; {answer['sentence']}"
    return f"round {number} of at most {MAX_ROUNDS}: the bench drives {drives}{purpose}"


def _list_drives(history: DriveHistory) -> list[dict[str, Any]]:
    """Value of the key `drives` of gap.json."""
    return [
        {
            "round": number,
            "manoeuvre": job.manoeuvre.name,
            "words": job.manoeuvre.description,
            "log": str(job.log),
            "fits": number not in history.unfit_rounds,
        }
        for number, job in zip(history.rounds, history.jobs, strict=True)
    ]


def _store_answer(options: GapOptions, answer: dict[str, Any], resume: str) -> None:
    """Write the last answer, and keep the first one beside it; gap.json is replaced last."""
    folder = GapFolder(options.out)
    if not read_json(options.out / ANSWER).get(DRIVES_KEY):  # it is still the first answer
        for name, first_name in ((ANSWER, FIRST_ANSWER), (PAGE, FIRST_PAGE)):
            part = options.out / f"{first_name}.part"
            shutil.copyfile(options.out / name, part)
            part.replace(options.out / first_name)
    write_page(folder.page, answer, answer["next"], resume)
    folder.write_answer({key: value for key, value in answer.items() if key not in RESULT_KEYS})
