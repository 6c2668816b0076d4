"""Makes the repaired model of a `gap`, verifies it on the holdout blocks, and scores older logs with it."""

from __future__ import annotations

import shutil
from collections.abc import Generator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil import __version__
from tunefree_hil.base.events import Event
from tunefree_hil.gap.measured.blocks import block_length_s
from tunefree_hil.gap.validation.block_runs import BlockErrors, Variant, run_blocks
from tunefree_hil.gap.validation.gap_closed import (
    SignalGap,
    closed_share,
    error_floors,
    find_gross_misses,
    find_grown_signals,
    find_worse_signals,
    improved_by_recalibration,
    signal_gaps,
    signal_sizes,
    unpredictable_shares,
)
from tunefree_hil.gap.validation.repair import (
    RepairedModel,
    effect_specs,
    list_changes,
    repair_model,
    write_repaired_model,
)
from tunefree_hil.gap.validation.update_selection import (
    UpdateSelection,
    error_gains,
    run_selection_blocks,
    select_updates,
    update_groups,
)
from tunefree_hil.jobs.gap.acceptance import (
    ACCEPTANCE,
    closes_gap,
    holdout_misfit_fields,
    is_absent_from_holdout,
    is_confirmed,
    rejection_fields,
    rejection_reason,
)
from tunefree_hil.jobs.gap.report_text import NOT_DRIVABLE, describe_holdout_misfit, describe_rejection

if TYPE_CHECKING:
    from tunefree_hil.config.schema import EffectSpec, ModelSpec
    from tunefree_hil.gap.measured.chain import MeasuredDrive
    from tunefree_hil.gap.result import SearchResult
    from tunefree_hil.jobs.gap.folder import GapFolder
    from tunefree_hil.jobs.gap.options import GapInputs


class RepairOutcome(NamedTuple):
    """What a repair makes.

    Attributes:
        recalibrated: The recalibrated model without effects.
        repaired: The same with the effects; None where no effect was found.
        model: The repaired model as written and loaded again.
        reverted_groups: Groups of parameters (gap/validation/update_selection.py) that keep their values, as moving
            them does not improve the free runs.
    """

    recalibrated: RepairedModel
    repaired: RepairedModel | None
    model: ModelSpec | None
    reverted_groups: tuple[str, ...] = ()


def make_repair(
    folder: GapFolder, inputs: GapInputs, opened: list[MeasuredDrive], search: SearchResult, log_hash: str
) -> RepairOutcome:
    """Write the repaired model where effects were found; a model left by an interrupted run is replaced.

    Both models keep only those recalibrated parameters that improve the free runs on the selection blocks.
    """
    model, vehicle = inputs.model, inputs.vehicle
    updates = select_updates(model, vehicle, search.recalibrated_values, (), opened)
    recalibrated = repair_model(model, vehicle, updates.values)
    if not search.names:
        return RepairOutcome(recalibrated, None, None, updates.reverted_groups)
    effects = effect_specs(search, log_hash, __version__)
    updates = _select_updates_beside_effects(inputs, search, effects, opened, updates)
    repaired = repair_model(model, vehicle, updates.values, effects)
    repaired = repaired._replace(changes=list_changes(inputs.original_model, repaired.model))
    for unfinished in (folder.model, *folder.path.glob(f"part-*-{folder.model.name}")):  # of an interrupted run
        shutil.rmtree(unfinished, ignore_errors=True)
    provenance = {
        "logs": [{"name": drive.name, "hash": drive.log_hash} for drive in inputs.drives],
        "from_model": f"sha256:{model.hash}",
        "version": __version__,
        "changes": _change_rows(repaired),
        "does_not_pay": list(updates.reverted_groups),
    }
    written = write_repaired_model(folder.model, model, repaired.model, provenance)
    return RepairOutcome(recalibrated, repaired, written, updates.reverted_groups)


def _select_updates_beside_effects(
    inputs: GapInputs,
    search: SearchResult,
    effects: list[EffectSpec],
    opened: list[MeasuredDrive],
    alone: UpdateSelection,
) -> UpdateSelection:
    """The updates that are kept beside the effects.

    Groups that are kept without effects (`alone`) are kept here too, unless they make the selection blocks worse: the
    repaired model must not be compared with a model that has moved more than it may move itself.
    """
    model, vehicle = inputs.model, inputs.vehicle
    updates = select_updates(model, vehicle, search.repaired_values, effects, opened)
    groups = update_groups(search.repaired_values, {effect.name for effect in effects})
    for group in [name for name in updates.reverted_groups if name not in alone.reverted_groups]:
        wider = {**updates.values, **{key: search.repaired_values[key] for key in groups[group]}}
        runs = [run_selection_blocks(model, vehicle, values, effects, opened) for values in (wider, updates.values)]
        if error_gains(*runs, error_floors(runs[0], model)).mean() > 0.0:
            updates = UpdateSelection(wider, tuple(name for name in updates.reverted_groups if name != group))
    return updates


def repair_fields(outcome: RepairOutcome) -> dict[str, Any]:
    """Keys of gap.json for a model that is not verified yet."""
    reverted = {"does_not_pay": list(outcome.reverted_groups)}
    if outcome.repaired is None or outcome.model is None:
        return {"model": None, "changes": [], **reverted}
    return {"model": outcome.model.folder, "changes": _change_rows(outcome.repaired), **reverted}


def _change_rows(repaired: RepairedModel) -> list[dict[str, Any]]:
    return [change._asdict() for change in repaired.changes]


def verify_repair(
    folder: GapFolder, inputs: GapInputs, opened: list[MeasuredDrive], search: SearchResult, outcome: RepairOutcome
) -> Generator[Event, None, tuple[dict[str, Any], BlockErrors]]:
    """Run all models over the holdout blocks, and remove the repaired model where it makes a signal worse.

    Returns:
        The keys of gap.json, and the runs.
    """
    recalibrated = Variant(outcome.recalibrated.model, outcome.recalibrated.day_effects)
    variants = {"before": Variant(inputs.original_model), "recalibrated": recalibrated}
    if outcome.model is not None and outcome.repaired is not None:
        variants["after"] = Variant(outcome.model, outcome.repaired.day_effects)
    holdout = run_blocks(variants, inputs.vehicle, opened)
    if not holdout.n_blocks:
        yield Event("warning", "no holdout block is complete: the vehicle stood, or signals are missing")
        return (yield from _score_without_holdout(folder, inputs, search, outcome)), holdout
    floors, unpredictable = error_floors(holdout, inputs.model), unpredictable_shares(search.predictable_shares)
    gaps = signal_gaps(holdout, floors, unpredictable)
    data: dict[str, Any] = {
        "signals": {name: gap._asdict() for name, gap in gaps.items()},
        "proof_blocks": holdout.n_blocks,
        "block_s": round(block_length_s([drive.ticks for drive in opened], opened[0].dt_s), 2),
        "recalibration": _recalibration_gain(gaps),
        "from_own_logs": inputs.model != inputs.original_model,
    }
    if outcome.model is None:
        return data | _holdout_misfit({**search.answer, **data}, gaps, opened, inputs), holdout
    older = yield from _score_older_logs(inputs, outcome.model)
    data |= {
        "explained_frac": closed_share(holdout, floors),
        "explicable_frac": closed_share(holdout, floors, unpredictable) if search.predictable_shares else None,
        "older": older,
    }
    if not is_confirmed(search.answer, data["explained_frac"]):
        data |= yield from _reject(folder, inputs, search, data["explained_frac"])
        return data | _holdout_misfit({**search.answer, **data}, gaps, opened, inputs), holdout
    worse = find_worse_signals(holdout, floors) | _worse_older_signals(older)
    return _judge_worse_signals(folder, search, data, worse, find_grown_signals(holdout, floors)), holdout


def _judge_worse_signals(
    folder: GapFolder,
    search: SearchResult,
    data: dict[str, Any],
    worse: dict[str, float],
    grown: Mapping[str, float],
) -> dict[str, Any]:
    """Add the signals that are worse, and remove the model where there are any, or where it closes nothing.

    Args:
        folder: Folder of the answer.
        search: Result of the search.
        data: Keys of gap.json so far.
        worse: Signals that are surely worse, and by which share.
        grown: All signals whose error grew, be it by chance.
    """
    answer, gap_share = search.answer, data["explained_frac"]
    by_chance = {signal: share for signal, share in grown.items() if signal not in worse}
    if not closes_gap(answer, gap_share):  # confirmed by its own signals alone, which show nothing of the others
        worse, by_chance = worse | by_chance, {}
    data |= {"worse": _describe_worse(worse), "grown": by_chance}
    is_small = gap_share is not None and gap_share["value"] < ACCEPTANCE.min_gap_share
    has_no_gain = is_small and not is_absent_from_holdout(answer)
    return data | _remove_model(folder) if worse or has_no_gain else data


def _remove_model(folder: GapFolder) -> dict[str, Any]:
    """Remove the repaired model. Returns: the keys of gap.json that this changes."""
    shutil.rmtree(folder.model)
    return {"model": None}


def _reject(
    folder: GapFolder, inputs: GapInputs, search: SearchResult, gap_share: Mapping[str, float] | None
) -> Generator[Event, None, dict[str, Any]]:
    """Reject the named effects and remove the model with them. Returns: the keys of gap.json that this changes."""
    reason = rejection_reason(search.answer, gap_share)
    fields = rejection_fields(search.answer, gap_share, reason, inputs.model.plant.kind)
    text = describe_rejection(search.names, reason, gap_share)
    yield Event("warning", f"rejected: {text}")
    return fields | {"words": [text]} | _remove_model(folder)


def _holdout_misfit(
    answer: Mapping[str, Any], gaps: Mapping[str, SignalGap], opened: list[MeasuredDrive], inputs: GapInputs
) -> dict[str, Any]:
    """Keys of gap.json that change where nothing seems to be missing but the holdout blocks are missed grossly."""
    missed = find_gross_misses(gaps, signal_sizes(opened)) if answer["verdict"] == "none_missing" else {}
    if not missed:
        return {}
    fields = holdout_misfit_fields(answer, missed, inputs.model.plant.kind)
    _, *further = answer["words"] or [""]
    return fields | {"words": [describe_holdout_misfit(fields["missed_in_proof"]), *further]}


def _score_without_holdout(
    folder: GapFolder, inputs: GapInputs, search: SearchResult, outcome: RepairOutcome
) -> Generator[Event, None, dict[str, Any]]:
    """Keys of gap.json where no holdout block could be run: effects that need their confirmation are rejected."""
    data: dict[str, Any] = {"signals": {}, "explained_frac": None}
    if outcome.model is None:
        return data
    if not is_confirmed(search.answer, None):
        return data | (yield from _reject(folder, inputs, search, None))
    older = yield from _score_older_logs(inputs, outcome.model)
    data |= {"older": older, "worse": _describe_worse(_worse_older_signals(older))}
    return data | _remove_model(folder) if data["worse"] else data


def _worse_older_signals(older: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Signals of older logs that the repair makes worse, and by which share."""
    return {f"{signal} of {log['name']}": share for log in older for signal, share in log["worse"].items()}


def _describe_worse(worse: Mapping[str, float]) -> list[str]:
    ordered = sorted(worse.items(), key=lambda item: -item[1])
    return [f"{name} (by {100.0 * share:.0f} %)" for name, share in ordered]


def _recalibration_gain(gaps: Mapping[str, SignalGap]) -> dict[str, dict[str, float]]:
    improved = improved_by_recalibration(gaps)
    return {name: {"before": before, "recalibrated": after} for name, (before, after) in improved.items()}


def _score_older_logs(inputs: GapInputs, model: ModelSpec) -> Generator[Event, None, list[dict[str, Any]]]:
    """Score every older log by itself with the original and the repaired model, both as a bench would drive them."""
    from tunefree_hil.gap.measured.chain import build_measured_drive

    scores = []
    variants = {"before": Variant(inputs.original_model), "after": Variant(model)}
    for drive in inputs.older:
        yield Event("note", f"older log {drive.name}")
        holdout = run_blocks(variants, inputs.vehicle, [build_measured_drive(drive, inputs.vehicle)], role=None)
        if not holdout.n_blocks:
            yield Event("warning", f"older log {drive.name}: {NOT_DRIVABLE}")
        floors = error_floors(holdout, inputs.model)
        signals = {
            name: {"before": gap.before, "after": gap.after, "unit": gap.unit}
            for name, gap in signal_gaps(holdout, floors, unpredictable_shares({})).items()
        }
        scores.append(
            {
                "name": drive.name,
                "hash": drive.log_hash,
                "blocks": holdout.n_blocks,
                "signals": signals,
                "worse": find_worse_signals(holdout, floors),
            }
        )
    return scores
