"""Finds what a model lacks that logs show: where they part, what it is, the model with it, and the proof.

Reads logs, searches (gap/pipeline.py), repairs and proves; writes a folder of which `gap.json` comes last.
What the search came to is kept, so that a run that was cut off after it goes on from there.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from tunefree_hil import __version__
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.gap.result import NOWHERE, Kept, keep
from tunefree_hil.jobs.gap.calibration_logs import half_made
from tunefree_hil.jobs.gap.folder import ANSWER, ANSWER_SCHEMA, Folder, held_folder, question_of, require_ours
from tunefree_hil.jobs.gap.model_sanity import require_sound
from tunefree_hil.jobs.gap.report import write_page
from tunefree_hil.jobs.gap.report_text import again, next_of, remarks, sentence_of
from tunefree_hil.jobs.learn.logs import read
from tunefree_hil.jobs.preconditions import require_model_of
from tunefree_hil.jobs.progress import eta_of, told

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec, VehicleSpec
    from tunefree_hil.gap.measured.chain import Opened
    from tunefree_hil.learn.drives.drive import Drive

# What is too little to learn from may be enough to judge by; where it is not, the answer is that it cannot be told. A
# steering that stays short of its command, or an echo that stands, is what somebody may ask about.
EXCUSED = ("no_speed", "too_short", "one_speed", "no_braking", "short_of_command", "echo_stuck")
UNSAID = ("short",)  # the search says it by its own measure
CANNOT = ("too_short", "standing", "nothing_to_compare", "no_motion")
UNPROVED = {"unseen_shrink": None, "unseen_stirs": None}  # of an effect: before the proof nobody has seen its blocks
T = TypeVar("T")


class Asked(NamedTuple):
    """What the command line says. workers: processes that share the search, which comes to the same with any number."""

    logs: Sequence[Path]
    vehicle: str
    model: str
    out: Path
    older: Sequence[Path] = ()
    until: str = "verify"
    workers: int = 2


class Material(NamedTuple):
    """What an answer is made of. given: the model as it is in its folder; model: the same with what its own logs say of
    it (gap/validation/repair.py, `moved`). left_out: logs of which nothing can be told, in words.
    """

    vehicle: VehicleSpec
    given: ModelSpec
    model: ModelSpec
    drives: list[Drive]
    older: list[Drive]
    left_out: tuple[str, ...] = ()


def gap(asked: Asked) -> Iterator[Event]:
    """Answer, and write `asked.out`. A question that was answered is not asked again.

    Raises InputError for logs that cannot be used, a model of another vehicle or one that makes no car, a folder that
    holds something else.
    """
    from tunefree_hil.config.load import load_vehicle
    from tunefree_hil.gap.validation.repair import moved

    vehicle = load_vehicle(asked.vehicle)
    model = model_for(asked.model, vehicle)
    yield from (Event("warning", words) for words in half_made(model))
    require_ours(asked.out)
    drives = yield from _read(asked.logs, vehicle)
    older = (yield from _read(asked.older, vehicle)) if asked.older else []
    _require_others(drives, older)
    yield from (Event("warning", words) for words in _other_car(drives, older))
    drives, mute = _without_mute(drives, vehicle, all_may_go=False)
    older, more = _without_mute(older, vehicle, all_may_go=True)
    left_out = tuple(f"{name} says nothing of the speed, and is left out" for name in (*mute, *more))
    yield from (Event("warning", words) for words in left_out)
    material = Material(vehicle, model, moved(model, vehicle), drives, older, left_out)
    with held_folder(asked.out, question_of(drives, older, vehicle, model)) as folder:
        answer = folder.answer(asked.until)
        if answer is not None and answer["model"] and not Path(answer["model"]).is_dir():
            yield Event("warning", f"{folder.path / ANSWER} names a model that is gone: it is made and proved again")
            answer = None
        if answer is None:
            answer = yield from _answered(asked, folder, material)
    status = 1 if answer.get("worse") else 0
    yield Event("result", "", {**answer, "exit": status, "next": next_of(asked, answer, vehicle)})


def model_for(name: str, vehicle: VehicleSpec) -> ModelSpec:
    """The model folder to be judged. Raises InputError for another vehicle's, for one of the vehicle as it was, and for
    one that makes no car.
    """
    from tunefree_hil.config.load import load_model

    model = load_model(name)
    require_model_of(model, vehicle, hint="name a model of the logs' vehicle")
    require_sound(model, vehicle)
    return model


def _require_others(drives: Sequence[Drive], older: Sequence[Drive]) -> None:
    """Raises InputError for a log that is there twice: one part of it would be fitted, and judge the other, which is
    the same; and for an older log that is asked about: it would be held against its own repair.
    """
    names: dict[str, str] = {}
    for key, some in (("LOG", drives), ("--older", older)):
        for one in some:
            if one.log_hash in names:
                raise InputError(
                    f"it holds what {names[one.log_hash]} holds", code="same_log", file=one.path, key=key,
                    hint="name every log once" if key == "LOG" else "name logs that are neither asked about nor named",
                )  # fmt: skip
            names[one.log_hash] = one.path


def _other_car(drives: Sequence[Drive], older: Sequence[Drive]) -> Iterator[str]:
    """What older logs do not share with those that are asked about: another car, or what came to it in between."""
    from tunefree_hil.learn.checks.same_vehicle import check_same_vehicle

    marked = [one._replace(name=f"{one.path} (--older)") for one in older]  # short names are those of a group
    names = {one.name for one in marked}
    for one in check_same_vehicle([*drives, *marked]):
        if one.drive in names:
            yield f"{one.words}, or the effect has come to this one in between"


def _without_mute(
    drives: Sequence[Drive], vehicle: VehicleSpec, *, all_may_go: bool
) -> tuple[list[Drive], tuple[str, ...]]:
    """(drives that say something of the speed, names of the others). Where all of those that are asked about do not,
    they stay: that they cannot tell is the answer then.
    """
    from tunefree_hil.gap.measured.chain import says_speed

    says = [says_speed(one, vehicle) for one in drives]
    if not (all_may_go or any(says)):
        return list(drives), ()
    stay = [one for one, it in zip(drives, says, strict=True) if it]
    return stay, tuple(one.name for one, it in zip(drives, says, strict=True) if not it)


def _read(logs: Sequence[Path], vehicle: VehicleSpec) -> Generator[Event, None, list[Drive]]:
    """The drives of logs, without signals that stand at a sensor's stop: these would be judged a wrong unit."""
    return (yield from read(logs, vehicle, excused=EXCUSED, unsaid=UNSAID, mend=_without_stops))


def _without_stops(drive: Drive) -> tuple[Drive, list[str]]:
    from tunefree_hil.gap.measured.signals import stops_of, without

    stops = stops_of(drive)
    words = [f"{stop.words} and is left out: what shows in it alone is not told" for stop in stops]
    return without(drive, stops) if stops else drive, words


def _answered(asked: Asked, folder: Folder, material: Material) -> Generator[Event, None, dict[str, Any]]:
    """The answer, written."""
    began = time.monotonic()
    try:
        opened = yield from _opened(material)
        found = folder.search(named=asked.until != "locate")
        if found is None:
            found = folder.keep((yield from _going_on(_searched(asked, material, opened), asked, saved=False)))
        else:
            began -= found.seconds  # what it took when it was made
    except InputError as error:
        if error.code not in CANNOT:
            raise
        answer = _whole(asked, material, _untold(error), time.monotonic() - began)
    else:
        answer = yield from _going_on(_proved(asked, folder, material, opened, found, began), asked, saved=True)
    answer["words"] = [*answer["words"], *material.left_out]
    write_page(folder.page, answer, next_of(asked, answer, material.vehicle), again(asked))
    folder.write_answer(answer)
    return answer


def _going_on(events: Generator[Event, None, T], asked: Asked, *, saved: bool) -> Generator[Event, None, T]:
    """Events with the command that goes on where they are cut off, and whether anything is kept for it by then."""
    more = {"resume": again(asked), "saved": saved}
    return told(events, lambda event: event._replace(data={**event.data, **more}))


def _opened(material: Material) -> Generator[Event, None, list[Opened]]:
    from tunefree_hil.gap.measured.chain import open_chain

    opened = [open_chain(drive, material.vehicle) for drive in material.drives]
    yield from (Event("warning", words) for one in opened for words in one.unsure)
    return opened


def _searched(asked: Asked, material: Material, opened: list[Opened]) -> Generator[Event, None, Kept]:
    """The search, with its progress."""
    from tunefree_hil.gap.pipeline import look_first, name

    began, looks = time.monotonic(), asked.until == "locate"
    question = (material.model, material.vehicle, opened)
    search = look_first(*question) if looks else name(*question, asked.workers)
    found = yield from told(search, lambda stage: Event("progress", stage, {"label": "search", **eta_of(stage, began)}))
    return keep(found, material.model.plant.kind, time.monotonic() - began, not looks)


def _untold(error: InputError) -> dict[str, Any]:
    """The answer of logs that cannot tell."""
    words = error.message + (f": {error.hint}" if error.hint else "")
    return {
        "verdict": "cannot_test", "forced": None, "absorbed": False, "effects": [], "set": [], "separate_by": "",
        "where": NOWHERE, "excitation": {}, "links": [], "lost": {}, "untold": {}, "not_suspected": {},
        "candidates": [], "words": [words],
    }  # fmt: skip


def _proved(
    asked: Asked, folder: Folder, material: Material, opened: list[Opened], found: Kept, began: float
) -> Generator[Event, None, dict[str, Any]]:
    """The answer with its repair and its proof, as far as they are asked for."""
    from tunefree_hil.jobs.gap import repair as gap_repair
    from tunefree_hil.jobs.gap.closed_loop import replayed
    from tunefree_hil.jobs.gap.report import draw

    answer = {**found.answer, "effects": [{**one, **UNPROVED} for one in found.answer["effects"]]}
    yield from (Event("note", words) for words in (sentence_of(answer), *remarks(answer)))
    proof = None
    if asked.until in ("repair", "verify"):
        mended = gap_repair.mend(folder, material, opened, found, log_hash_of(material))
        answer |= gap_repair.as_data(mended)
        if asked.until == "verify":
            yield Event("note", "proof: free runs of the whole car over blocks that no fit has seen")
            more, proof = yield from gap_repair.proved(folder, material, opened, found, mended)
            answer |= {"effects": found.answer["effects"], **more}
            if answer["model"]:
                loop, why = yield from replayed(asked.logs, material, mended)
                answer |= {"closed_loop": loop, "closed_loop_words": why}
        elif mended.model is not None:
            yield Event("warning", "the repaired model is not proved: without --until it is")
    answer["figures"] = [str(path) for path in draw(folder.figures, answer, found, proof)]
    return _whole(asked, material, answer, time.monotonic() - began)


def log_hash_of(material: Material) -> str:
    """Of one log its own, of several one over theirs."""
    hashes = [drive.log_hash for drive in material.drives]
    return hashes[0] if len(hashes) == 1 else f"sha256:{hashlib.sha256(' '.join(hashes).encode()).hexdigest()}"


def _whole(asked: Asked, material: Material, answer: dict[str, Any], seconds: float) -> dict[str, Any]:
    """gap.json (interfaces 9)."""
    whole = {
        "schema": ANSWER_SCHEMA,
        "signals": {},
        "explained_frac": None,
        "closed_loop": None,
        "older": [],
        "model": None,
        "figures": [],
        **answer,
        "until": asked.until,
        "elapsed_s": round(seconds, 1),
        "log_hash": log_hash_of(material),
        "logs": [{"name": drive.name, "hash": drive.log_hash} for drive in material.drives],
        "model_hash": f"sha256:{material.model.hash}",
        "vehicle_hash": f"sha256:{material.vehicle.hash}",
        "version": __version__,
    }
    return {**whole, "sentence": sentence_of(whole)}
