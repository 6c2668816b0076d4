"""A model folder of a learned kind, out of the calibrated physics' folder and what was trained."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tunefree_hil.base.open_loop_map import MAP_FILE
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import ActuatorSpec, Interval, ModelSpec, Number, VehicleSpec
from tunefree_hil.learn.free_run import Judged
from tunefree_hil.learn.motion import Track
from tunefree_hil.learn.values import ActuatorFit, Value, exactly
from tunefree_hil.learn.worker import Worker
from tunefree_hil.learn.write_model import OWN_LOGS, write_model
from tunefree_hil.plant.carriage import DEFAULTS as CARRIAGE
from tunefree_hil.plant.learned_file import INPUTS

Arrays = Mapping[str, Any]
LATENCIES = ("report_latency", "ins_latency")


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


def plant_file(kind: str, arrays: Arrays) -> dict[str, Any]:
    """All of a plant.npz, in the order in which plant/learned_file.py writes it."""
    entries = {name: np.asarray(arrays[name], dtype=np.float64) for name in sorted(arrays)}
    return {"kind": np.array(kind), "inputs": np.array(INPUTS[kind]), **entries}


def params_of(kind: str, physics: ModelSpec, sample_spacing_s: float = 0.01) -> dict[str, float]:
    """[plant.params] of a kind: all constants for hybrid, the geometry for the others."""
    if kind in ("physics", "hybrid"):
        return dict(physics.plant.params)
    own = {name: value for name, value in physics.plant.params.items() if name in CARRIAGE}
    return own | ({"sample_spacing_s": sample_spacing_s} if kind == "paper" else {})


def write_learned(
    folder: Path,
    vehicle: VehicleSpec,
    physics: ModelSpec,
    kind: str,
    arrays: Arrays | None,
    calibration: Arrays | None,
    card: Mapping[str, Any],
    *,
    sample_spacing_s: float = 0.01,
) -> Path:
    """Write the folder: actuators, noise, effects, timing and valid region are those of the physics' folder. A latency
    that its own logs told is not: a net that was taught by them has it in it.

    arrays: of plant.npz, None for kind rule_based, whose file is `calibration`.
    """
    valid = {name: getattr(physics.valid, name) for name in physics.valid.__struct_fields__}
    effects = [
        {"name": one.name, "params": one.params, "interval": one.interval, "provenance": one.provenance}
        for one in physics.effects
        if arrays is None or not (one.name in LATENCIES and one.provenance.get("by") == OWN_LOGS)
    ]
    return write_model(
        folder,
        vehicle,
        kind=kind,
        actuators={name: fit_of(spec) for name, spec in physics.actuators.items()} if kind != "paper" else {},
        params=params_of(kind, physics, sample_spacing_s),
        plant_file=None if arrays is None else plant_file(kind, arrays),
        valid={name: (ends[0], ends[1]) for name, ends in valid.items() if ends},
        noise=physics.noise,
        card=card,
        calibration=calibration,
        effects=effects,
        timing={name: getattr(physics.timing, name) for name in physics.timing.__struct_fields__},
    )


def judged_by_kernels(
    kind: str,
    vehicle: VehicleSpec,
    physics: ModelSpec,
    tracks: Sequence[Track],
    arrays: Arrays | None,
    calibration: Arrays | None,
    most: int,
    sample_spacing_s: float = 0.01,
) -> dict[str, Judged]:
    """Free run of the physics and of a kind on the same starts (at most `most`), by compiled kernels."""
    with tempfile.TemporaryDirectory() as place, Worker() as worker:
        folder = Path(place) / kind
        write_learned(folder, vehicle, physics, kind, arrays, calibration, {}, sample_spacing_s=sample_spacing_s)
        models = {"physics": physics, kind: load_model(folder)}
        return worker.result("tunefree_hil.learn.free_run", "judge_all", models, vehicle, list(tracks), {"most": most})
