"""Analyses what a model misses of its own calibration logs, as the baseline for later logs."""

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
from tunefree_hil.jobs.progress import progress_data, relay_events
from tunefree_hil.learn.model_folder import CARD_FILE, write_card, write_effects

if TYPE_CHECKING:
    from tunefree_hil.config.schema import EffectSpec, ModelSpec, VehicleSpec
    from tunefree_hil.gap.calibration_logs import CalibrationLogs
    from tunefree_hil.gap.measured.chain import MeasuredDrive
    from tunefree_hil.gap.pipeline import Diagnosis
    from tunefree_hil.gap.progress import SearchProgress
    from tunefree_hil.gap.selection.baseline_misfit import BaselineMisfit
    from tunefree_hil.gap.workers.worker import OpenProblem
    from tunefree_hil.learn.drives.drive import Drive

LABEL = "calibration logs"
ANALYSED_KEY, CALIBRATED_KEY = "own_logs_asked", "free_run_rms"  # of card.json
MAX_ANALYSED_S = 900.0  # of driving; more of it does not change the baseline
T = TypeVar("T")


def analyse_calibration_logs(
    folder: Path, vehicle: VehicleSpec, drives: Sequence[Drive]
) -> Generator[Event, None, None]:
    """Add to a model's folder what its calibration logs show: effects or a baseline misfit in the card, and effects of
    sensors and tyres in the model.

    Nothing is added where the model agrees with its logs, or where they are too few. The card records that the analysis
    is done. An interrupted model is complete, but has no baseline.
    """
    _remove_previous_analysis(folder)
    try:
        opened = _open_drives(drives, vehicle)
        if opened:
            yield from _analyse(folder, vehicle, opened)
    except TunefreeError as error:  # the model is usable without the analysis
        yield Event("note", f"{LABEL}: not analysed: {error.message}")
    _add_to_card(folder, {ANALYSED_KEY: True})


def _remove_previous_analysis(folder: Path) -> None:
    """Remove what an interrupted analysis has written."""
    from tunefree_hil.config.load import load_model
    from tunefree_hil.gap.model.card import CALIBRATION_PRIORS_KEY
    from tunefree_hil.gap.selection.baseline_misfit import BASELINE_KEY, INCONSISTENT_KEY, UNEXPLAINED_KEY
    from tunefree_hil.learn.model_folder import CALIBRATION_EFFECTS, CALIBRATION_LOGS

    card = json.loads((folder / CARD_FILE).read_text(encoding="utf-8"))
    keys = {BASELINE_KEY, INCONSISTENT_KEY, UNEXPLAINED_KEY, CALIBRATION_EFFECTS, CALIBRATION_PRIORS_KEY}
    if keys & set(card):
        write_card(folder, {key: entry for key, entry in card.items() if key not in keys})
    model = load_model(folder)
    kept_effects = [effect for effect in model.effects if effect.provenance.get("by") != CALIBRATION_LOGS]
    if len(kept_effects) < len(model.effects):
        write_effects(folder, model, kept_effects)


def is_analysed(folder: Path) -> bool:
    """Whether the calibration logs of a model are analysed completely."""
    return bool(json.loads((folder / CARD_FILE).read_text(encoding="utf-8")).get(ANALYSED_KEY))


def list_analysis_warnings(model: ModelSpec) -> Iterator[str]:
    """A warning for a model of `calibrate` whose analysis was interrupted; nothing for any other model."""
    from tunefree_hil.gap.model.card import load_model_card

    card = load_model_card(model)
    if CALIBRATED_KEY in card and not card.get(ANALYSED_KEY) and "repair" not in card:
        yield (
            f"the calibration logs of {model.folder} were not analysed (interrupted, or an older version), so its "
            "baseline misfit is unknown: run the same `calibrate` again to continue"
        )


def _open_drives(drives: Sequence[Drive], vehicle: VehicleSpec) -> list[MeasuredDrive]:
    """The drives that hold a speed; a sample of them where there are many."""
    from tunefree_hil.gap.measured.chain import build_measured_drive, has_speed
    from tunefree_hil.gap.measured.signals import drop_signals, find_sensor_limits

    moving = [drive for drive in drives if has_speed(drive, vehicle)]
    sample = sample_drives(moving)
    return [build_measured_drive(drop_signals(drive, find_sensor_limits(drive)), vehicle) for drive in sample]


def sample_drives(drives: Sequence[Drive]) -> list[Drive]:
    """All drives, or of more than MAX_ANALYSED_S those at evenly spaced times, which prefers long ones."""
    ends_s = np.cumsum([drive.n_rows * drive.dt_s for drive in drives])
    if not len(ends_s) or ends_s[-1] <= MAX_ANALYSED_S:
        return list(drives)
    marks = max(math.floor(MAX_ANALYSED_S * len(drives) / ends_s[-1]), 1)
    indices = np.searchsorted(ends_s, (np.arange(marks) + 0.5) * ends_s[-1] / marks)
    return [drives[i] for i in sorted({int(index) for index in indices})]


def _analyse(folder: Path, vehicle: VehicleSpec, opened: Sequence[MeasuredDrive]) -> Generator[Event, None, None]:
    from tunefree_hil.config.load import load_model
    from tunefree_hil.gap.calibration_logs import (
        CalibrationLogs,
        baseline_from_search,
        find_vehicle_limits,
        named_vehicle_limits,
    )
    from tunefree_hil.gap.pipeline import diagnose, find_inconsistent_gains, locate
    from tunefree_hil.gap.selection.baseline_misfit import NO_BASELINE

    logs = CalibrationLogs(load_model(folder), vehicle, opened)
    located = yield from _report_progress("all links", locate(*logs[:3]))
    link = located.links_before[0]
    _store_baseline(folder, NO_BASELINE._replace(inconsistent_gains=find_inconsistent_gains(located.problem)))
    if not link.is_broken:
        limits = yield from _report_progress("limits of the vehicle", find_vehicle_limits(logs))
        yield from _add_vehicle_effects(folder, logs, limits)
        if not limits:
            _store_parameters(folder, located.problem)
        return
    yield Event("note", f"{link.text}: the calibration logs are searched for effects")
    diagnosis = yield from _report_progress("effects", diagnose(*logs))
    if any(after.is_broken for after in diagnosis.links_after):
        yield from _analyse_poor_model(folder, logs)
        return
    if limits := named_vehicle_limits(diagnosis, logs.model):
        yield from _add_vehicle_effects(folder, logs, limits)
        return
    _store_baseline(folder, baseline_from_search(diagnosis))
    if text := _describe_diagnosis(diagnosis, logs.model):
        yield Event("warning", f"the calibration logs show an effect that the calibration cannot fit: {text}")


def _add_vehicle_effects(
    folder: Path, logs: CalibrationLogs, limits: Sequence[EffectSpec]
) -> Generator[Event, None, None]:
    """Add limits of the vehicle to its model, and analyse again."""
    if limits:
        write_effects(folder, logs.model, [*logs.model.effects, *limits])
        effects = ", ".join(map(_describe_effect, limits))
        yield Event("note", f"limits of the vehicle, from its calibration logs: {effects}")
        yield from _analyse(folder, logs.vehicle, logs.drives)


def _describe_diagnosis(diagnosis: Diagnosis, model: ModelSpec) -> str:
    """The effects that explain the calibration logs; '' where there are none."""
    from tunefree_hil.gap.selection.confounding import ACCEL_BIAS, GRADE, may_be_grade
    from tunefree_hil.gap.selection.reasons import VerdictKind

    if diagnosis.verdict.kind is VerdictKind.SET:
        return f"one of {', '.join(diagnosis.set_names)}, which they cannot separate"
    names = [effect.name for effect in diagnosis.effects]
    if not names:
        return ""
    if ACCEL_BIAS in names and may_be_grade(diagnosis.repaired.fit, model):
        return f"{', '.join(names)}; {ACCEL_BIAS} may also be a {GRADE} that is common to all of them"
    return f"{', '.join(names)}; `gap` on these logs adds it if the holdout blocks confirm it"


def _analyse_poor_model(folder: Path, logs: CalibrationLogs) -> Generator[Event, None, None]:
    """Of a model that misses its calibration logs for no reason in the catalogue: add effects of sensors and tyres, and
    store the remaining misfit as the baseline.
    """
    from tunefree_hil.config.load import load_model
    from tunefree_hil.gap.calibration_logs import find_sensor_effects, find_tyre_effects, measure_baseline_misfit
    from tunefree_hil.gap.pipeline import locate
    from tunefree_hil.gap.result_text import baseline_texts
    from tunefree_hil.gap.validation.repair import apply_own_numbers

    for label, search in (("sensors", find_sensor_effects), ("tyres", find_tyre_effects)):
        logs = logs._replace(model=load_model(folder))
        if effects := (yield from _report_progress(label, search(logs))):
            write_effects(folder, logs.model, [*logs.model.effects, *effects])
            yield Event("note", f"{label}, from the calibration logs: {', '.join(map(_describe_effect, effects))}")
    logs = logs._replace(model=load_model(folder))
    located = yield from _report_progress("parameters", locate(*logs[:3]))
    _store_parameters(folder, located.problem)
    logs = logs._replace(model=apply_own_numbers(load_model(folder), logs.vehicle))  # as `gap` loads it later
    baseline = yield from _report_progress("baseline misfit", measure_baseline_misfit(logs))
    _store_baseline(folder, baseline)
    yield from (Event("warning", f"{words}, for no reason in the catalogue") for words in baseline_texts(baseline))


def _describe_effect(effect: EffectSpec) -> str:
    return f"{effect.name} ({', '.join(f'{key} {value:.4g}' for key, value in effect.params.items())})"


def _report_progress(step: str, search: Generator[SearchProgress, None, T]) -> Generator[Event, None, T]:
    """The stages of a search as progress events; the remaining time starts anew with each search."""
    began, label = time.monotonic(), f"{LABEL}: {step}"
    return relay_events(search, lambda now: Event("progress", now.text, {"label": label, **progress_data(now, began)}))


def _store_baseline(folder: Path, baseline: BaselineMisfit) -> None:
    """Write a baseline to the card."""
    from tunefree_hil.gap.selection.baseline_misfit import card_entries

    _add_to_card(folder, card_entries(baseline))


def _store_parameters(folder: Path, problem: OpenProblem) -> None:
    from tunefree_hil.gap.calibration_logs import prior_from_problem
    from tunefree_hil.gap.estimation.calibration_priors import card_entry_from_prior

    _add_to_card(folder, card_entry_from_prior(prior_from_problem(problem)))


def _add_to_card(folder: Path, entries: Mapping[str, Any]) -> None:
    card = json.loads((folder / CARD_FILE).read_text(encoding="utf-8"))
    write_card(folder, {**card, **entries})
