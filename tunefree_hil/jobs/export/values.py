"""The values of an export: a run's winner, a manual set or a bench file's own, and what they were driven with."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.open_loop_map import Triples, read_triples
from tunefree_hil.bench import Bench, calibration_path, load, parameters_of, part_names
from tunefree_hil.bench.controller import constants_of, settings_of
from tunefree_hil.bench.identified import identified_of
from tunefree_hil.control.build import PartNames
from tunefree_hil.control.calibration_map import REFUSAL, CalibrationMap, from_triples
from tunefree_hil.control.contract import LoopDelays, Settings, VehicleConstants
from tunefree_hil.grade.requirements.verdict import GainsVerdict
from tunefree_hil.jobs.run_folder import open_run
from tunefree_hil.jobs.tune.candidates import TUNED, compute_baseline_vectors, has_foreign_controller, read_winner
from tunefree_hil.jobs.tune.verdict.best_file import FILE, NOT_VERIFIED, read_best

OF_BENCH = "bench"  # name of the bench file's own values


class ExportValues(NamedTuple):
    """What a target module gets.

    source: run or bench file; set_name: which values of it; verdict: of a winner, else ''.
    wheel_radius_m: None where vehicle.toml has none.
    """

    source: str
    set_name: str
    verdict: str
    vehicle_name: str
    dt_s: float
    values: dict[str, float]
    parts: PartNames
    vehicle: VehicleConstants
    settings: Settings
    delays: LoopDelays
    triples: Triples
    calibration: CalibrationMap
    wheel_radius_m: float | None


class _Choice(NamedTuple):
    bench: Bench
    set_name: str
    values: dict[str, float]
    verdict: str


def collect_values(source: Path, set_name: str | None) -> ExportValues:
    """Collect the values of a run of `tune` or of a bench file.

    Args:
        source: Folder of the run, or the bench file.
        set_name: A manual set, or 'tuned'; None for the winner of a run, of a bench file for its own values.

    Raises:
        InputError: No such run or set, a winner that was REJECTED and is not asked for by name, or a controller that is
            not built in.
    """
    choice = _choose_of_bench(source, set_name) if source.is_file() else _choose_of_run(source, set_name)
    bench = choice.bench
    own_parts = [name for name in part_names(bench) if ":" in name]
    if bench.spec.controller.command or own_parts or has_foreign_controller(bench):
        raise InputError(
            "the bench has a controller of its own, whose parameters no target knows",
            code="foreign_controller",
            file=bench.file,
            key="controller",
            hint="export is for the built-in parts: lateral, longitudinal and inner without 'file.py:EXPORT'",
        )
    vehicle = constants_of(bench.vehicle)
    triples = read_triples(calibration_path(bench), REFUSAL)
    return ExportValues(
        source=str(source),
        set_name=choice.set_name,
        verdict=choice.verdict,
        vehicle_name=bench.vehicle.name,
        dt_s=bench.dt_s,
        values=choice.values,
        parts=part_names(bench),
        vehicle=vehicle,
        settings=settings_of(bench),
        delays=identified_of(bench, vehicle).delays,
        triples=triples,
        calibration=from_triples(*triples),
        wheel_radius_m=bench.vehicle.nominal.wheel_radius_m,
    )


def _choose_of_bench(file: Path, set_name: str | None) -> _Choice:
    bench = load(file)
    if set_name in (None, OF_BENCH):
        return _Choice(bench, OF_BENCH, parameters_of(bench), "")
    return _Choice(bench, str(set_name), _manual_set(bench, str(set_name), file, (OF_BENCH,)), "")


def _choose_of_run(folder: Path, set_name: str | None) -> _Choice:
    run = open_run(folder)
    if run.record.get("command") != "tune":
        raise InputError(
            f"is a run of {run.record.get('command')!r}, which has no winner",
            code="no_winner",
            file=str(folder),
            hint="give a run of tune, or a bench file",
        )
    bench = load(run.bench_file())
    if set_name not in (None, TUNED):
        return _Choice(bench, str(set_name), _manual_set(bench, str(set_name), folder, (TUNED,)), "")
    verdict = str(read_best(run).get("verdict", NOT_VERIFIED))
    if verdict == GainsVerdict.REJECTED.value and set_name is None:
        raise InputError(
            "the winner was REJECTED: it does not meet the requirements",
            code="rejected",
            file=str(folder / FILE),
            key="verdict",
            hint="--set NAME exports a manual set; --set tuned exports the rejected winner all the same",
        )
    return _Choice(bench, TUNED, read_winner(bench, run), verdict)


def _manual_set(bench: Bench, name: str, source: Path, others: tuple[str, ...]) -> dict[str, float]:
    vectors = compute_baseline_vectors(bench)
    if name not in vectors:
        raise InputError(
            f"has no set {name!r}",
            code="no_candidate",
            file=str(source),
            key="--set",
            hint=f"one of {', '.join([*others, *vectors])}",
        )
    return vectors[name]
