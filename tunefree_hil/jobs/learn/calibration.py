"""The calibration of `calibrate` and `learn`: fits by-wire channels, then constants, and writes a model folder."""

from __future__ import annotations

import json
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.learn.report_text import describe_channel, describe_constants
from tunefree_hil.jobs.progress import count_data, relay_events
from tunefree_hil.jobs.run_folder import library_versions
from tunefree_hil.learn.actuators import identify
from tunefree_hil.learn.actuators.identify import collect_channel, model_channels, restrict_to_motion
from tunefree_hil.learn.actuators.samples import ECHOES, ChannelSamples, has_channel
from tunefree_hil.learn.actuators.samples_from_motion import MotionLaw, suggest_plant_constants
from tunefree_hil.learn.compiled_process import CompiledProcess
from tunefree_hil.learn.data_sheet import (
    is_accel_commanded,
    make_constant_priors,
    make_fixed_params,
    read_channel_sheet,
)
from tunefree_hil.learn.drives.drive import Drive, DrivePart, DriveSplit
from tunefree_hil.learn.drives.road_slope import describe_accel_offsets
from tunefree_hil.learn.drives.smoothing import estimate_noise_table, estimate_valid_region
from tunefree_hil.learn.drives.split import split_drives
from tunefree_hil.learn.drives.validity import drop_incomplete_drives
from tunefree_hil.learn.estimate import ActuatorFit, Estimate, data_from_estimates
from tunefree_hil.learn.evaluation import plot_data
from tunefree_hil.learn.evaluation.plot_data import ConstantComparison
from tunefree_hil.learn.model_folder import CARD_FILE, ModelContent, write_model
from tunefree_hil.learn.physics.fit import PhysicsFit, fit_physics, is_significant
from tunefree_hil.learn.physics.unknowns import FITTED_EFFECTS
from tunefree_hil.learn.physics.windows import OutputCorrection, WindowSet, extract_windows

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

CARD_SCHEMA = "tunefree.card/1"
CARD_KEYS = {"kind", "logs", "vehicle_hash", "seed", "actuators", "constants", "windows", "free_run_rms"}  # of a card
# A channel that stops short of its command is identified up to its stop (learn/actuators/samples.py).
SHORT_STEERING = ("short_of_command",)
LIBRARIES = ("numpy", "scipy", "numba")  # whose versions the card records
WINDOWS_S, MIN_WINDOWS = (8.0, 5.0, 3.0), 12  # lengths of free runs, the longest with enough windows is taken


class CalibrationFit(NamedTuple):
    """Result of a calibration. traces: by channel, for the figure. seconds: duration of the fit."""

    actuators: dict[str, ActuatorFit]
    traces: dict[str, list[Any]]
    physics: PhysicsFit
    evaluation: ConstantComparison | None
    seconds: float


def split_drives_for_fit(
    drives: Sequence[Drive], vehicle: VehicleSpec, seed: int
) -> Generator[Event, None, DriveSplit]:
    """Split drives into training and held-out parts; where they are too short, everything is training.

    A drive without a channel that other drives have is left out, as it would count as a channel at rest. Warns of
    drives whose measured acceleration has an offset.
    """
    complete, omissions = drop_incomplete_drives(drives)
    yield from (Event("warning", text) for text in omissions)
    try:
        split = split_drives(complete, seed=seed)
    except InputError as error:
        if error.code != "too_short":
            raise
        parts = tuple(DrivePart(drive, 0, drive.n_rows) for drive in complete)
        split = DriveSplit(parts, (), "nothing held out: the logs are too short; errors are those of the fit itself")
        yield Event("warning", split.description)
    yield Event("note", split.description)
    yield from (Event("warning", text) for text in describe_accel_offsets(drives, vehicle))
    return split


def fit_calibration(
    worker: CompiledProcess, split: DriveSplit, vehicle: VehicleSpec
) -> Generator[Event, None, CalibrationFit]:
    """Fit all channels, then the physical constants, in another process."""
    began = time.monotonic()
    actuators: dict[str, ActuatorFit] = {}
    traces: dict[str, list[Any]] = {}
    laws: dict[str, MotionLaw] = {}
    for channel in model_channels(vehicle):
        training, held_out, law = collect_channel(split, channel, vehicle)
        laws |= {} if law is None else {channel: law}
        sheet = read_channel_sheet(vehicle, channel)
        has_echo = any(part.drive.get(f"report.{ECHOES[channel]}") is not None for part in split.training)
        steps = worker.call(identify.fit, training, held_out, sheet, has_echo)
        fit = yield from _report_progress(steps, f"actuator {channel}")
        fit = restrict_to_motion(fit, sheet) if law is not None else fit
        actuators[channel] = fit
        traces[channel] = _compute_traces(worker, held_out if held_out.segments else training, fit, sheet.rest)
        yield from _report_channel(channel, fit, has_channel([part.drive for part in split.training], channel))
    if not laws:
        _require_identified(actuators, split.training)
    windows, held_out_windows = choose_windows(split, vehicle, actuators)
    suggested = suggest_plant_constants(laws, make_fixed_params(vehicle)["mass_kg"])
    priors, fixed = make_constant_priors(vehicle, suggested), make_fixed_params(vehicle, suggested)
    brake_range = max(vehicle.limits.brake_frac - vehicle.nominal.rest_pedal_frac, 0.05)
    steps = worker.call(fit_physics, windows, fixed, priors, brake_range)
    physics = yield from _report_progress(steps, "physical constants")
    yield from (Event("note", text) for text in (*physics.notes, *describe_constants(physics)))
    yield from _list_unidentified(physics.estimates)
    before = fixed | {name: prior.value for name, prior in priors.items()}
    evaluation = _evaluate_fit(worker, held_out_windows, physics, before)
    return CalibrationFit(actuators, traces, physics, evaluation, time.monotonic() - began)


def _list_unidentified(values: Mapping[str, Estimate]) -> Iterator[Event]:
    """Report the constants that these logs do not identify, and why; those that the model does not need in one line."""
    unknown = {name: value for name, value in values.items() if not value.known}
    if unneeded := [name for name, value in unknown.items() if not value.is_needed]:
        yield Event("note", f"not needed to reproduce these logs: {', '.join(unneeded)}")
    for name, value in unknown.items():
        if value.is_needed and name not in FITTED_EFFECTS:
            yield Event("warning", f"{name}: {value.why}")


def choose_windows(
    split: DriveSplit, vehicle: VehicleSpec, channels: dict[str, ActuatorFit]
) -> tuple[WindowSet, WindowSet]:
    """Cut windows out of the training and the held-out parts: long ones where there are enough, else shorter ones."""
    for window_s in WINDOWS_S:
        windows = extract_windows(split.training, vehicle, window_s, channels)
        if len(windows.windows) >= MIN_WINDOWS:
            break
    return windows, extract_windows(split.held_out, vehicle, window_s, channels)


def _report_progress(steps: Generator[tuple[float, float], None, Any], label: str) -> Generator[Event, None, Any]:
    """The steps of a fit as progress events. Returns: what the fit returns."""
    began = time.monotonic()

    def event_of(step: tuple[float, float]) -> Event:
        return Event("progress", "", count_data(label, *step, began))

    return relay_events(steps, event_of)


def _compute_traces(worker: CompiledProcess, samples: ChannelSamples, fit: ActuatorFit, rest: float) -> list[Any]:
    return worker.wait_for_result(plot_data.make_traces, samples, fit.params(rest)) if samples.segments else []


def _report_channel(channel: str, fit: ActuatorFit, is_commanded: bool) -> Iterator[Event]:
    """One line with the result, and a warning for every parameter that is not identified."""
    yield Event("note", f"{channel}: {describe_channel(fit)}")
    if not is_commanded:
        yield Event("warning", f"{channel}: no log holds its commands; {fit.report}")
        return
    for name, value in fit.estimates().items():
        if not value.known:
            yield Event("warning", f"{channel} {name}: {value.why}")


def _require_identified(actuators: dict[str, ActuatorFit], training: Sequence[Any]) -> None:
    """Raise InputError where no channel was identified: these are not logs of a by-wire vehicle that was driven."""
    if any(fit.dead_time_s.known for fit in actuators.values()):
        return
    reasons = "; ".join(f"{channel}: {fit.report}" for channel, fit in actuators.items())
    raise InputError(
        f"no by-wire channel can be identified: {reasons}",
        code="no_excitation",
        file=training[0].drive.name if training else "",
        key="LOG",
        hint="drive with changing pedals and steering while the by-wire channels are on: `tunefree-hil collect` does",
    )


def _evaluate_fit(
    worker: CompiledProcess, held_out: WindowSet, physics: PhysicsFit, before: dict[str, float]
) -> ConstantComparison | None:
    if not held_out.windows:
        return None
    after = physics.params, physics.output_correction()
    return worker.wait_for_result(plot_data.compare_constants, held_out.windows, (before, OutputCorrection()), after)


def calibrate_into(
    out: Path, vehicle: VehicleSpec, drives: Sequence[Drive], split: DriveSplit, seed: int
) -> Generator[Event, None, CalibrationFit]:
    """Fit the drives and write the model folder; seed: of the split."""
    with CompiledProcess() as worker:
        fitted = yield from fit_calibration(worker, split, vehicle)
    write_calibrated_model(out, vehicle, fitted, split, build_card(drives, split, vehicle, fitted, seed))
    return fitted


def build_card(
    drives: Sequence[Drive], split: DriveSplit, vehicle: VehicleSpec, fitted: CalibrationFit, seed: int
) -> dict[str, Any]:
    """Content of card.json: the data of the model and its errors."""
    evaluation = fitted.evaluation
    return {
        "schema": CARD_SCHEMA,
        "kind": "physics",
        "vehicle": vehicle.name,
        "vehicle_hash": f"sha256:{vehicle.hash}",
        "logs": [
            {"name": drive.name, "hash": drive.log_hash, "seconds": drive.n_rows * drive.dt_s} for drive in drives
        ],
        "seed": seed,
        "split": split.description,
        "versions": library_versions(LIBRARIES),
        "seconds": round(fitted.seconds, 1),
        "actuators": {name: _channel_fields(fit) for name, fit in fitted.actuators.items()},
        "constants": data_from_estimates(fitted.physics.estimates),
        "constants_together": fitted.physics.correlation,
        "left_out": list(fitted.physics.notes),
        "windows": {
            "training": fitted.physics.n_windows,
            "held_out": evaluation.n_windows if evaluation else 0,
            "seconds": float(evaluation.time_s[-1]) if evaluation else None,
        },
        "free_run_rms": {
            "training": {"data_sheet": fitted.physics.rms_before, "fitted": fitted.physics.rms_after},
            "held_out": {"data_sheet": evaluation.before, "fitted": evaluation.after} if evaluation else None,
        },
    }


def has_same_logs(card: Mapping[str, Any], drives: Sequence[Drive]) -> bool:
    """Whether a card is of these logs, in this order."""
    return [log["hash"] for log in card.get("logs", [])] == [drive.log_hash for drive in drives]


def read_calibration_card(folder: Path) -> dict[str, Any]:
    """The card of a model made by `calibrate`; empty for any other folder."""
    path = folder / CARD_FILE
    try:
        card = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    except ValueError:
        return {}
    is_own = isinstance(card, dict) and card.keys() >= CARD_KEYS and "repair" not in card
    return card if is_own and card["kind"] == "physics" else {}


def _channel_fields(fit: ActuatorFit) -> dict[str, Any]:
    more = {"order": fit.order, "held_out_rms": fit.error, "reports": fit.rows, "words": fit.report}
    return {**data_from_estimates(fit.estimates()), **more, "noise": fit.noise, "quantum": fit.quantum}


def write_calibrated_model(
    out: Path, vehicle: VehicleSpec, fitted: CalibrationFit, split: DriveSplit, card: dict[str, Any]
) -> None:
    """Write the model folder, with the map that a controller uses."""
    rest = vehicle.nominal.rest_pedal_frac
    params = fitted.physics.params
    content = ModelContent(
        kind="physics",
        actuators=fitted.actuators,
        params=params,
        valid=estimate_valid_region(split.training, rest),
        noise=estimate_noise_table(split.training),
        calibration=make_map_arrays(vehicle, fitted),
        effects=[
            effect_entry(name, value)
            for name, value in fitted.physics.estimates.items()
            if name in FITTED_EFFECTS and is_significant(name, value)
        ],
    )
    write_model(out, vehicle, content, card)


def make_map_arrays(vehicle: VehicleSpec, fitted: CalibrationFit) -> dict[str, Any] | None:
    """The arrays of calibration.npz; None for a vehicle that is commanded an acceleration, which has no map."""
    from tunefree_hil.learn.open_loop_map.build import arrays_from_triples, sample_plant_map
    from tunefree_hil.plant.single_track import PLANT

    if is_accel_commanded(vehicle):
        return None
    rest = vehicle.nominal.rest_pedal_frac
    pedals = {name: fitted.actuators[name].params(rest) for name in ("throttle", "brake")}
    brake = pedals["brake"]
    # Dead band before the reported output plus the one behind it.
    dead_band = brake.dead_band + fitted.physics.output_correction().brake_frac / max(brake.gain, 0.1)
    pedals["brake"] = brake._replace(dead_band=dead_band)
    return arrays_from_triples(sample_plant_map(PLANT, fitted.physics.params, vehicle, pedals))


def effect_entry(name: str, value: Estimate) -> dict[str, Any]:
    """The entry of [[effects]] for a fitted difference between a reported output and the vehicle."""
    effect, parameter, _ = FITTED_EFFECTS[name]
    return {"name": effect, "params": {parameter: value.value}, "interval": {parameter: [value.low, value.high]}}
