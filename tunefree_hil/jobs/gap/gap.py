"""Finds what a model lacks according to logs: the location, the effects, the repaired model, and its verification.

Reads logs, searches (gap/pipeline.py), repairs and verifies, and writes a folder in which `gap.json` comes last. The
result of the search is stored, so that a run that was interrupted after it continues from there.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from tunefree_hil import __version__
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.gap.result import NO_LOCATION, SearchResult, make_search_result
from tunefree_hil.gap.result_text import reason_text
from tunefree_hil.gap.selection.reasons import Criterion, Reason, reason_entry
from tunefree_hil.jobs.gap.calibration_logs import list_analysis_warnings
from tunefree_hil.jobs.gap.folder import (
    ANSWER,
    ANSWER_SCHEMA,
    GapFolder,
    lock_folder,
    question_record,
    require_gap_folder,
)
from tunefree_hil.jobs.gap.model_sanity import require_buildable_model
from tunefree_hil.jobs.gap.options import GapInputs, GapOptions
from tunefree_hil.jobs.gap.report import write_page
from tunefree_hil.jobs.gap.report_text import build_command, describe_answer, list_remarks, suggest_commands
from tunefree_hil.jobs.learn.logs import read_logs
from tunefree_hil.jobs.preconditions import ErrorPlace, require_model_of_vehicle
from tunefree_hil.jobs.progress import progress_data, relay_events

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec, VehicleSpec
    from tunefree_hil.gap.measured.chain import MeasuredDrive
    from tunefree_hil.learn.drives.drive import Drive

# Logs that are too short to learn from may be enough to search; if not, the verdict is cannot_test. A steering that
# stays short of its command, or a stuck echo, may be the gap in question.
TOLERATED = ("no_speed", "too_short", "one_speed", "no_braking", "short_of_command", "echo_stuck")
UNREPORTED = ("short",)  # the search measures it itself
UNANSWERABLE = {  # codes of errors that are an answer, with what of these logs fails
    "too_short": Criterion.TOO_FEW_BLOCKS,
    "standing": Criterion.TOO_FEW_DRIVEN_BLOCKS,
    "nothing_to_compare": Criterion.NOTHING_COMPARABLE,
    "no_motion": Criterion.NO_MOTION,
}
BEFORE_HOLDOUT = {"unseen_shrink": None, "unseen_stirs": None}  # of an effect that is not verified yet
T = TypeVar("T")


def run_gap(options: GapOptions) -> Iterator[Event]:
    """Answer, and write `options.out`; an answer that is there already is returned.

    Raises:
        InputError: The logs cannot be used, the model is of another vehicle or cannot be built, or the folder holds
            something else.
    """
    from tunefree_hil.config.load import load_vehicle
    from tunefree_hil.gap.validation.repair import apply_own_numbers

    vehicle = load_vehicle(options.vehicle)
    model = load_checked_model(options.model, vehicle)
    yield from (Event("warning", text) for text in list_analysis_warnings(model))
    require_gap_folder(options.out)
    drives = yield from _read_drives(options.logs, vehicle)
    older = (yield from _read_drives(options.older, vehicle)) if options.older else []
    _require_distinct_logs(drives, older)
    yield from (Event("warning", text) for text in _compare_with_older_logs(drives, older))
    drives, without_speed = _drop_logs_without_speed(drives, vehicle, may_drop_all=False)
    older, older_without_speed = _drop_logs_without_speed(older, vehicle, may_drop_all=True)
    excluded = tuple(Reason(Criterion.LOG_WITHOUT_SPEED, key=name) for name in (*without_speed, *older_without_speed))
    yield from (Event("warning", reason_text(reason)) for reason in excluded)
    inputs = GapInputs(vehicle, model, apply_own_numbers(model, vehicle), drives, older, excluded)
    with lock_folder(options.out, question_record(drives, older, vehicle, model)) as folder:
        answer = folder.load_answer(options.until)
        if answer is not None and answer["model"] and not Path(answer["model"]).is_dir():
            yield Event("warning", f"the model named in {folder.path / ANSWER} is gone: it is made and verified again")
            answer = None
        if answer is None:
            answer = yield from _produce_answer(options, folder, inputs)
    status = 1 if answer.get("worse") else 0
    yield Event("result", "", {**answer, "exit": status, "next": suggest_commands(options, answer, vehicle)})


def load_checked_model(name: str, vehicle: VehicleSpec) -> ModelSpec:
    """Load a model folder. Raises InputError for a model of another vehicle (or its older files) and one that cannot be
    built.
    """
    from tunefree_hil.config.load import load_model

    model = load_model(name)
    require_model_of_vehicle(model, vehicle, ErrorPlace("name a model of the logs' vehicle"))
    require_buildable_model(model, vehicle)
    return model


def _require_distinct_logs(drives: Sequence[Drive], older: Sequence[Drive]) -> None:
    """Raise InputError for a log that is given twice: it would be fitted, and would test that fit as well."""
    names: dict[str, str] = {}
    for key, group in (("LOG", drives), ("--older", older)):
        for drive in group:
            if drive.log_hash in names:
                is_log = key == "LOG"
                hint = "name every log once" if is_log else "leave out of --older what is given as LOG or twice"
                message = f"has the same content as {names[drive.log_hash]}"
                raise InputError(message, code="same_log", file=drive.path, key=key, hint=hint)
            names[drive.log_hash] = drive.path


def _compare_with_older_logs(drives: Sequence[Drive], older: Sequence[Drive]) -> Iterator[str]:
    """Differences of older logs that suggest another vehicle, or the effect itself."""
    from tunefree_hil.learn.checks.same_vehicle import check_same_vehicle

    marked = [drive._replace(name=f"{drive.path} (--older)") for drive in older]  # the same name may be in both groups
    names = {drive.name for drive in marked}
    for problem in check_same_vehicle([*drives, *marked]):
        if problem.drive in names:
            yield f"{problem.message}, or the effect has come to the vehicle in between"


def _drop_logs_without_speed(
    drives: Sequence[Drive], vehicle: VehicleSpec, *, may_drop_all: bool
) -> tuple[list[Drive], tuple[str, ...]]:
    """Returns: the drives that hold a speed, and the names of the others.

    Where no drive holds a speed and may_drop_all is False, all stay: the verdict is then cannot_test.
    """
    from tunefree_hil.gap.measured.chain import has_speed

    holds_speed = [has_speed(drive, vehicle) for drive in drives]
    if not (may_drop_all or any(holds_speed)):
        return list(drives), ()
    names = tuple(drive.name for drive, holds in zip(drives, holds_speed, strict=True) if not holds)
    return [drive for drive, holds in zip(drives, holds_speed, strict=True) if holds], names


def _read_drives(logs: Sequence[Path], vehicle: VehicleSpec) -> Generator[Event, None, list[Drive]]:
    """The drives of logs, without signals at a sensor's limit: the checks would take these for a wrong unit."""
    return (
        yield from read_logs(logs, vehicle, tolerated=TOLERATED, unreported=UNREPORTED, mend=_drop_saturated_signals)
    )


def _drop_saturated_signals(drive: Drive) -> tuple[Drive, list[str]]:
    from tunefree_hil.gap.measured.signals import drop_signals, find_sensor_limits

    limits = find_sensor_limits(drive)
    texts = [f"{limit.text} and is left out: an effect that shows in it alone cannot be found" for limit in limits]
    return drop_signals(drive, limits) if limits else drive, texts


def _produce_answer(
    options: GapOptions, folder: GapFolder, inputs: GapInputs
) -> Generator[Event, None, dict[str, Any]]:
    """Search (or load the search that is stored), repair, verify, and write the answer."""
    began = time.monotonic()
    try:
        opened = yield from _open_drives(inputs)
        search = folder.load_search(named=options.until != "locate")
        if search is None:
            events = _run_search(options, inputs, opened)
            search = folder.store_search((yield from _add_resume_command(events, options, saved=False)))
        else:
            began -= search.elapsed_s  # the time of the search when it was made
    except InputError as error:
        if error.code not in UNANSWERABLE:
            raise
        answer = _unanswerable_fields(error)
    else:
        rest = _repair_and_verify(options, folder, inputs, opened, search)
        answer = yield from _add_resume_command(rest, options, saved=True)
    answer = _complete_answer(options, inputs, answer, time.monotonic() - began)
    answer["words"] = [*answer["words"], *(reason_text(reason) for reason in inputs.excluded_logs)]
    answer["reasons"] = [*answer.get("reasons", ()), *(reason_entry(reason) for reason in inputs.excluded_logs)]
    write_page(folder.page, answer, suggest_commands(options, answer, inputs.vehicle), build_command(options))
    folder.write_answer(answer)
    return answer


def _add_resume_command(
    events: Generator[Event, None, T], options: GapOptions, *, saved: bool
) -> Generator[Event, None, T]:
    """Add to events the command that continues after an interruption, and whether a result is stored by then."""
    more = {"resume": build_command(options), "saved": saved}
    return relay_events(events, lambda event: event._replace(data={**event.data, **more}))


def _open_drives(inputs: GapInputs) -> Generator[Event, None, list[MeasuredDrive]]:
    from tunefree_hil.gap.measured.chain import build_measured_drive

    opened = [build_measured_drive(drive, inputs.vehicle) for drive in inputs.drives]
    yield from (Event("warning", text) for drive in opened for text in drive.omissions)
    return opened


def _run_search(
    options: GapOptions, inputs: GapInputs, opened: list[MeasuredDrive]
) -> Generator[Event, None, SearchResult]:
    """The search, with its progress."""
    from tunefree_hil.gap.pipeline import diagnose, locate

    began, is_named = time.monotonic(), options.until != "locate"
    question = (inputs.model, inputs.vehicle, opened)
    search = diagnose(*question, options.workers) if is_named else locate(*question)
    diagnosis = yield from relay_events(
        search, lambda now: Event("progress", now.text, {"label": "search", **progress_data(now, began)})
    )
    return make_search_result(diagnosis, inputs.model.plant.kind, time.monotonic() - began, is_named)


def _unanswerable_fields(error: InputError) -> dict[str, Any]:
    """Keys of gap.json for logs on which nothing can be tested."""
    from tunefree_hil.gap.measured.excitation import TooLittleDriving

    is_counted = isinstance(error, TooLittleDriving)
    reasons = error.reasons if is_counted else (Reason(UNANSWERABLE[error.code]),)
    return {
        "verdict": "cannot_test",
        "forced": None,
        "absorbed": False,
        "effects": [],
        "set": [],
        "separate_by": "",
        "where": NO_LOCATION,
        "excitation": {},
        "links": [],
        "lost": {},
        "untold": {},
        "not_suspected": {},
        "candidates": [],
        "words": [error.message + (f": {error.hint}" if error.hint else "")],
        "reasons": [reason_entry(reason) for reason in reasons],
    }


def _repair_and_verify(
    options: GapOptions, folder: GapFolder, inputs: GapInputs, opened: list[MeasuredDrive], search: SearchResult
) -> Generator[Event, None, dict[str, Any]]:
    """The answer with repair, verification and figures, as far as `--until` asks for them."""
    from tunefree_hil.jobs.gap import repair as gap_repair
    from tunefree_hil.jobs.gap.closed_loop import replay_drives
    from tunefree_hil.jobs.gap.report_figures import draw_figures

    effects = search.answer["effects"]
    answer = {**search.answer, "effects": [{**effect, **BEFORE_HOLDOUT} for effect in effects]}
    yield from (Event("note", text) for text in (describe_answer(answer), *list_remarks(answer)))
    holdout = None
    if options.until in ("repair", "verify"):
        outcome = gap_repair.make_repair(folder, inputs, opened, search, combine_log_hashes(inputs))
        answer |= gap_repair.repair_fields(outcome)
        if options.until == "verify":
            yield Event("note", "verification: free runs of the whole vehicle over the holdout blocks")
            verified, holdout = yield from gap_repair.verify_repair(folder, inputs, opened, search, outcome)
            answer |= {"effects": effects, **verified}
            if answer["model"]:
                closed_loop, reason = yield from replay_drives(options.logs, inputs, outcome)
                answer |= {"closed_loop": closed_loop, "closed_loop_words": reason}
        elif outcome.model is not None:
            yield Event("warning", "the repaired model is not verified: leave out --until for that")
    answer["figures"] = [str(path) for path in draw_figures(folder.figures, answer, search, holdout)]
    return answer


def combine_log_hashes(inputs: GapInputs) -> str:
    """The hash of a single log, or one hash over those of several logs."""
    hashes = [drive.log_hash for drive in inputs.drives]
    return hashes[0] if len(hashes) == 1 else f"sha256:{hashlib.sha256(' '.join(hashes).encode()).hexdigest()}"


def _complete_answer(options: GapOptions, inputs: GapInputs, answer: dict[str, Any], seconds: float) -> dict[str, Any]:
    """Content of gap.json (docs/reference/files.md)."""
    complete = {
        "schema": ANSWER_SCHEMA,
        "signals": {},
        "explained_frac": None,
        "closed_loop": None,
        "older": [],
        "model": None,
        "figures": [],
        **answer,
        "until": options.until,
        "elapsed_s": round(seconds, 1),
        "log_hash": combine_log_hashes(inputs),
        "logs": [{"name": drive.name, "hash": drive.log_hash} for drive in inputs.drives],
        "model_hash": f"sha256:{inputs.model.hash}",
        "vehicle_hash": f"sha256:{inputs.vehicle.hash}",
        "version": __version__,
    }
    return {**complete, "sentence": describe_answer(complete)}
