"""Asks the logs that a model was made from what it misses of them, for later logs to be held against that."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from tunefree_hil.base.errors import TunefreeError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.progress import eta_of, told
from tunefree_hil.learn.model_folder import CARD_FILE, write_card, write_effects

if TYPE_CHECKING:
    from tunefree_hil.config.schema import EffectSpec, ModelSpec, VehicleSpec
    from tunefree_hil.gap.calibration_logs import OwnLogs
    from tunefree_hil.gap.measured.chain import Opened
    from tunefree_hil.gap.pipeline import Named
    from tunefree_hil.gap.selection.baseline_misfit import Usual
    from tunefree_hil.gap.workers.worker import Question
    from tunefree_hil.learn.drives.drive import Drive

LABEL = "what the model misses of its own logs"
ASKED, BY_CALIBRATE = "own_logs_asked", "free_run_rms"  # of card.json
MOST_S = 900.0  # of driving that is asked: what a model misses of its own logs shows in a quarter of an hour
T = TypeVar("T")


def ask_own_logs(folder: Path, vehicle: VehicleSpec, drives: Sequence[Drive]) -> Generator[Event, None, None]:
    """Add to a model's folder what its own logs say of it: to the card what explains them, or what is missed as usual,
    and then to the model the sensors' own numbers. Nothing where the model comes near its logs, or they are too few to
    tell; the card says that they were asked. A model that is cut off before is whole: later logs are held against
    nothing then.
    """
    _forget(folder)
    try:
        opened = _opened(drives, vehicle)
        if opened:
            yield from _asked(folder, vehicle, opened)
    except TunefreeError as error:  # whatever it is, the model is made
        yield Event("note", f"{LABEL} is not told: {error.message}")
    _added_to_card(folder, {ASKED: True})


def _forget(folder: Path) -> None:
    """What a search that was cut off had written already."""
    from tunefree_hil.config.load import load_model
    from tunefree_hil.gap.model.card import OWN_NUMBERS
    from tunefree_hil.gap.selection.baseline_misfit import KEY, OWN_MISSED, RESTLESS
    from tunefree_hil.learn.model_folder import OWN_EFFECTS, OWN_LOGS

    card = json.loads((folder / CARD_FILE).read_text(encoding="utf-8"))
    told = {KEY, RESTLESS, OWN_MISSED, OWN_EFFECTS, OWN_NUMBERS}
    if told & set(card):
        write_card(folder, {key: said for key, said in card.items() if key not in told})
    model = load_model(folder)
    stay = [one for one in model.effects if one.provenance.get("by") != OWN_LOGS]
    if len(stay) < len(model.effects):
        write_effects(folder, model, stay)


def were_asked(folder: Path) -> bool:
    """Whether a model's own logs were asked to the end."""
    return bool(json.loads((folder / CARD_FILE).read_text(encoding="utf-8")).get(ASKED))


def half_made(model: ModelSpec) -> Iterator[str]:
    """A warning for a model of `calibrate` that was cut off while it asked its logs; nothing for every other."""
    from tunefree_hil.gap.model.card import card_of

    card = card_of(model)
    if BY_CALIBRATE in card and not card.get(ASKED) and "repair" not in card:
        yield (
            f"{model.folder} was made without its own logs being asked (cut off, or by an older version), and what it "
            "misses of them is not known: the same `calibrate` goes on with it"
        )


def _opened(drives: Sequence[Drive], vehicle: VehicleSpec) -> list[Opened]:
    """Those of the logs that say how the car moves; of many some, from all over them."""
    from tunefree_hil.gap.measured.chain import open_chain, says_speed
    from tunefree_hil.gap.measured.signals import stops_of, without

    found = [one for one in drives if says_speed(one, vehicle)]
    return [open_chain(without(one, stops_of(one)), vehicle) for one in some_of(found)]


def some_of(drives: Sequence[Drive]) -> list[Drive]:
    """All of them, or of more than MOST_S those in which marks at even distances fall: long ones rather than short."""
    ends_s = np.cumsum([one.ticks * one.dt_s for one in drives])
    if not len(ends_s) or ends_s[-1] <= MOST_S:
        return list(drives)
    marks = max(math.floor(MOST_S * len(drives) / ends_s[-1]), 1)
    hit = np.searchsorted(ends_s, (np.arange(marks) + 0.5) * ends_s[-1] / marks)
    return [drives[i] for i in sorted({int(one) for one in hit})]


def _asked(folder: Path, vehicle: VehicleSpec, opened: Sequence[Opened]) -> Generator[Event, None, None]:
    from tunefree_hil.config.load import load_model
    from tunefree_hil.gap.calibration_logs import OwnLogs, explained, limits, limits_named
    from tunefree_hil.gap.pipeline import look_first, name, restless_of
    from tunefree_hil.gap.selection.baseline_misfit import NOTHING

    asked = OwnLogs(load_model(folder), vehicle, opened)
    first = yield from _with_progress("every link", look_first(*asked[:3]))
    looked = first.looked[0]
    _kept(folder, NOTHING._replace(restless=restless_of(first.question)))
    if not looked.broken:
        own = yield from _with_progress("limits of the car", limits(asked))
        yield from _of_the_car(folder, asked, own)
        if not own:
            _numbers_kept(folder, first.question)
        return
    yield Event("note", f"{looked.missed}: the model's own logs are asked for what it lacks")
    found = yield from _with_progress("what it lacks", name(*asked))
    if any(one.broken for one in found.still):
        yield from _poor(folder, asked)
        return
    if own := limits_named(found, asked.model):
        yield from _of_the_car(folder, asked, own)
        return
    _kept(folder, explained(found))
    if words := _named_words(found, asked.model):
        yield Event("warning", f"what no calibration takes in is in these logs: {words}")


def _of_the_car(folder: Path, asked: OwnLogs, own: Sequence[EffectSpec]) -> Generator[Event, None, None]:
    """Limits of the car go into its model; what is missed beside them is asked once more."""
    if own:
        write_effects(folder, asked.model, [*asked.model.effects, *own])
        yield Event("note", f"of the car, by its own logs: {', '.join(_words(one) for one in own)}")
        yield from _asked(folder, asked.vehicle, asked.drives)


def _named_words(found: Named, model: ModelSpec) -> str:
    """What explains the own logs, in words; '' where nobody is named."""
    from tunefree_hil.gap.selection.confounding import HILL, OFFSET, may_be_hill

    if found.verdict == "set":
        return f"one of {', '.join(found.set)}, which they cannot tell apart"
    named = [one.name for one in found.effects]
    if not named:
        return ""
    if OFFSET in named and may_be_hill(found.repaired.fitted, model):
        return f"{', '.join(named)}; {OFFSET} may as well be a {HILL} that all of them have"
    return f"{', '.join(named)}; `gap` on them adds it where its proof bears it out"


def _poor(folder: Path, asked: OwnLogs) -> Generator[Event, None, None]:
    """Of a model that misses its own logs for no reason in the catalogue: its sensors' and tyres' numbers, then what is
    usual.
    """
    from tunefree_hil.config.load import load_model
    from tunefree_hil.gap.calibration_logs import sensors, tyres, usual
    from tunefree_hil.gap.pipeline import look_first
    from tunefree_hil.gap.selection.baseline_misfit import usual_words
    from tunefree_hil.gap.validation.repair import moved

    for what, search in (("its sensors", sensors), ("its tyres", tyres)):
        asked = asked._replace(model=load_model(folder))
        if found := (yield from _with_progress(what, search(asked))):
            write_effects(folder, asked.model, [*asked.model.effects, *found])
            yield Event("note", f"{what}, by its own logs: {', '.join(_words(one) for one in found)}")
    asked = asked._replace(model=load_model(folder))
    looked = yield from _with_progress("its numbers", look_first(*asked[:3]))
    _numbers_kept(folder, looked.question)
    asked = asked._replace(model=moved(load_model(folder), asked.vehicle))  # as a later `gap` has it
    told = yield from _with_progress("what is usual", usual(asked))
    _kept(folder, told)
    yield from (Event("warning", f"{words}, for no reason in the catalogue") for words in usual_words(told))


def _words(one: EffectSpec) -> str:
    return f"{one.name} ({', '.join(f'{key} {value:.4g}' for key, value in one.params.items())})"


def _with_progress(what: str, search: Generator[str, None, T]) -> Generator[Event, None, T]:
    """A search with its stages as progress, which begins anew with each."""
    began, label = time.monotonic(), f"{LABEL}: {what}"
    return told(search, lambda stage: Event("progress", stage, {"label": label, **eta_of(stage, began)}))


def _kept(folder: Path, usual: Usual) -> None:
    """In the card."""
    from tunefree_hil.gap.selection.baseline_misfit import as_data

    _added_to_card(folder, as_data(usual))


def _numbers_kept(folder: Path, question: Question) -> None:
    from tunefree_hil.gap.calibration_logs import numbers_of
    from tunefree_hil.gap.estimation.calibration_priors import as_data

    _added_to_card(folder, as_data(numbers_of(question)))


def _added_to_card(folder: Path, more: Mapping[str, Any]) -> None:
    card = json.loads((folder / CARD_FILE).read_text(encoding="utf-8"))
    write_card(folder, {**card, **more})
