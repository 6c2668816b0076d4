"""Learns the open-loop map of a vehicle from logs: `calibration.npz`, and two pictures of it."""

from __future__ import annotations

import json
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tunefree_hil import __version__
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.base.open_loop_map import MAP_FILE
from tunefree_hil.jobs.learn.logs import read
from tunefree_hil.jobs.preconditions import require_model_of
from tunefree_hil.jobs.progress import left_s, told
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.open_loop_map.build import Gathered, LearnedMap, Step, gather, learn_map
from tunefree_hil.learn.open_loop_map.cells import cell_errors, rms
from tunefree_hil.learn.open_loop_map.samples import PEDALS
from tunefree_hil.learn.open_loop_map.table import BACKED, BEYOND, GAP, is_monotone, law_of, write_table

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec
    from tunefree_hil.figures.learning.map import MapPicture

SCHEMA = "tunefree.map/1"


def map_logs(logs: Sequence[Path], vehicle: str, out: Path, seed: int = 1) -> Iterator[Event]:
    """Read logs, train, write. out: a file ending in .npz, or a folder (a model's folder gets the map it drives by)."""
    from tunefree_hil.config.load import load_vehicle
    from tunefree_hil.learn.training.map_nets import require_torch

    require_torch()  # said before an hour of logs is read
    spec = load_vehicle(vehicle)
    target = target_of(out, spec)
    drives = yield from read(logs, spec)
    gathered = gather(drives, spec)
    for words in gathered.words:
        yield Event("note", words)
    for delay in gathered.delays.values():
        if not delay.found:
            yield Event("warning", delay.words)
    started = time.monotonic()
    learned = yield from learned_map(gathered, spec, seed)
    for pedal, choice in learned.choices.items():
        if not choice.whole:
            yield Event(
                "warning", f"{pedal}: a training came to numbers that are not finite; the best net before it is kept"
            )
    data = report(learned, gathered, drives, spec, seed) | {"training_s": time.monotonic() - started}
    data |= {"replaced_mps2": _replaced(target, learned)}
    write_table(target, learned.table, json.dumps(data))
    figures = draw(learned, gathered, target)
    if not (target.name == MAP_FILE and (target.parent / "model.toml").is_file()):
        yield Event("note", f'a bench drives by it with: [controller] calibration = "{target}"')
    yield Event("result", "", data | _ending(data, target, figures))


def target_of(out: Path, vehicle: VehicleSpec) -> Path:
    """The file to write. Raises InputError for a model folder of another vehicle, or a file that is no .npz."""
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
        require_model_of(model, vehicle, "--out", hint=hint, file=str(out))
    return out / MAP_FILE


def learned_map(gathered: Gathered, vehicle: VehicleSpec, seed: int) -> Generator[Event, None, LearnedMap]:
    """The map of what was gathered, its nets as progress."""
    began = time.monotonic()

    def event_of(step: Step) -> Event:
        eta_s = left_s(began, step.done / step.total)
        return Event("progress", step.words, {"label": "net", "done": step.done, "total": step.total, "eta_s": eta_s})

    return told(learn_map(gathered.samples, vehicle, seed), event_of)


def report(
    learned: LearnedMap, gathered: Gathered, drives: Sequence[Drive], vehicle: VehicleSpec, seed: int
) -> dict[str, Any]:
    """What the map is made of and how good it is, as plain data."""
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
        "delay_found": {pedal: delay.found for pedal, delay in gathered.delays.items()},
        "pedals": {pedal: _pedal_report(learned, pedal) for pedal in PEDALS},
        "speed_mps": [float(learned.grid.speed_mps[0]), float(learned.grid.speed_mps[-1])],
        "accel_mps2": [float(learned.table.accel_mps2.min()), float(learned.table.accel_mps2.max())],
        "support": {
            word: float((support == value).mean())
            for word, value in (("data", BACKED), ("gap", GAP), ("beyond", BEYOND))
        },
        "points": len(learned.table.speed_mps),
        "monotone": is_monotone(learned.table),
    }


def _pedal_report(learned: LearnedMap, pedal: str) -> dict[str, Any]:
    choice = learned.choices[pedal]
    return {
        "hidden_units": choice.width,
        "seeds": choice.net.width // choice.width,
        "held_out_mps2": choice.held_out_mps2,
        "by_width_mps2": {str(width): list(errors) for width, errors in choice.by_width.items()},
        "cells": len(set(choice.points.cell.tolist())),
        "samples": len(choice.points.cell),
    }


def _replaced(target: Path, learned: LearnedMap) -> float | None:
    """How far off the map that is replaced is on the same cells, RMS in m/s2; None where there is none."""
    from tunefree_hil.control.calibration_map import load

    if not target.is_file():
        return None
    try:
        before = load(target)
    except InputError:
        return None  # it is replaced whatever it was
    errors = [cell_errors(law_of(before, pedal), learned.choices[pedal].points) for pedal in PEDALS]
    return rms(_joined(errors))


def _joined(errors: Sequence[Any]) -> Any:
    import numpy as np

    return np.concatenate(errors)


def draw(learned: LearnedMap, gathered: Gathered, target: Path) -> list[str]:
    """The two figures, beside the file: what was collected (Fig. 4a), what came out (Fig. 4b)."""
    from tunefree_hil.figures.learning.map import write_map, write_map_data

    picture = picture_of(learned, gathered)
    stem = target.with_suffix("")
    data = write_map_data(stem.with_name(f"{stem.name}_data.png"), picture)
    result = write_map(stem.with_name(f"{stem.name}_map.png"), picture)
    return [str(data), str(result)]


def picture_of(learned: LearnedMap, gathered: Gathered) -> MapPicture:
    """Plain arrays for the figures."""
    from tunefree_hil.figures.learning.map import MapPicture

    grid, samples = learned.grid, gathered.samples
    sign = samples.pedal
    command = samples.command_frac * (sign + (sign == 0.0))
    kept = slice(None, None, max(1, len(command) // 20_000))
    return MapPicture(
        samples.speed_mps[kept],
        command[kept],
        samples.accel_mps2[kept],
        grid.speed_mps,
        grid.command_frac,
        grid.accel_mps2,
        grid.support,
        grid.rest_frac,
    )


def _ending(data: Mapping[str, Any], target: Path, figures: list[str]) -> dict[str, Any]:
    errors = ", ".join(
        f"{pedal} {one['held_out_mps2']:.3f} m/s² with {one['hidden_units']} hidden units"
        for pedal, one in data["pedals"].items()
    )
    low, high = data["speed_mps"]
    sentence = f"map of {data['points']} points from {low:g} to {high:g} m/s in {target}; on held-out cells {errors}"
    if data["replaced_mps2"] is not None:
        sentence += f"; the map it replaces was {data['replaced_mps2']:.2f} m/s² off"
    return {"map": str(target), "figures": figures, "sentence": sentence}
