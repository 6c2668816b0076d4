"""The repaired model of a `gap`, its proof, and older logs scored with it; what makes a signal worse is not saved."""

from __future__ import annotations

import shutil
from collections.abc import Generator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil import __version__
from tunefree_hil.base.events import Event
from tunefree_hil.gap.measured.blocks import block_s_of
from tunefree_hil.gap.result import is_absorbed
from tunefree_hil.gap.validation.gap_closed import (
    Gap,
    better_by_recalibration,
    explained_frac,
    floors_of,
    gaps_of,
    gross,
    grown,
    sizes_of,
    unforetold,
    worse_signals,
)
from tunefree_hil.gap.validation.holdout import Proof, Variant, prove
from tunefree_hil.gap.validation.repair import Repaired, changes_of, found_effects, repaired, write_repaired
from tunefree_hil.gap.validation.update_selection import Paid, chosen_runs, gained, groups_of, that_pays
from tunefree_hil.jobs.gap.acceptance import closes_it, is_borne_out, taken_back
from tunefree_hil.jobs.gap.report_text import CLOSES_NOTHING, UNJUDGED, is_unshown, missed_words

if TYPE_CHECKING:
    from tunefree_hil.config.schema import EffectSpec, ModelSpec
    from tunefree_hil.gap.measured.chain import Opened
    from tunefree_hil.gap.result import Kept
    from tunefree_hil.jobs.gap.folder import Folder
    from tunefree_hil.jobs.gap.gap import Material


class Mended(NamedTuple):
    """null: the model recalibrated; made: with what was found, None where nothing was; model: as written and loaded.
    left: groups of numbers (gap/validation/update_selection.py) that recalibration moved and that stay as they were, as that did not pay.
    """

    null: Repaired
    made: Repaired | None
    model: ModelSpec | None
    left: tuple[str, ...] = ()


def mend(folder: Folder, material: Material, opened: list[Opened], found: Kept, log_hash: str) -> Mended:
    """Write the repaired model where something was found. One that a cut-off run left is made anew. Either model has of
    what recalibration moved only what pays on the blocks that choose.
    """
    model, vehicle = material.model, material.vehicle
    paid = that_pays(model, vehicle, found.null, (), opened)
    null = repaired(model, vehicle, paid.values)
    if not found.names:
        return Mended(null, None, None, paid.left)
    effects = found_effects(found, log_hash, __version__)
    paid = _as_open(that_pays(model, vehicle, found.repaired, effects, opened), paid, material, found, effects, opened)
    made = repaired(model, vehicle, paid.values, effects)
    made = made._replace(changes=changes_of(material.given, made.model))
    for place in (folder.model, *folder.path.glob(f"part-*-{folder.model.name}")):  # a killed run's, half written
        shutil.rmtree(place, ignore_errors=True)
    story = {
        "logs": [{"name": one.name, "hash": one.log_hash} for one in material.drives],
        "from_model": f"sha256:{model.hash}",
        "version": __version__,
        "changes": _changes(made),
        "does_not_pay": list(paid.left),
    }
    return Mended(null, made, write_repaired(folder.model, model, made.model, story), paid.left)


def _as_open(
    mine: Paid, null: Paid, material: Material, found: Kept, effects: list[EffectSpec], opened: list[Opened]
) -> Paid:
    """What pays beside the effects, with those groups back that pay for recalibration alone, where they do no harm on
    the blocks that choose. Else the repair were held against a model that has moved what it may not move itself.
    """
    groups = groups_of(found.repaired, {one.name for one in effects})
    for group in [one for one in mine.left if one not in null.left]:
        wider = {**mine.values, **{key: found.repaired[key] for key in groups[group]}}
        runs = [
            chosen_runs(material.model, material.vehicle, values, effects, opened) for values in (wider, mine.values)
        ]
        if gained(*runs, floors_of(runs[0], material.model)).mean() > 0.0:
            mine = Paid(wider, tuple(one for one in mine.left if one != group))
    return mine


def as_data(mended: Mended) -> dict[str, Any]:
    """Keys of gap.json."""
    left = {"does_not_pay": list(mended.left)}
    if mended.made is None or mended.model is None:
        return {"model": None, "changes": [], **left}
    return {"model": mended.model.folder, "changes": _changes(mended.made), **left}


def _changes(made: Repaired) -> list[dict[str, Any]]:
    return [one._asdict() for one in made.changes]


def proved(
    folder: Folder, material: Material, opened: list[Opened], found: Kept, mended: Mended
) -> Generator[Event, None, tuple[dict[str, Any], Proof]]:
    """(keys of gap.json, the proof); the model is taken away again where it makes a signal worse."""
    variants = {"before": Variant(material.given), "recalibrated": Variant(mended.null.model, mended.null.day)}
    if mended.model is not None and mended.made is not None:
        variants["after"] = Variant(mended.model, mended.made.day)
    proof = prove(variants, material.vehicle, opened)
    if not proof.blocks:
        yield Event("warning", "no block that was kept for the proof is whole: the car stood, or signals are missing")
        return (yield from _unproved(folder, material, found, mended)), proof
    floors, left = floors_of(proof, material.model), unforetold(found.foretold)
    gaps = gaps_of(proof, floors, left)
    kind = material.model.plant.kind
    data: dict[str, Any] = {
        "signals": {name: one._asdict() for name, one in gaps.items()},
        "proof_blocks": proof.blocks,
        "block_s": round(block_s_of([one.ticks for one in opened], opened[0].dt_s), 2),
        "recalibration": _gained(gaps),
        "from_own_logs": material.model != material.given,
    }
    if mended.model is None:
        return data | _missed_there({**found.answer, **data}, gaps, opened, kind), proof
    older = yield from _older(material, mended.model)
    closes = explained_frac(proof, floors)
    data |= {
        "explained_frac": closes,
        "explicable_frac": explained_frac(proof, floors, left) if found.foretold else None,
        "older": older,
    }
    worse = worse_signals(proof, floors) | _worse_of(older)
    if not is_borne_out(found.answer, closes):
        data |= taken_back(found.answer, closes, kind)
        yield Event("warning", f"taken back: {data['words'][0]}")
        return _gone(folder, data | _missed_there({**found.answer, **data}, gaps, opened, kind)), proof
    by_chance = {signal: by for signal, by in grown(proof, floors).items() if signal not in worse}
    if not closes_it(found.answer, closes):  # its own signal's word is none for all the others
        worse, by_chance = worse | by_chance, {}
    data |= {"worse": _worse_words(worse), "grown": by_chance}
    closes_nothing = closes is not None and closes["value"] < CLOSES_NOTHING and not is_unshown(found.answer)
    return (_gone(folder, data) if worse or closes_nothing else data), proof


def _gone(folder: Folder, data: dict[str, Any]) -> dict[str, Any]:
    """Keys of gap.json, the repaired model taken away."""
    shutil.rmtree(folder.model)
    return data | {"model": None}


def _missed_there(
    answer: Mapping[str, Any], gaps: Mapping[str, Gap], opened: list[Opened], kind: str
) -> dict[str, Any]:
    """Keys of gap.json where nothing seems to be missing and the blocks that prove miss more than any calibrated model
    does: what they hold alone nobody could look for. kind: of the model's plant.
    """
    missed = gross(gaps, sizes_of(opened)) if answer["verdict"] == "none_missing" else {}
    if not missed:
        return {}
    worst = dict(sorted(missed.items(), key=lambda one: -one[1]))
    verdict, (_, *others) = "none_of_these", answer["words"] or [""]
    words = [missed_words(worst), *others]
    return {"verdict": verdict, "absorbed": is_absorbed(verdict, kind), "missed_in_proof": worst, "words": words}


def _unproved(
    folder: Folder, material: Material, found: Kept, mended: Mended
) -> Generator[Event, None, dict[str, Any]]:
    """Keys of gap.json where nothing could be proved: a name that only a proof can bear out is none."""
    data: dict[str, Any] = {"signals": {}, "explained_frac": None}
    if mended.model is None:
        return data
    if not is_borne_out(found.answer, None):
        data |= taken_back(found.answer, None, material.model.plant.kind)
        yield Event("warning", f"taken back: {data['words'][0]}")
        return _gone(folder, data)
    older = yield from _older(material, mended.model)
    data |= {"older": older, "worse": _worse_words(_worse_of(older))}
    return _gone(folder, data) if data["worse"] else data


def _worse_of(older: list[dict[str, Any]]) -> dict[str, float]:
    """Signals of older logs that a repair makes worse, and by how much."""
    return {f"{signal} of {one['name']}": by for one in older for signal, by in one["worse"].items()}


def _worse_words(worse: Mapping[str, float]) -> list[str]:
    return [f"{name} (by {100.0 * by:.0f} %)" for name, by in sorted(worse.items(), key=lambda one: -one[1])]


def _gained(gaps: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    better = better_by_recalibration(gaps)
    return {name: {"before": before, "recalibrated": after} for name, (before, after) in better.items()}


def _older(material: Material, model: ModelSpec) -> Generator[Event, None, list[dict[str, Any]]]:
    """Every older log by itself, the model as it was against the repaired one, both as a bench would drive them."""
    from tunefree_hil.gap.measured.chain import open_chain

    found = []
    for drive in material.older:
        yield Event("note", f"older log {drive.name}")
        variants = {"before": Variant(material.given), "after": Variant(model)}
        proof: Proof = prove(variants, material.vehicle, [open_chain(drive, material.vehicle)], whole=True)
        if not proof.blocks:
            yield Event("warning", f"older log {drive.name}: {UNJUDGED}")
        floors = floors_of(proof, material.model)
        signals = {
            name: {"before": one.before, "after": one.after, "unit": one.unit}
            for name, one in gaps_of(proof, floors, unforetold({})).items()
        }
        found.append(
            {
                "name": drive.name,
                "hash": drive.log_hash,
                "blocks": proof.blocks,
                "signals": signals,
                "worse": worse_signals(proof, floors),
            }
        )
    return found
