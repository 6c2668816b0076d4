"""Writes model folders (docs/reference/files.md) whole or not at all: model.toml, .npz files, card.json.

A calibrated folder holds fitted physics. A learned folder takes actuators and effects from a calibrated one and adds
the trained arrays. card.json records the logs, the training and the free-run errors on held-out drives.
"""

from __future__ import annotations

import json
import math
import os
import platform
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from tunefree_hil import __version__
from tunefree_hil.base import parts
from tunefree_hil.base.contracts import Link, links_of
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.open_loop_map import MAP_FILE
from tunefree_hil.config.convert import SET_BY_LOADER
from tunefree_hil.config.dump import plain as plain_spec
from tunefree_hil.config.dump import to_toml
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import (
    ActuatorSpec,
    EffectSpec,
    Interval,
    ModelSpec,
    Number,
    ValidSpec,
    VehicleSpec,
    field_values,
)
from tunefree_hil.learn.compiled_process import CompiledProcess
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.estimate import ActuatorFit, Estimate, make_exact_estimate
from tunefree_hil.learn.evaluation.free_run import (
    EvaluationOptions,
    FreeRunErrors,
    error_reduction,
    evaluate_models,
    table_from_errors,
)
from tunefree_hil.learn.evaluation.motion import MotionTrack
from tunefree_hil.plant.learned.kinematics import DEFAULTS as KINEMATIC_PARAMS
from tunefree_hil.plant.learned.weights_file import save_plant

Array = np.ndarray
Arrays = Mapping[str, Any]

PLANT_FILE, CARD_FILE = "plant.npz", "card.json"
CARD_SCHEMA = "tunefree.card/1"
VERSIONED_LIBRARIES = ("numpy", "scipy", "torch")
CALIBRATION_LOGS = "the model's own logs"  # provenance of effects that were identified on the calibration logs
CALIBRATION_EFFECTS = "own_effects"  # key of card.json: effects on the calibration logs (gap/selection)
DEFAULT_TIMING = {"report_ticks": 1, "command_ticks": 1, "phase_seed": 1}
MODEL_TOML_HEADER = f"""\
# Written by tunefree_hil from logs of the vehicle; {CARD_FILE} says from which, with intervals and errors.
"""


class ModelContent(NamedTuple):
    """Content of a model folder.

    Attributes:
        kind: [plant] kind.
        actuators: By channel ('throttle', 'brake', 'steer', 'accel', 'steer_torque').
        params: [plant.params]; model.toml has the bare values, intervals stand in the card only.
        valid: (low, high) by key of [valid]; keys that the schema does not have are left out.
        noise: Standard deviation by record field.
        plant_arrays: Arrays of plant.npz (plant/learned/weights_file.py), None for kinds without one.
        calibration: Arrays of calibration.npz, None for none.
        effects: [[effects]] entries.
        timing: [timing], None for the defaults.
    """

    kind: str
    actuators: Mapping[str, ActuatorFit]
    params: Mapping[str, Estimate | float]
    valid: Mapping[str, tuple[float, float]]
    noise: Mapping[str, float]
    plant_arrays: Arrays | None = None
    calibration: Mapping[str, Array] | None = None
    effects: Sequence[Mapping[str, Any]] = ()
    timing: Mapping[str, int] | None = None


def require_new_folder(folder: Path) -> None:
    """Raise InputError where `folder` exists and is not empty."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError("it exists already", code="exists", file=str(folder), hint="choose another folder, or move it")


def write_model(folder: Path, vehicle: VehicleSpec, content: ModelContent, card: Mapping[str, Any]) -> Path:
    """Write a model folder under a temporary name, read it back, and rename it.

    Returns:
        The folder.

    Raises:
        InputError: The folder exists, or the arrays do not fit the kind.
    """
    folder = Path(folder)
    require_new_folder(folder)
    data = _model_toml(vehicle, content)
    with atomic_folder(folder) as part:
        (part / "model.toml").write_text(MODEL_TOML_HEADER + to_toml(data), encoding="utf-8")
        if content.plant_arrays is not None:
            save_plant(part / PLANT_FILE, content.kind, content.plant_arrays)
        if content.calibration is not None:
            arrays = {key: np.asarray(array) for key, array in content.calibration.items()}
            np.savez(part / MAP_FILE, **arrays)  # type: ignore[arg-type]
        write_card(part, card)
    return folder


def _model_toml(vehicle: VehicleSpec, content: ModelContent) -> dict[str, Any]:
    valid_keys = ValidSpec.__struct_fields__
    data = {
        "schema": "tunefree.model/1",
        "vehicle": vehicle.name,
        "vehicle_hash": f"sha256:{vehicle.hash}",
        "actuators": {name: _actuator_table(fit) for name, fit in content.actuators.items()},
        "plant": _plant_table(content.kind, content.params, content.plant_arrays is not None),
        "timing": dict(content.timing or DEFAULT_TIMING),
        "noise": {name: float(deviation) for name, deviation in content.noise.items()},
        "valid": {name: [float(low), float(high)] for name, (low, high) in content.valid.items() if name in valid_keys},
    }
    if content.effects:
        data["effects"] = [dict(effect) for effect in content.effects]
    return data


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """A temporary folder for a model; at the end it is loaded and renamed to `folder`, or removed on failure.

    Raises:
        InputError: The folder exists and is not empty, or the model cannot be loaded.
    """
    require_new_folder(folder)
    part = folder.with_name(f"part-{os.getpid()}-{folder.name}")
    part.mkdir(parents=True)
    try:
        yield part
        load_model(part)
        if folder.is_dir():
            folder.rmdir()  # it is empty
        os.replace(part, folder)
    finally:
        if part.is_dir():
            shutil.rmtree(part)


def model_toml_from_spec(model: ModelSpec) -> dict[str, Any]:
    """The content of a model's model.toml, without what the loader sets."""
    return {key: value for key, value in plain_spec(model).items() if key not in SET_BY_LOADER}


def write_model_copy(
    folder: Path, model: ModelSpec, header: str, data: dict[str, Any], card: Mapping[str, Any] | None = None
) -> None:
    """Write a copy of a model folder with another model.toml (`header`, then `data`), whole or not at all.

    Args:
        folder: New folder.
        model: The model to copy.
        header: Comment lines of the new model.toml.
        data: Content of the new model.toml.
        card: Replaces card.json; None: it is copied.

    Raises:
        InputError: As from `atomic_folder`.
    """
    excluded = {"model.toml"} | (set() if card is None else {CARD_FILE})
    with atomic_folder(folder) as part:
        for file in sorted(Path(model.folder).iterdir()):
            if file.is_file() and file.name not in excluded:
                shutil.copyfile(file, part / file.name)
        (part / "model.toml").write_text(header + to_toml(data), encoding="utf-8")
        if card is not None:
            write_card(part, card)


def write_effects(folder: Path, model: ModelSpec, effects: Sequence[EffectSpec]) -> None:
    """Replace the effects in the model.toml of a folder, atomically."""
    data = {**model_toml_from_spec(model), "effects": plain_spec(list(effects))}
    _replace_file(folder / "model.toml", MODEL_TOML_HEADER + to_toml(data))


def write_card(folder: Path, card: Mapping[str, Any]) -> None:
    """Write card.json of a model folder, atomically."""
    _replace_file(folder / CARD_FILE, json.dumps(plain_data(card), indent=1, allow_nan=False) + "\n")


def _replace_file(path: Path, text: str) -> None:
    part = path.with_name(f"part-{os.getpid()}-{path.name}")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)


def plain_data(value: Any) -> Any:
    """A value as JSON data: records as tables, arrays as lists, a number that is not finite as null."""
    if isinstance(value, Mapping):
        return {str(key): plain_data(item) for key, item in value.items()}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return plain_data(cast(Any, value)._asdict())
    if isinstance(value, list | tuple):
        return [plain_data(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain_data(value.tolist())
    if isinstance(value, np.generic):
        return plain_data(value.item())
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _actuator_table(fit: ActuatorFit) -> dict[str, Any]:
    table: dict[str, Any] = {"order": int(fit.order)}
    for name, estimate in fit.estimates().items():
        table[name] = {key: float(getattr(estimate, key)) for key in ("value", "low", "high")}
    return table


def _plant_table(kind: str, params: Mapping[str, Estimate | float], has_file: bool) -> dict[str, Any]:
    bare = {name: float(param.value if isinstance(param, Estimate) else param) for name, param in params.items()}
    table = {"kind": kind, "card": CARD_FILE, "params": bare}
    return {**table, "file": PLANT_FILE} if has_file else table


class LearnedModel(NamedTuple):
    """A learned plant and the calibrated physics that it builds on.

    Attributes:
        kind: [plant] kind.
        vehicle: Vehicle folder.
        physics: The calibrated model.
        plant_arrays: Of plant.npz, None for kinds without one.
        calibration: Of calibration.npz, which is the plant of kind rule_based.
        sample_spacing_s: Of kind paper.
    """

    kind: str
    vehicle: VehicleSpec
    physics: ModelSpec
    plant_arrays: Arrays | None = None
    calibration: Arrays | None = None
    sample_spacing_s: float = 0.01


def load_calibration(model: ModelSpec) -> dict[str, Any] | None:
    """The arrays of calibration.npz of a model folder, None where it has none."""
    path = Path(model.folder) / MAP_FILE
    if not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def fit_from_spec(spec: ActuatorSpec) -> ActuatorFit:
    """A channel of [actuators] as a fit, so that it can be written again."""
    values = field_values(spec)
    order = int(values.pop("order"))
    estimates: dict[str, Any] = {name: _estimate_from_number(number) for name, number in values.items()}
    return ActuatorFit(order=order, **estimates)


def _estimate_from_number(number: Number) -> Estimate:
    if isinstance(number, Interval):
        return Estimate(number.value, number.low, number.high)
    return make_exact_estimate(float(number))


def select_plant_params(kind: str, physics: ModelSpec, sample_spacing_s: float = 0.01) -> dict[str, float]:
    """[plant.params] of a kind: all constants for physics and hybrid, the geometry for the others."""
    if kind in ("physics", "hybrid"):
        return dict(physics.plant.params)
    geometry = {name: value for name, value in physics.plant.params.items() if name in KINEMATIC_PARAMS}
    return geometry | ({"sample_spacing_s": sample_spacing_s} if kind == "paper" else {})


def write_learned_model(folder: Path, learned: LearnedModel, card: Mapping[str, Any]) -> Path:
    """Write the folder of a learned plant.

    Actuators, noise, effects, timing and valid region are those of the physics. Latencies that were identified on the
    calibration logs are left out where a net was trained on the same logs: it has learned them.
    """
    kind, physics, plant_arrays = learned.kind, learned.physics, learned.plant_arrays
    valid = field_values(physics.valid)
    effects = [
        field_values(effect)
        for effect in physics.effects
        if plant_arrays is None
        or not (effect.provenance.get("by") == CALIBRATION_LOGS and _is_latency_effect(effect.name))
    ]
    content = ModelContent(
        kind=kind,
        actuators={name: fit_from_spec(spec) for name, spec in physics.actuators.items()} if kind != "paper" else {},
        params=select_plant_params(kind, physics, learned.sample_spacing_s),
        valid={name: (ends[0], ends[1]) for name, ends in valid.items() if ends},
        noise=physics.noise,
        plant_arrays=plant_arrays,
        calibration=learned.calibration,
        effects=effects,
        timing=field_values(physics.timing),
    )
    return write_model(folder, learned.vehicle, content, card)


def _is_latency_effect(name: str) -> bool:
    """Whether an effect changes, above all, the time between measured signals."""
    return links_of(parts.load("tunefree_hil.effects", name, "EFFECT"))[0] is Link.CLOCK


def evaluate_compiled(
    learned: LearnedModel, tracks: Sequence[MotionTrack], max_starts: int
) -> dict[str, FreeRunErrors]:
    """Free runs of the physics and of the learned plant from the same starts, with compiled kernels."""
    with tempfile.TemporaryDirectory() as place, CompiledProcess() as process:
        folder = write_learned_model(Path(place) / learned.kind, learned, {})
        models = {"physics": learned.physics, learned.kind: load_model(folder)}
        options = EvaluationOptions(max_starts=max_starts)
        return process.wait_for_result(evaluate_models, models, learned.vehicle, list(tracks), options)


class TrainingRecord(NamedTuple):
    """Course of a training. The field names are keys of card.json.

    Attributes:
        settings: The training plan.
        score_words: Meaning of the score.
        score: Held-out error of the best net.
        untrained: Held-out error before training.
        steps: Optimiser steps.
        seconds: Duration.
        looks: (step, held-out error) pairs.
        stopped: Why it stopped early, or ''.
    """

    settings: Mapping[str, Any]
    score_words: str
    score: float
    untrained: float
    steps: int
    seconds: float
    looks: Sequence[tuple[int, float]]
    stopped: str


class LearningRecord(NamedTuple):
    """Content of the card of a learned model.

    Attributes:
        kind: [plant] kind.
        vehicle: Vehicle folder.
        physics: The calibrated model.
        drives: All drives.
        split: How they were split.
        seed: Of split and training.
        seconds: Duration.
        training: None for kinds without one.
        evaluations: Free runs on held-out drives, by 'physics' and the kind; either may be missing. These drives also
            stop the training; a stricter test needs other drives (tools/measure freerun).
    """

    kind: str
    vehicle: VehicleSpec
    physics: ModelSpec
    drives: Sequence[Drive]
    split: str
    seed: int
    seconds: float
    training: TrainingRecord | None
    evaluations: Mapping[str, FreeRunErrors]


def make_card(record: LearningRecord) -> dict[str, Any]:
    """card.json of a learned model, as plain data."""
    logs = [
        {"name": drive.name, "hash": drive.log_hash, "seconds": drive.n_rows * drive.dt_s} for drive in record.drives
    ]
    return {
        "schema": CARD_SCHEMA,
        "kind": record.kind,
        "vehicle": record.vehicle.name,
        "vehicle_hash": f"sha256:{record.vehicle.hash}",
        "physics_hash": f"sha256:{record.physics.hash}",
        "logs": logs,
        "seed": record.seed,
        "split": record.split,
        "versions": list_versions(),
        "seconds": round(record.seconds, 1),
        "training": record.training._asdict() if record.training else None,
        "free_run": {name: table_from_errors(errors) for name, errors in record.evaluations.items()},
        "reduction_percent": _error_reductions(record.evaluations, record.kind),
    }


def list_versions() -> dict[str, str]:
    """Versions of the program, Python and the libraries, as far as installed."""
    versions = {"tunefree_hil": __version__, "python": platform.python_version()}
    for name in VERSIONED_LIBRARIES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions


def _error_reductions(evaluations: Mapping[str, FreeRunErrors], kind: str) -> dict[str, Any]:
    """By horizon: reduction of the position error on level ground against the physics."""
    if not {"physics", kind} <= set(evaluations) or kind == "physics":
        return {}
    errors, reference = evaluations[kind], evaluations["physics"]
    return {
        f"{seconds:g}": error_reduction(errors, reference, seconds)
        for column, seconds in enumerate(errors.horizons_s)
        if _is_comparable(errors, reference, column)
    }


def _is_comparable(errors: FreeRunErrors, reference: FreeRunErrors, column: int) -> bool:
    both = errors.position_m[:, column] + reference.position_m[:, column]
    return bool((np.isfinite(both) & ~errors.is_on_hill).any())
