"""Writes a model folder (interfaces 3) whole or not at all: model.toml, its .npz files, card.json.

A model folder of a learned kind, out of the calibrated physics' folder and what was trained.

card.json of a learned plant: what it was made of, how, and how good it is where it has not learned.
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
from typing import TYPE_CHECKING, Any, NamedTuple, cast

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
from tunefree_hil.config.schema import ActuatorSpec, EffectSpec, Interval, ModelSpec, Number, ValidSpec, VehicleSpec
from tunefree_hil.learn.compiled_process import Worker
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.estimate import ActuatorFit, Value, exactly
from tunefree_hil.learn.evaluation.free_run import Judged, reduction, table_of
from tunefree_hil.learn.evaluation.motion import Track
from tunefree_hil.plant.learned.kinematics import DEFAULTS as CARRIAGE
from tunefree_hil.plant.learned.weights_file import save_plant

Array = np.ndarray

PLANT_FILE, CARD_FILE = "plant.npz", "card.json"
OWN_LOGS = "the model's own logs"  # provenance of effects that these told
OWN_EFFECTS = (
    "own_effects"  # of card.json: what explains a model's own logs beside it (gap/selection/baseline_misfit.py)
)
TIMING = {"report_ticks": 1, "command_ticks": 1, "phase_seed": 1}
HEAD = """\
# Written by tunefree_hil from logs of the vehicle; {card} says from which, with intervals and errors.
"""


def require_new(folder: Path) -> None:
    """Raises InputError where `folder` is there already and not empty."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(
            "it is there already", code="exists", file=str(folder), hint="choose another folder, or move it"
        )


def write_model(
    folder: Path,
    vehicle: VehicleSpec,
    *,
    kind: str,
    actuators: Mapping[str, ActuatorFit],
    params: Mapping[str, Value | float],
    plant_arrays: Mapping[str, Any] | None = None,
    valid: Mapping[str, tuple[float, float]],
    noise: Mapping[str, float],
    card: Mapping[str, Any],
    calibration: Mapping[str, Array] | None = None,
    effects: Sequence[Mapping[str, Any]] = (),
    timing: Mapping[str, int] | None = None,
) -> Path:
    """Write `folder` under a temporary name, read it back, rename it; the folder's path.

    actuators: by channel ('throttle', 'brake', 'steer', 'accel', 'steer_torque'). params: [plant.params]; intervals of
    Values stand in the card only, as the schema has bare numbers there. plant_arrays, calibration: arrays of plant.npz
    (plant/learned/weights_file.py) and calibration.npz, None for none. valid: [low, high] by key of [valid]; keys that the
    schema does not have are left out. noise: standard deviation by record field. card: plain data of card.json.
    effects: [[effects]] entries.
    Raises InputError for a folder that is there already, and for arrays that make no plant of this kind.
    """
    folder = Path(folder)
    require_new(folder)  # before anything is worked out
    data = {
        "schema": "tunefree.model/1",
        "vehicle": vehicle.name,
        "vehicle_hash": f"sha256:{vehicle.hash}",
        "actuators": {name: _actuator(fit) for name, fit in actuators.items()},
        "plant": _plant(kind, params, plant_arrays is not None),
        "timing": dict(timing or TIMING),
        "noise": {name: float(deviation) for name, deviation in noise.items()},
        "valid": {name: [float(low), float(high)] for name, (low, high) in valid.items() if name in _valid_names()},
    }
    if effects:
        data["effects"] = [dict(effect) for effect in effects]
    with whole_folder(folder) as part:
        (part / "model.toml").write_text(HEAD.format(card=CARD_FILE) + to_toml(data), encoding="utf-8")
        if plant_arrays is not None:
            save_plant(part / PLANT_FILE, kind, plant_arrays)
        if calibration is not None:
            np.savez(part / MAP_FILE, **{key: np.asarray(one) for key, one in calibration.items()})  # type: ignore[arg-type]
        write_card(part, card)
    return folder


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A place to write a model folder in: read back and renamed to `folder` at the end, gone where that fails.

    Raises InputError for a folder that is there already, and for one that cannot be loaded.
    """
    require_new(folder)
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


def data_of(model: ModelSpec) -> dict[str, Any]:
    """A model as its model.toml says it: without what the loader sets."""
    return {key: one for key, one in plain_spec(model).items() if key not in SET_BY_LOADER}


def write_beside(
    folder: Path, model: ModelSpec, head: str, data: dict[str, Any], card: Mapping[str, Any] | None = None
) -> None:
    """Write `folder` whole or not at all: another model.toml (head, then `data`) beside all else that the model's own
    holds; card: in place of its own. Raises InputError as `whole_folder` does.
    """
    left = {"model.toml"} | (set() if card is None else {CARD_FILE})
    with whole_folder(folder) as part:
        for file in sorted(Path(model.folder).iterdir()):
            if file.is_file() and file.name not in left:
                shutil.copyfile(file, part / file.name)
        (part / "model.toml").write_text(head + to_toml(data), encoding="utf-8")
        if card is not None:
            write_card(part, card)


def write_effects(folder: Path, model: ModelSpec, effects: Sequence[EffectSpec]) -> None:
    """model.toml in that model's folder with these effects; whole or as it was."""
    data = {**data_of(model), "effects": plain_spec(list(effects))}
    _replaced(folder / "model.toml", HEAD.format(card=CARD_FILE) + to_toml(data))


def write_card(folder: Path, card: Mapping[str, Any]) -> None:
    """card.json of a model folder, whole or as it was."""
    _replaced(folder / CARD_FILE, json.dumps(plain(card), indent=1, allow_nan=False) + "\n")


def _replaced(path: Path, text: str) -> None:
    part = path.with_name(f"part-{os.getpid()}-{path.name}")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)


def plain(value: Any) -> Any:
    """Only what JSON knows: records as tables, arrays as lists; a number that is not finite as null."""
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return plain(cast(Any, value)._asdict())
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _actuator(fit: ActuatorFit) -> dict[str, Any]:
    table: dict[str, Any] = {"order": int(fit.order)}
    for name, one in fit.numbers().items():
        table[name] = {key: float(getattr(one, key)) for key in ("value", "low", "high")}
    return table


def _plant(kind: str, params: Mapping[str, Value | float], with_file: bool) -> dict[str, Any]:
    bare = {name: float(one.value if isinstance(one, Value) else one) for name, one in params.items()}
    table = {"kind": kind, "card": CARD_FILE, "params": bare}
    return {**table, "file": PLANT_FILE} if with_file else table


def _valid_names() -> tuple[str, ...]:
    return ValidSpec.__struct_fields__


Arrays = Mapping[str, Any]


class Learned(NamedTuple):
    """What was learned of a vehicle, and the calibrated physics beside it.

    arrays: of plant.npz, None for kinds without one; calibration: of calibration.npz, which is the file of rule_based.
    sample_spacing_s: of kind paper.
    """

    kind: str
    vehicle: VehicleSpec
    physics: ModelSpec
    arrays: Arrays | None = None
    calibration: Arrays | None = None
    sample_spacing_s: float = 0.01


def calibration_of(model: ModelSpec) -> dict[str, Any] | None:
    """The arrays of the calibration.npz of a model folder, None where it has none."""
    path = Path(model.folder) / MAP_FILE
    if not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def fit_of(spec: ActuatorSpec) -> ActuatorFit:
    """A channel of [actuators] as a fit, so that it can be written again."""
    values: dict[str, Any] = {name: _value(getattr(spec, name)) for name in spec.__struct_fields__ if name != "order"}
    return ActuatorFit(order=int(spec.order), **values)


def _value(number: Number) -> Value:
    return Value(number.value, number.low, number.high) if isinstance(number, Interval) else exactly(float(number))


def params_of(kind: str, physics: ModelSpec, sample_spacing_s: float = 0.01) -> dict[str, float]:
    """[plant.params] of a kind: all constants for hybrid, the geometry for the others."""
    if kind in ("physics", "hybrid"):
        return dict(physics.plant.params)
    own = {name: value for name, value in physics.plant.params.items() if name in CARRIAGE}
    return own | ({"sample_spacing_s": sample_spacing_s} if kind == "paper" else {})


def write_learned(folder: Path, learned: Learned, card: Mapping[str, Any]) -> Path:
    """Write the folder: actuators, noise, effects, timing and valid region are those of the physics' folder. A latency
    that its own logs told is not: a net that was taught by them has it in it.
    """
    kind, physics, arrays = learned.kind, learned.physics, learned.arrays
    valid = {name: getattr(physics.valid, name) for name in physics.valid.__struct_fields__}
    effects = [
        {"name": one.name, "params": one.params, "interval": one.interval, "provenance": one.provenance}
        for one in physics.effects
        if arrays is None or not (one.provenance.get("by") == OWN_LOGS and _is_latency(one.name))
    ]
    return write_model(
        folder,
        learned.vehicle,
        kind=kind,
        actuators={name: fit_of(spec) for name, spec in physics.actuators.items()} if kind != "paper" else {},
        params=params_of(kind, physics, learned.sample_spacing_s),
        plant_arrays=arrays,
        valid={name: (ends[0], ends[1]) for name, ends in valid.items() if ends},
        noise=physics.noise,
        card=card,
        calibration=learned.calibration,
        effects=effects,
        timing={name: getattr(physics.timing, name) for name in physics.timing.__struct_fields__},
    )


def _is_latency(name: str) -> bool:
    """Whether what an effect breaks above all is the clock between what is measured."""
    return links_of(parts.load("tunefree_hil.effects", name, "EFFECT"))[0] is Link.CLOCK


def judged_by_kernels(learned: Learned, tracks: Sequence[Track], most: int) -> dict[str, Judged]:
    """Free run of the physics and of what was learned on the same starts (at most `most`), by compiled kernels."""
    with tempfile.TemporaryDirectory() as place, Worker() as worker:
        folder = write_learned(Path(place) / learned.kind, learned, {})
        models = {"physics": learned.physics, learned.kind: load_model(folder)}
        given = (models, learned.vehicle, list(tracks), {"most": most})
        return worker.result("tunefree_hil.learn.evaluation.free_run", "judge_all", *given)


if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec, VehicleSpec

SCHEMA = "tunefree.card/1"
LIBRARIES = ("numpy", "scipy", "torch")


class Training(NamedTuple):
    """How a training went; settings: what decided it. looks: (step, held-out error) pairs."""

    settings: Mapping[str, Any]
    score_words: str
    score: float
    untrained: float
    steps: int
    seconds: float
    looks: Sequence[tuple[int, float]]
    stopped: str


def card_of(
    kind: str,
    vehicle: VehicleSpec,
    physics: ModelSpec,
    drives: Sequence[Drive],
    split: str,
    seed: int,
    seconds: float,
    training: Training | None,
    judged: Mapping[str, Judged],
) -> dict[str, Any]:
    """Plain data. judged: free run on held-out stretches of 'physics' and of this kind (either may lack).

    The held-out drives have also chosen when to stop; drives that nobody has seen judge harder (tools/measure freerun).
    """
    return {
        "schema": SCHEMA,
        "kind": kind,
        "vehicle": vehicle.name,
        "vehicle_hash": f"sha256:{vehicle.hash}",
        "physics_hash": f"sha256:{physics.hash}",
        "logs": [{"name": one.name, "hash": one.log_hash, "seconds": one.ticks * one.dt_s} for one in drives],
        "seed": seed,
        "split": split,
        "versions": versions(),
        "seconds": round(seconds, 1),
        "training": training._asdict() if training else None,
        "free_run": {name: table_of(one) for name, one in judged.items()},
        "reduction_percent": _reductions(judged, kind),
    }


def versions() -> dict[str, str]:
    """Of what made the numbers; torch only where it is installed."""
    found = {"tunefree_hil": __version__, "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def _reductions(judged: Mapping[str, Judged], kind: str) -> dict[str, Any]:
    """By horizon: by how much the position error on level ground is below the physics'."""
    if not {"physics", kind} <= set(judged) or kind == "physics":
        return {}
    ours, other = judged[kind], judged["physics"]
    return {
        f"{seconds:g}": reduction(ours, other, seconds)
        for column, seconds in enumerate(ours.horizons_s)
        if _comparable(ours, other, column)
    }


def _comparable(ours: Judged, other: Judged, column: int) -> bool:
    import numpy as np

    return bool((np.isfinite(ours.position_m[:, column] + other.position_m[:, column]) & ~ours.hill).any())
