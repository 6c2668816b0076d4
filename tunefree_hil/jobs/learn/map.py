"""Learns the open-loop map of a vehicle from logs, and the steering map beside it, with figures of both."""

from __future__ import annotations

import json
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tunefree_hil import __version__
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.base.open_loop_map import MAP_FILE
from tunefree_hil.jobs.learn.logs import read_logs
from tunefree_hil.jobs.learn.options import MapOptions
from tunefree_hil.jobs.learn.steering import (
    is_model,
    learn_steering_of_logs,
    map_model,
    result_of,
    steering_target,
)
from tunefree_hil.jobs.preconditions import ErrorPlace, require_model_of_vehicle
from tunefree_hil.jobs.progress import count_data, relay_events
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.open_loop_map.build import GatheredSamples, LearnedMap, MapProgress, gather_samples, learn_map
from tunefree_hil.learn.open_loop_map.cells import compute_cell_errors, compute_rms
from tunefree_hil.learn.open_loop_map.samples import PEDALS
from tunefree_hil.learn.open_loop_map.table import (
    EXTRAPOLATED,
    INTERPOLATED,
    SUPPORTED,
    is_monotone,
    law_from_calibration,
    write_table,
)

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec
    from tunefree_hil.figures.learning.map import MapPicture

SCHEMA = "tunefree.map/1"


def map_logs(options: MapOptions) -> Iterator[Event]:
    """Read the logs, train the nets, and write the map and the steering map; of a model only the steering map."""
    from tunefree_hil.config.load import load_vehicle

    if is_model(options.logs):
        yield from map_model(options)
        return
    from tunefree_hil.learn.training.map_nets import import_torch

    import_torch()  # raises before an hour of logs is read
    vehicle = load_vehicle(options.vehicle)
    target = resolve_target(options.out, vehicle)
    drives = yield from read_logs(options.logs, vehicle)
    gathered = gather_samples(drives, vehicle)
    yield from (Event("note", note) for note in gathered.notes)
    for delay in gathered.delays.values():
        if not delay.is_identified:
            yield Event("warning", delay.note)
    started = time.monotonic()
    learned = yield from learn_map_with_progress(gathered, vehicle, options.seed)
    for pedal, selection in learned.selections.items():
        if not selection.is_complete:
            yield Event("warning", f"{pedal}: a training diverged; the best net before that is kept")
    data = build_report(learned, gathered, drives, vehicle, options.seed) | {"training_s": time.monotonic() - started}
    data |= {"replaced_mps2": _replaced_map_error(target, learned)}
    write_table(target, learned.table, json.dumps(data))
    figures = draw_figures(learned, gathered, target)
    steering_file = steering_target(target)
    steering = yield from learn_steering_of_logs(drives, vehicle, steering_file, steering_file.with_suffix(".png"))
    if not (target.name == MAP_FILE and (target.parent / "model.toml").is_file()):
        yield Event("note", f'to use it in a bench file: [controller] calibration = "{target}"')
    yield Event("result", "", result_of(data | _summarise_result(data, target, figures), steering))


def resolve_target(out: Path, vehicle: VehicleSpec) -> Path:
    """The file to write. Raises InputError for a model folder of another vehicle, or a file that is not .npz."""
    if out.suffix == ".npz":
        return out
    if out.is_file():
        raise InputError(
            "is a file", code="bad_out", file=str(out), key="--out", hint="a folder, or a name ending in .npz"
        )
    if (out / "model.toml").is_file():
        from tunefree_hil.config.load import load_model

        model = load_model(out)
        hint = "name a model folder of the same vehicle, or another folder"
        require_model_of_vehicle(model, vehicle, ErrorPlace(hint, "--out", str(out)))
    return out / MAP_FILE


def learn_map_with_progress(
    gathered: GatheredSamples, vehicle: VehicleSpec, seed: int
) -> Generator[Event, None, LearnedMap]:
    """Learn the map, with a progress event for each net."""
    began = time.monotonic()

    def event_of(step: MapProgress) -> Event:
        return Event("progress", step.message, count_data("net", step.done, step.total, began))

    return relay_events(learn_map(gathered.samples, vehicle, seed), event_of)


def build_report(
    learned: LearnedMap, gathered: GatheredSamples, drives: Sequence[Drive], vehicle: VehicleSpec, seed: int
) -> dict[str, Any]:
    """The data of the map and its errors, as plain data."""
    support = learned.grid.support
    return {
        "schema": SCHEMA,
        "vehicle": vehicle.name,
        "vehicle_hash": f"sha256:{vehicle.hash}",
        "logs": {drive.name: drive.log_hash for drive in drives},
        "seed": seed,
        "version": __version__,
        "samples": len(gathered.samples.speed_mps),
        "delay_s": {pedal: delay.seconds for pedal, delay in gathered.delays.items()},
        "delay_found": {pedal: delay.is_identified for pedal, delay in gathered.delays.items()},
        "pedals": {pedal: _build_pedal_report(learned, pedal) for pedal in PEDALS},
        "speed_mps": [float(learned.grid.speed_mps[0]), float(learned.grid.speed_mps[-1])],
        "accel_mps2": [float(learned.table.accel_mps2.min()), float(learned.table.accel_mps2.max())],
        "support": {
            word: float((support == value).mean())
            for word, value in (("data", SUPPORTED), ("gap", INTERPOLATED), ("beyond", EXTRAPOLATED))
        },
        "points": len(learned.table.speed_mps),
        "monotone": is_monotone(learned.table),
    }


def _build_pedal_report(learned: LearnedMap, pedal: str) -> dict[str, Any]:
    selection = learned.selections[pedal]
    return {
        "hidden_units": selection.width,
        "seeds": selection.net.width // selection.width,
        "held_out_mps2": selection.held_out_mps2,
        "by_width_mps2": {str(width): list(errors) for width, errors in selection.by_width.items()},
        "cells": len(set(selection.points.cell.tolist())),
        "samples": len(selection.points.cell),
    }


def _replaced_map_error(target: Path, learned: LearnedMap) -> float | None:
    """RMS error in m/s2, on the same cells, of the map that is replaced; None where there is none."""
    from tunefree_hil.control.calibration_map import load

    if not target.is_file():
        return None
    try:
        before = load(target)
    except InputError:
        return None  # an unreadable file is replaced, too
    errors = [
        compute_cell_errors(law_from_calibration(before, pedal), learned.selections[pedal].points) for pedal in PEDALS
    ]
    return compute_rms(np.concatenate(errors))


def draw_figures(learned: LearnedMap, gathered: GatheredSamples, target: Path) -> list[str]:
    """Draw the samples (Fig. 4a of the paper) and the map (Fig. 4b), beside the file."""
    from tunefree_hil.figures.learning.map import draw_map, draw_map_data
    from tunefree_hil.figures.style import save

    picture = make_picture(learned, gathered)
    stem = target.with_suffix("")
    data = save(draw_map_data(picture), stem.with_name(f"{stem.name}_data.png"))
    result = save(draw_map(picture), stem.with_name(f"{stem.name}_map.png"))
    return [str(data), str(result)]


def make_picture(learned: LearnedMap, gathered: GatheredSamples) -> MapPicture:
    """Arrays for the figures."""
    from tunefree_hil.figures.learning.map import MapPicture

    grid, samples = learned.grid, gathered.samples
    sign = samples.pedal
    command = samples.command_frac * (sign + (sign == 0.0))
    thin = slice(None, None, max(1, len(command) // 20_000))
    return MapPicture(
        samples.speed_mps[thin],
        command[thin],
        samples.accel_mps2[thin],
        grid.speed_mps,
        grid.command_frac,
        grid.accel_mps2,
        grid.support,
        grid.rest_frac,
    )


def _summarise_result(data: Mapping[str, Any], target: Path, figures: list[str]) -> dict[str, Any]:
    errors = ", ".join(
        f"{pedal} {entry['held_out_mps2']:.3f} m/s² with {entry['hidden_units']} hidden units"
        for pedal, entry in data["pedals"].items()
    )
    low, high = data["speed_mps"]
    sentence = f"map of {data['points']} points from {low:g} to {high:g} m/s in {target}; on held-out cells {errors}"
    if data["replaced_mps2"] is not None:
        sentence += f"; the map it replaces was {data['replaced_mps2']:.2f} m/s² off"
    return {"map": str(target), "figures": figures, "sentence": sentence}
