"""How good the learned open-loop map is: on cells it has not seen, and in the controller's hands."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace as with_values
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

import tunefree_hil.learn
from tools.measures._in_process import InProcess
from tools.measures._ledger import FIGURES, FOLDER, Ledger, meaning
from tools.measures._summary import RESAMPLES, machine, rounded
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, calibration_path, follower_of, load, parameters_of
from tunefree_hil.config.load import load_bench
from tunefree_hil.control import calibration_map
from tunefree_hil.episode.columns import columns_from_frames
from tunefree_hil.figures.learning.map import draw_map, draw_map_data
from tunefree_hil.figures.style import save
from tunefree_hil.jobs.learn.map import build_report, make_picture
from tunefree_hil.learn.compiled_process import exhaust
from tunefree_hil.learn.drives.read import read_drives
from tunefree_hil.learn.open_loop_map.build import (
    gather_samples,
    learn_map,
    make_map,
    select_points,
    train_nets,
)
from tunefree_hil.learn.open_loop_map.cells import (
    AccelerationLaw,
    CellEdges,
    CellPoints,
    average_cells,
    compute_cell_errors,
    compute_rms,
    make_cell_edges,
    split_holdout,
)
from tunefree_hil.learn.open_loop_map.samples import PEDALS
from tunefree_hil.learn.open_loop_map.table import MapTable, is_monotone, law_from_calibration, write_table
from tunefree_hil.learn.training import map_nets

VALUE = (
    "m/s2 RMSE of the learned map on held-out cells, throttle and brake together, mkz_bywire on its reference vehicle"
)
NAME = "map"
LEARNED, NETS, BINNED, NOMINAL = "learned map", "its nets", "binned averages", "nominal table"
SCENARIOS = "speed_changes,stop_and_go"
ERRORS = {"station_rms_m": "station_error_m", "speed_rms_mps": "speed_error_mps"}
SETTLED_S = 0.5  # of each drive, in which the start's errors are what they are


def measure(
    logs: str = "",
    bench: str = "bench_configs/mkz_complete.toml",
    scenarios: str = SCENARIOS,
    parts: int = 5,
    seed: int = 1,
    folder: str = FOLDER,
    figures: str = FIGURES,
) -> dict[str, Any]:
    """Cells of speed and command are held out in `parts` turns, each once; the error of a cell is that of its mean.

    Turns that an earlier call has done are not done again.

    logs: a folder of candump logs of the bench's vehicle, driven on its verify_model; '' those that the measure
    `collect` has left. detail: the same cells by binned averages (interpolated linearly from the cells that were not
    held out) and by the nominal table; whether the table of all cells is monotone; and station and speed errors of the
    scenarios on the verify_model with the nominal table and with the learned one, all other parameters equal.
    """
    before, loaded = machine(), load(bench)
    paths = logs_in(logs, folder, loaded.vehicle.name)
    gathered = gather_samples(read_drives(paths, loaded.codec), loaded.vehicle)
    nominal = calibration_map.load(calibration_path(loaded))
    ledger, depends = Ledger(Path(folder) / NAME), _standing(paths, loaded, seed)
    errors = held_out_errors(gathered.samples, loaded, nominal, parts, seed, ledger, depends)
    learned = exhaust(learn_map(gathered.samples, loaded.vehicle, seed))
    target = Path(folder) / NAME / "calibration.npz"
    card = build_report(learned, gathered, [], loaded.vehicle, seed)
    write_table(target, learned.table, json.dumps(card))
    picture = make_picture(learned, gathered)
    joined = {name: np.concatenate([own[pedal] for pedal in PEDALS]) for name, own in errors.items()}
    low, high = _interval(joined[LEARNED], seed)
    detail = {
        "machine": before,
        "logs": len(paths),
        "minutes_of_use": gathered.notes[0],
        "delay_s": {pedal: one.seconds for pedal, one in gathered.delays.items()},
        "rmse_mps2": {name: compute_rms(own) for name, own in joined.items()},
        "by_pedal_mps2": {pedal: {name: compute_rms(own[pedal]) for name, own in errors.items()} for pedal in PEDALS},
        "largest_mps2": {name: float(np.max(np.abs(own))) for name, own in joined.items()},
        "hidden_units": {pedal: choice.width for pedal, choice in learned.selections.items()},
        "monotone": is_monotone(learned.table),
        "support": card["support"],
        "tracking": tracking(loaded, target, scenarios.split(",")),
        "figures": [
            str(save(draw_map_data(picture), Path(figures) / "map_data.png")),
            str(save(draw_map(picture), Path(figures) / "map.png")),
        ],
    }
    value = compute_rms(joined[LEARNED])
    return {
        "value": value,
        "unit": "m/s2",
        "n": len(joined[LEARNED]),
        "low": low,
        "high": high,
        "detail": rounded(detail),
    }


def logs_in(logs: str, folder: str, vehicle: str = "mkz_bywire") -> list[Path]:
    """The logs of a folder, or of the newest collection of this vehicle. Raises InputError where there are none."""
    place = Path(logs) if logs else _newest_collection(Path(folder) / "collect", vehicle)
    found = sorted(path for path in place.rglob("*.log") if path.name != "bench.log")
    if not found:
        raise InputError(
            "there are no logs",
            code="no_log",
            file=str(place),
            hint="tools/measure collect makes them, or name a folder: --logs",
        )
    return found


def _newest_collection(place: Path, vehicle: str) -> Path:
    """logs/ of the run folder that was written last; `place` itself where there is none."""
    runs = [file.parent for file in place.glob("*/bench.toml") if Path(load_bench(file).vehicle).name == vehicle]
    whole = [run for run in runs if (run / "logs").is_dir()]
    return max(whole, key=lambda run: (run / "logs").stat().st_mtime) / "logs" if whole else place


def held_out_errors(
    samples: Any, bench: Bench, nominal: Any, parts: int, seed: int, ledger: Ledger, depends: Mapping[str, Any]
) -> dict[str, dict[str, np.ndarray]]:
    """What is compared -> pedal -> error of each cell (m/s2), by something that has not seen this cell."""
    edges = {pedal: make_cell_edges(bench.vehicle, pedal) for pedal in PEDALS}
    points = select_points(samples, edges, seed)
    turns = []
    for part in range(parts):
        key = {**depends, "what": "turn", "part": part, "parts": parts}
        known = ledger.find(key)
        turns.append(known or ledger.keep(key, _turn(points, edges, nominal, (parts, part), seed)))
    return {
        name: {pedal: np.concatenate([turn[name][pedal] for turn in turns]) for pedal in PEDALS}
        for name in (LEARNED, NETS, BINNED, NOMINAL)
    }


def _turn(
    points: Mapping[str, CellPoints], edges: Mapping[str, CellEdges], nominal: Any, turn: tuple[int, int], seed: int
) -> dict[str, dict[str, list[float]]]:
    """Errors of the cells of one part, by what was made of the others."""
    split = {pedal: split_holdout(own, *turn, np.random.default_rng([seed, 77])) for pedal, own in points.items()}
    seen = {pedal: one[0] for pedal, one in split.items()}
    choices = exhaust(train_nets(seen, seed))
    table = as_map(make_map(choices, edges).table)
    found: dict[str, dict[str, list[float]]] = {name: {} for name in (LEARNED, NETS, BINNED, NOMINAL)}
    for pedal in PEDALS:
        laws: dict[str, AccelerationLaw] = {
            LEARNED: law_from_calibration(table, pedal),
            NETS: choices[pedal].net.predict_acceleration,
            BINNED: binned(seen[pedal], edges[pedal]),
            NOMINAL: law_from_calibration(nominal, pedal),
        }
        for name, law in laws.items():
            found[name][pedal] = compute_cell_errors(law, split[pedal][1]).tolist()
    return found


def _standing(paths: Sequence[Path], bench: Bench, seed: int) -> dict[str, Any]:
    """What the errors depend on: logs, vehicle, nominal table, seed, code."""
    learn = Path(tunefree_hil.learn.__file__).parent
    code = "".join(meaning(path.read_text()) for path in (*sorted(learn.glob("map*.py")), Path(map_nets.__file__)))
    files = [*paths, calibration_path(bench)]
    hashes = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files]
    return {
        "files": hashes,
        "vehicle": bench.vehicle.hash,
        "seed": seed,
        "code": hashlib.sha256(code.encode()).hexdigest(),
    }


def as_map(table: MapTable) -> calibration_map.CalibrationMap:
    """The table as the controller has it."""
    return calibration_map.from_triples(*(column.tolist() for column in table[:3]))


def binned(points: CellPoints, edges: CellEdges) -> AccelerationLaw:
    """Means of the cells, linear between them in units of cells, the nearest one's outside."""
    means = average_cells(points)

    def places(speed: np.ndarray, command: np.ndarray) -> np.ndarray:
        rows = np.interp(speed, edges.speed_mps, np.arange(len(edges.speed_mps)))
        columns = np.interp(command, edges.command_frac, np.arange(len(edges.command_frac)))
        return np.stack([rows, columns], axis=1)

    at = places(means.speed_mps, means.command_frac)
    inside, outside = LinearNDInterpolator(at, means.accel_mps2), NearestNDInterpolator(at, means.accel_mps2)

    def law(speed: np.ndarray, command: np.ndarray) -> np.ndarray:
        told = inside(places(speed, command))
        return np.where(np.isnan(told), outside(places(speed, command)), told)

    return law


def tracking(bench: Bench, table: Path, scenarios: Sequence[str]) -> dict[str, dict[str, dict[str, float]]]:
    """Scenario -> which map -> RMS of the errors of ERRORS on the verify model, and how the drive ended."""
    model = bench.spec.verify_model or bench.spec.model
    found: dict[str, dict[str, dict[str, float]]] = {name: {} for name in scenarios}
    for label, one in ((NOMINAL, bench), (LEARNED, with_map(bench, table))):
        rig = InProcess(one, model)
        for name in scenarios:
            found[name][label] = _driven(rig, one, name)
    return found


def with_map(bench: Bench, table: Path) -> Bench:
    """The same bench, driving by another map."""
    controller = with_values(bench.spec.controller, calibration=str(table.resolve()))
    return replace(bench, spec=with_values(bench.spec, controller=controller))


def _driven(rig: InProcess, bench: Bench, name: str) -> dict[str, Any]:
    scenario, values = bench.scenarios[name], parameters_of(bench)
    drive = rig.drive(scenario, values)
    follower = follower_of(bench, scenario, values)
    columns: Mapping[str, np.ndarray] = columns_from_frames(
        drive.frames, bench.codec, follower, bench.dt_s, ticks=drive.ticks
    ).columns
    later = slice(round(SETTLED_S / bench.dt_s), None)
    errors: dict[str, Any] = {key: compute_rms(columns[column][later]) for key, column in ERRORS.items()}
    return errors | {"replans": int(np.nansum(columns["replan"])), "error": drive.error}


def _interval(errors: np.ndarray, seed: int) -> tuple[float, float]:
    """95 % of bootstrap resamples of the cells."""
    rng = np.random.default_rng(seed)
    drawn = [compute_rms(rng.choice(errors, len(errors))) for _ in itertools.repeat(None, RESAMPLES)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return float(low), float(high)
