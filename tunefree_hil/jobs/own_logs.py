"""Asks the logs that a model was made from what it misses of them, for later logs to be held against that."""

from __future__ import annotations

import json
import time
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.gap import eta_of
from tunefree_hil.learn.write_model import CARD_FILE, write_card, write_effects

if TYPE_CHECKING:
    from tunefree_hil.config.schema import EffectSpec, VehicleSpec
    from tunefree_hil.gap.own_logs import Asked
    from tunefree_hil.gap.usual import Usual
    from tunefree_hil.learn.drives import Drive

LABEL = "what the model misses of its own logs"
T = TypeVar("T")


def ask_own_logs(folder: Path, vehicle: VehicleSpec, drives: Sequence[Drive]) -> Generator[Event, None, None]:
    """Add to a model's folder what its own logs say of it: to the card what explains them, or what is missed as usual,
    and then to the model the sensors' own numbers. Nothing where the model comes near its logs, or they are too few to
    tell. A model that is cut off before is whole: later logs are held against nothing then.
    """
    from tunefree_hil.config.load import load_model
    from tunefree_hil.gap.chain import open_chain
    from tunefree_hil.gap.look_first import look_first
    from tunefree_hil.gap.name import name
    from tunefree_hil.gap.own_logs import Asked, explained
    from tunefree_hil.gap.saturated import stops_of, without

    opened = [open_chain(without(one, stops_of(one)), vehicle) for one in drives]
    asked = Asked(load_model(folder), vehicle, opened)
    try:
        looked = (yield from _with_progress(look_first(*asked[:3]))).looked[0]
        if not looked.broken:
            return
        yield Event("note", f"{looked.missed}: the model's own logs are asked for what it lacks")
        found = yield from _with_progress(name(*asked))
        if any(one.broken for one in found.still):
            yield from _poor(folder, asked)
        else:
            _kept(folder, explained(found))
    except InputError as error:
        yield Event("note", f"{LABEL} is not told: {error.message}")
        return
    if found.effects:
        named = ", ".join(one.name for one in found.effects)
        yield Event("warning", f"what no calibration takes in is in these logs: {named}; `gap` on them adds it")


def _poor(folder: Path, asked: Asked) -> Generator[Event, None, None]:
    """Of a model that misses its own logs for no reason in the catalogue: its sensors' numbers, then what is usual."""
    from tunefree_hil.config.load import load_model
    from tunefree_hil.gap.own_logs import sensors, usual
    from tunefree_hil.gap.usual import usual_words

    found = yield from _with_progress(sensors(asked))
    if found:
        write_effects(folder, asked.model, found)
        yield Event("note", f"its sensors, by its own logs: {', '.join(_words(one) for one in found)}")
    told = yield from _with_progress(usual(asked._replace(model=load_model(folder))))
    _kept(folder, told)
    yield from (Event("warning", f"{words}, for no reason in the catalogue") for words in usual_words(told))


def _words(one: EffectSpec) -> str:
    return f"{one.name} ({', '.join(f'{key} {value:.4g}' for key, value in one.params.items())})"


def _with_progress(search: Generator[str, None, T]) -> Generator[Event, None, T]:
    """A search with its stages as progress."""
    began = time.monotonic()
    try:
        while True:
            try:
                stage = next(search)
            except StopIteration as end:
                return end.value
            yield Event("progress", stage, {"label": LABEL, **eta_of(stage, began)})
    finally:
        search.close()


def _kept(folder: Path, usual: Usual) -> None:
    """In the card."""
    from tunefree_hil.gap.usual import as_data

    if more := as_data(usual):
        card = json.loads((folder / CARD_FILE).read_text(encoding="utf-8"))
        write_card(folder, card | more)
