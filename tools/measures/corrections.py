"""What each part of the improved controller is worth on the vehicle, with the gains held: alone, and together.

The parts: what the steering map gives, preview, prediction over the dead time, slow integral and observer, preview of
the pedals, hysteresis between them, robust MRAC. The gains are a manual set, and in a second row of drives those of
the winner of a search.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tools.measures._envelope import (
    Progress,
    VehicleDrives,
    changed_files,
    drive_sets,
    envelope_files,
    error_ratios,
    vehicle_units,
    with_controller,
    with_plain_controller,
    write_text,
)
from tools.measures._envelope_search import find_winner, search_units
from tools.measures._ledger import FIGURES, FOLDER, Ledger
from tools.measures._summary import machine, rounded, summary
from tools.measures.tune11 import StudyRequest, make_request
from tunefree_hil.bench import Bench, load, own_parameters, parameters_of
from tunefree_hil.config.schema import DATA_SHEET_STEERING
from tunefree_hil.control.build import PEDAL_PREVIEW, STEER_PREVIEW
from tunefree_hil.control.follower import PREVIEW_S
from tunefree_hil.control.parameters import BY_NAME
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors
from tunefree_hil.tune.baselines import FIRST_TRIAL, RULE_BASED

VALUE = "errors after the start, all corrections / plain controller, manual gains held, vehicle, worse vehicle"
NAME = "corrections"
PLAIN, ALONE, TOGETHER = "plain controller", "alone", "together"
LATERAL, LONGITUDINAL, INNER = {"lateral": "lqr_preview"}, {"longitudinal": "pid_preview"}, {"inner": "mrac_robust"}

MANUAL = (FIRST_TRIAL, RULE_BASED)  # the first that a vehicle has is held


class Correction(NamedTuple):
    """What is switched on. parts: keys of [controller]. own: the parts' own parameters that get their values."""

    name: str
    parts: Mapping[str, str]
    own: tuple[str, ...] = ()
    is_map: bool = False  # the identified steering map instead of the data sheet's axles


CORRECTIONS = (
    Correction("transient feedforward, data sheet", LATERAL),  # what the part has without any of its parameters
    Correction("steering map", LATERAL, is_map=True),
    Correction("preview", LATERAL, (STEER_PREVIEW,)),
    Correction("prediction over the dead time", LATERAL | LONGITUDINAL, ("steer.predict", "speed.predict")),
    Correction("slow integral, observer", LATERAL | LONGITUDINAL, ("steer.integral_1ps", "speed.observer_radps")),
    Correction("longitudinal preview", LONGITUDINAL, (PEDAL_PREVIEW,)),
    Correction("estimated speed and station", LONGITUDINAL, ("speed.filter_s",)),
    Correction("pedal hysteresis", LONGITUDINAL, ("pedals.hysteresis_mps2",)),
    Correction("robust MRAC", INNER, ("mrac.leak_1ps", "mrac.reach")),
)
# A parameter that is not switched on: 0, except that the plain form has this preview of the pedals already.
OFF = {PEDAL_PREVIEW: PREVIEW_S}


class Variant(NamedTuple):
    """A controller. kind: PLAIN, ALONE, or TOGETHER with all that stand before it; name: of the last correction."""

    kind: str
    name: str
    corrections: tuple[Correction, ...]


class GainSet(NamedTuple):
    """The eleven tuned numbers and the other parameters of the table; those of the parts come from the variant."""

    name: str
    values: Mapping[str, float]


class DrivenVariant(NamedTuple):
    """A variant with a gain set on a vehicle."""

    bench: str
    gains: str
    variant: Variant
    drives: VehicleDrives


def measure(
    roads: int = 20,
    road_seed: int = 0,
    winner_trials: int = 0,
    winner: int = 1,
    benches: str = "",
    folder: str = FOLDER,
    figures: str = FIGURES,
) -> dict[str, Any]:
    """winner: seed of the search of `tune11` whose gains are held too, with winner_trials as its `trials`; 0: none.

    The other options are those of `tune11`, and so are the roads. `<folder>/corrections/` gets corrections.csv. Goes
    on when called again.
    """
    before, request = machine(), make_request(winner, winner_trials, roads, road_seed, folder)
    loaded = [load(file) for file in envelope_files(benches)]
    progress = Progress(NAME, sum(work_units(bench, request) for bench in loaded))
    driven = [one for bench in loaded for one in measure_vehicle(bench, request, progress)]
    rows = list(table_rows(driven))
    all_on = {row["bench"]: row["error_ratio"] for row in rows if is_complete(row)}
    worse = max(all_on, key=lambda name: all_on[name])
    detail = {
        "machine": before,
        "changed_files": changed_files(),
        "road_seed": request.road_seed,
        "roads": roads,
        "worse_vehicle": worse,
        "table": rows,
        "file": write_text(request.folder / NAME / f"{NAME}.csv", table_text(rows)),
        "figure": _draw(rows, figures),
    }
    values = [all_on[worse]]
    return summary(values, "of the errors of the plain controller with the same gains", rounded(detail))


def is_complete(row: Mapping[str, Any]) -> bool:
    """Whether a row has every correction, with the manual gains."""
    return row["kind"] == TOGETHER and row["correction"] == CORRECTIONS[-1].name and row["gains"] in MANUAL


def work_units(bench: Bench, request: StudyRequest) -> float:
    """Work of one vehicle, in drives on a learned model."""
    searched = len(bench.spec.scenarios)
    each = vehicle_units(bench) / max(searched, 1) * request.roads * len(variants())
    if not request.seeds:
        return each
    return 2.0 * each + search_units(request.search(bench, request.seeds).plan(), searched)


def variants() -> list[Variant]:
    """The plain controller, each correction on top of it, and one after the other."""
    alone = [Variant(ALONE, one.name, (one,)) for one in CORRECTIONS]
    together = [Variant(TOGETHER, one.name, CORRECTIONS[: i + 1]) for i, one in enumerate(CORRECTIONS)]
    return [Variant(PLAIN, PLAIN, ()), *alone, *together]


def with_corrections(bench: Bench, corrections: Sequence[Correction]) -> Bench:
    """The bench with these corrections and no others on top of the plain controller."""
    keys: dict[str, Any] = {"steering_map": DATA_SHEET_STEERING}
    for one in corrections:
        keys |= one.parts
        if one.is_map:
            keys["steering_map"] = bench.spec.controller.steering_map
    return with_controller(with_plain_controller(bench), **keys)


def vector_of(bench: Bench, corrected: Bench, corrections: Sequence[Correction], gains: GainSet) -> dict[str, float]:
    """The complete vector: held gains, and the parts' own parameters as the bench has them, or off."""
    switched_on = {name for one in corrections for name in one.own}
    complete = parameters_of(bench)
    own = {name: complete[name] if name in switched_on else OFF.get(name, 0.0) for name in own_parameters(corrected)}
    return parameters_of(corrected, dict(gains.values) | own)


def gain_sets(bench: Bench, request: StudyRequest, progress: Progress) -> list[GainSet]:
    """The manual set that is held, and the winner's."""
    manual = compute_baseline_vectors(bench)
    name = next(name for name in MANUAL if name in manual)
    sets = {name: manual[name]}
    if request.seeds:
        winner = find_winner(request.search(bench, request.seeds), request.ledger(bench), progress)
        sets[f"winner of seed {request.seeds}"] = winner["values"]
    return [
        GainSet(name, {key: value for key, value in values.items() if key in BY_NAME}) for name, values in sets.items()
    ]


def measure_vehicle(bench: Bench, request: StudyRequest, progress: Progress) -> Iterator[DrivenVariant]:
    """Every variant with every gain set over the unseen roads."""
    ledger, unseen = Ledger(request.folder / NAME, Path(bench.file).stem), request.unseen(bench)
    sets = gain_sets(bench, request, progress)
    for variant in variants():
        corrected = with_corrections(unseen, variant.corrections)
        vectors = {gains.name: vector_of(bench, corrected, variant.corrections, gains) for gains in sets}
        for name, drives in drive_sets(corrected, vectors, ledger, progress).items():
            yield DrivenVariant(Path(bench.file).stem, name, variant, drives)


def table_rows(driven: Sequence[DrivenVariant]) -> Iterator[dict[str, Any]]:
    """A line for each variant, with its errors over those of the plain controller with the same gains."""
    plain = {(one.bench, one.gains): one.drives for one in driven if one.variant.kind == PLAIN}
    for one in driven:
        base, drives = plain[one.bench, one.gains], one.drives
        ratios = error_ratios(drives.errors, base.errors)
        yield {
            "bench": one.bench,
            "gains": one.gains,
            "kind": one.variant.kind,
            "correction": one.variant.name,
            **drives.errors._asdict(),
            "error_ratio": ratios.pop("geometric_mean"),
            **{f"{name}_ratio": ratio for name, ratio in ratios.items()},
            "score": drives.score,
            "oscillating_drives": drives.n_oscillating,
            "replans": drives.replans,
            "failed": len(drives.failed),
            "met": int(drives.judgement.is_met),
        }


def table_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """CSV of the rows."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: f"{x:.5g}" if isinstance(x, float) else x for key, x in row.items()} for row in rows)
    return text.getvalue()


def _draw(rows: Sequence[Mapping[str, Any]], figures: str) -> str:
    from tools.measures.figures.correction_table import CorrectionCells, draw_corrections
    from tunefree_hil.figures.style import save

    names = [one.name for one in CORRECTIONS]
    panels: dict[str, CorrectionCells] = {}
    for kind in (ALONE, TOGETHER):
        for row in (row for row in rows if row["kind"] == kind):
            title = f"{row['bench'].partition('_')[0]}, {row['gains']}, {kind}"
            cells = panels.setdefault(title, CorrectionCells([], []))
            cells.ratios.append([row["lateral_m_ratio"], row["station_m_ratio"], row["speed_mps_ratio"]])
            cells.oscillating.append(row["oscillating_drives"])
    return str(save(draw_corrections(panels, names), Path(figures) / f"{NAME}.png"))
