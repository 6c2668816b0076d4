"""A model folder of a learned kind, out of the calibrated physics' folder and what was trained."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base import parts
from tunefree_hil.base.contracts import Link, links_of
from tunefree_hil.base.open_loop_map import MAP_FILE
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import ActuatorSpec, Interval, ModelSpec, Number, VehicleSpec
from tunefree_hil.learn.free_run import Judged
from tunefree_hil.learn.motion import Track
from tunefree_hil.learn.values import ActuatorFit, Value, exactly
from tunefree_hil.learn.worker import Worker
from tunefree_hil.learn.write_model import OWN_LOGS, write_model
from tunefree_hil.plant.carriage import DEFAULTS as CARRIAGE

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
        return worker.result("tunefree_hil.learn.free_run", "judge_all", *given)
