"""`gap --drive`: where logs leave a set, the bench drives what separates it, and the question is asked again.

At most ROUNDS times: the drives of a round go in beside the logs before them, as recordings of their own, and
`round-N/` in the folder holds what was then answered. The folder's own gap.json and gap.md are those of the last round
in the end; the first ones stay as gap-1.json and gap-1.md. Logs and rounds are all the state there is, so that a run
that was cut off goes on with the drive or the search that it lost.

Drives stay inside what the model was made from: outside it misses things that have nothing to do with what is asked.
And they may only decide between the names that there were: an answer beside them says that drives and logs do not go
together, for whatever reason, and the set stands.
"""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.collect.bounds import bounds_of
from tunefree_hil.effects import catalogue
from tunefree_hil.gap.estimation.candidates import class_of
from tunefree_hil.gap.experiment_design import MENU, Manoeuvre, plan_for, to_drive
from tunefree_hil.jobs.command_text import given, option_words
from tunefree_hil.jobs.gap.drive_bench import (
    Job,
    Wish,
    drive_all,
    jobs_of,
    open_bench,
    require_same_bench,
    require_same_vehicle,
)
from tunefree_hil.jobs.gap.folder import ANSWER, LOCK, PAGE, Folder
from tunefree_hil.jobs.gap.gap import Asked, gap, model_for
from tunefree_hil.jobs.gap.report import write_page
from tunefree_hil.jobs.gap.report_text import COMMAND, again, next_of
from tunefree_hil.jobs.run_folder import read_json

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

ROUNDS = 3
UNDECIDED = ("set", "cannot_test")
DRIVES = "drives"  # folder of the bench, its logs in DRIVES/logs; and the key of gap.json that lists them
FIRST_ANSWER, FIRST_PAGE = "gap-1.json", "gap-1.md"
OF_A_RUN = ("exit", "next")  # what a result says beside gap.json


class Driven(NamedTuple):
    """How far it has come: all drives in their order, with the round of each; apart: rounds that fit no logs."""

    rounds: list[int]
    jobs: list[Job]
    apart: set[int]

    @property
    def names(self) -> set[str]:
        """Of the manoeuvres."""
        return {one.manoeuvre.name for one in self.jobs}

    @property
    def logs(self) -> list[Path]:
        """Their logs."""
        return [one.log for one in self.jobs]


def gap_drive(asked: Asked, wish: Wish) -> Iterator[Event]:
    """Ask, and where it is a set (or nothing could be told) drive and ask again.

    Raises as `gap` does, InputError for a bench of another vehicle and for drives of another bench in the folder,
    BenchError for a drive that does not come to its end.
    """
    from tunefree_hil.config.load import load_vehicle
    from tunefree_hil.tune.store import alone

    _require_names(asked)
    vehicle = load_vehicle(asked.vehicle)
    require_same_vehicle(wish, vehicle)
    resume = with_drive(again(asked), wish)
    answer = yield from _ask(asked, resume, saved=False)
    if DRIVES in answer:
        require_same_bench(wish, asked.out / DRIVES)
    if DRIVES in answer or not to_drive(answer, (), catalogue()):
        yield Event("result", "", {**answer, "next": following(asked, wish, answer, vehicle)})
        return
    with alone(asked.out / LOCK):
        driven = Driven([], [], set())
        last = yield from _rounds(asked, wish, answer, driven, resume, vehicle)
        whole = {**last, DRIVES: _listed(driven)}
        whole["next"] = following(asked, wish, whole, vehicle)
        _keep(asked, whole, resume)
    yield Event("result", "", whole)


def with_drive(command: str, wish: Wish) -> str:
    """A `gap` command that drives as this one does."""
    return f"{command} {shlex.join(option_words(drive=True, **given(wish, leave=['session'])))}"


def following(asked: Asked, wish: Wish, answer: Mapping[str, Any], vehicle: VehicleSpec) -> list[str]:
    """Commands to go on with: with what was driven beside the logs and fits them, and with the bench that drives."""
    logs = [*asked.logs, *(Path(one["log"]) for one in answer.get(DRIVES, ()) if one.get("fits", True))]
    commands = next_of(asked._replace(logs=logs), answer, vehicle, str(wish.bench))
    return [with_drive(one, wish) if one.startswith(COMMAND) else one for one in commands]


def _require_names(asked: Asked) -> None:
    if asked.until == "locate":
        raise InputError(
            "nobody is named by --until locate, so there is nothing to tell apart", code="usage", key="--drive",
            hint="leave out --until",
        )  # fmt: skip


def _ask(asked: Asked, resume: str, *, saved: bool) -> Generator[Event, None, dict[str, Any]]:
    """The answer of `gap` with its exit status and what to do next; its events, which name the whole command. saved:
    whether there is something to go on with whatever this one keeps.
    """
    answer = dict[str, Any]()
    for event in gap(asked):
        if event.kind == "result":
            answer = dict(event.data)
        else:
            goes_on = {"resume": resume, "saved": saved or event.data.get("saved", True)}
            yield event._replace(data={**event.data, **goes_on}) if saved or "resume" in event.data else event
    return answer


def _rounds(
    asked: Asked, wish: Wish, answer: dict[str, Any], driven: Driven, resume: str, vehicle: VehicleSpec
) -> Generator[Event, None, dict[str, Any]]:
    """The last answer; `driven` is filled on the way."""
    effects = catalogue()
    run, bench = open_bench(wish, asked.out / DRIVES)
    bounds = bounds_of(vehicle, model_for(asked.model, vehicle).valid)
    beyond = {name for name, one in MENU.items() if plan_for(bench.vehicle, one, bench.dt_s, bounds) is None}
    told = set[str]()
    for number in range(1, ROUNDS + 1):
        for one in to_drive(answer, driven.names | told, effects):
            if one.name in beyond:
                told.add(one.name)
                yield Event("note", f"beyond the vehicle or the model's data, and so not driven: {one.words}")
        jobs = jobs_of(run, bench, to_drive(answer, driven.names | beyond, effects), len(driven.jobs), bounds)
        if not jobs:
            if answer["verdict"] in UNDECIDED:
                yield Event("note", f"nothing more is to be driven that would tell: {answer['sentence']}")
            return answer
        going_on = {"resume": resume, "saved": True}
        yield Event("note", _round_words(number, answer, [one.manoeuvre for one in jobs]), going_on)
        for event in drive_all(run, bench, jobs, wish):
            yield event._replace(data={**event.data, **going_on})
        driven.jobs.extend(jobs)
        driven.rounds.extend([number] * len(jobs))
        before = answer
        more = asked._replace(logs=[*asked.logs, *driven.logs], out=asked.out / f"round-{number}")
        answer = yield from _ask(more, resume, saved=True)
        beside = beside_words(before, answer)
        if beside:
            driven.apart.add(number)
            yield Event("warning", beside)
            return {**before, "words": [*before["words"], beside]}
        if answer["verdict"] == "cannot_test" and answer["words"] == before["words"]:
            yield Event("note", "driving has changed nothing of why these logs cannot tell")
            return answer
    return answer


def beside_words(before: Mapping[str, Any], answer: Mapping[str, Any]) -> str:
    """That an answer is none of what a set left open, in words; '' where it decides that, or leaves it open."""
    if before["verdict"] != "set" or answer["verdict"] == "cannot_test":
        return ""
    # The widest classes: what any log cannot tell from a name of the set is no other answer
    told = frozenset[str]().union(*(class_of(name, has_lateral=False) for name in before["set"]))
    names = [one["name"] for one in answer["effects"]]
    is_open = answer["verdict"] == "set" and not told.isdisjoint(answer["set"])
    if is_open or (names and told.issuperset(names)):
        return ""
    said = answer["sentence"]
    return f"with what the bench drove it would be none of the set ({said}): drives and logs do not go together"


def _round_words(number: int, answer: dict[str, Any], manoeuvres: Sequence[Manoeuvre]) -> str:
    what = "; ".join(one.words for one in manoeuvres)
    why = f" to tell {', '.join(answer['set'])} apart" if answer["set"] else f"; {answer['sentence']}"
    return f"round {number} of {ROUNDS} at most: the bench drives {what}{why}"


def _listed(driven: Driven) -> list[dict[str, Any]]:
    return [
        {
            "round": number,
            "manoeuvre": one.manoeuvre.name,
            "words": one.manoeuvre.words,
            "log": str(one.log),
            "fits": number not in driven.apart,
        }
        for number, one in zip(driven.rounds, driven.jobs, strict=True)
    ]


def _keep(asked: Asked, answer: dict[str, Any], resume: str) -> None:
    """The last answer in the folder itself, the first one beside it; gap.json is written last."""
    folder = Folder(asked.out)
    if not read_json(asked.out / ANSWER).get(DRIVES):  # it is the first one; gap.json is replaced last of all
        for now, first in ((ANSWER, FIRST_ANSWER), (PAGE, FIRST_PAGE)):
            part = asked.out / f"{first}.part"
            shutil.copyfile(asked.out / now, part)
            part.replace(asked.out / first)
    write_page(folder.page, answer, answer["next"], resume)
    folder.write_answer({key: value for key, value in answer.items() if key not in OF_A_RUN})
