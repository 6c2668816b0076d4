#!/usr/bin/env python3
"""`tools/make_calibration.py [MODEL]`: drives a model with held pedals and writes its open-loop map, calibration.npz.

For each speed and pedal duty the model is put on a level, straight road at that speed and the rate of its speed is
read off; the triples (speed, acceleration, command) of interfaces 3 are those points, thinned to where a command makes
a difference. Standstill itself is left out: there a brake shows nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from tunefree_hil.base.errors import InputError, TunefreeError  # noqa: E402
from tunefree_hil.config.load import load_model, load_vehicle  # noqa: E402
from tunefree_hil.control.calibration_map import KEYS  # noqa: E402
from tunefree_hil.plant.body import Plant  # noqa: E402
from tunefree_hil.plant.single_track import PLANT as PHYSICS  # noqa: E402
from tunefree_hil.plant.vehicle import steady_accel  # noqa: E402

SPEEDS_MPS = (0.2, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0)
SPEEDS_MPS += (12.0, 14.0, 16.0, 18.0, 20.0, 22.5, 25.0, 27.5, 30.0)
FINE_STEPS = 16  # of duty 0.005 from rest, where the pedals begin to bite
FINE_FRAC, COARSE_FRAC = 0.005, 0.02
LEAST_STEP_MPS2 = 0.005  # points closer than this say the same
PLANTS: dict[str, Plant] = {"physics": PHYSICS}

Triple = tuple[float, float, float]
AccelOf = Callable[[float, float, float], float]  # (speed, throttle duty, brake duty) -> m/s2


class Pedal(NamedTuple):
    """Duty at rest and the most that the vehicle takes."""

    rest_frac: float
    limit_frac: float

    def duties(self) -> list[float]:
        """From rest to the limit: fine steps first."""
        fine = [self.rest_frac + FINE_FRAC * i for i in range(FINE_STEPS)]
        start = fine[-1] + COARSE_FRAC
        coarse = [start + COARSE_FRAC * i for i in range(round((self.limit_frac - start) / COARSE_FRAC))]
        return [duty for duty in fine + coarse if duty < self.limit_frac - 1e-9] + [self.limit_frac]


def sweep(accel_of: AccelOf, throttle: Pedal, brake: Pedal, speeds: tuple[float, ...] = SPEEDS_MPS) -> list[Triple]:
    """The triples, by speed and then by acceleration; brake commands are negative.

    Between the last brake duty that does nothing and the last throttle duty that does nothing the acceleration is that
    of coasting; the map has both, a hair apart, so that neither pedal's dead band is interpolated away.
    """
    triples = []
    for speed in speeds:
        braking = _biting([(accel_of(speed, throttle.rest_frac, duty), -duty) for duty in brake.duties()], -1.0)
        pushing = _biting([(accel_of(speed, duty, brake.rest_frac), duty) for duty in throttle.duties()], 1.0)
        coasting = braking[0][0]
        braking[0] = (coasting - 0.5 * LEAST_STEP_MPS2, braking[0][1])
        triples += [(speed, accel, command) for accel, command in reversed(braking)]
        triples += [(speed, accel, command) for accel, command in pushing]
    return triples


def _biting(points: list[tuple[float, float]], sign: float) -> list[tuple[float, float]]:
    """(acceleration, command) points from the last that does as little as the first, each LEAST_STEP further."""
    first = points[0][0]
    idle = [point for point in points if sign * (point[0] - first) < LEAST_STEP_MPS2]
    kept = [(first, idle[-1][1])]
    for accel, command in points:
        if sign * (accel - kept[-1][0]) >= LEAST_STEP_MPS2:
            kept.append((accel, command))
    return kept


def calibrate(model_name: str) -> list[Triple]:
    """The triples of a model folder. Raises InputError for a kind of plant that cannot be driven from here."""
    model = load_model(model_name)
    if model.plant.kind not in PLANTS:
        raise InputError(
            f"plant kind {model.plant.kind!r} cannot be driven by this tool",
            code="bad_plant",
            file=f"{model.folder}/model.toml",
            key="plant.kind",
            hint=f"it drives {', '.join(PLANTS)}",
        )
    vehicle = load_vehicle(model.vehicle)
    plant, params = PLANTS[model.plant.kind], dict(model.plant.params)

    def accel_of(speed_mps: float, throttle_frac: float, brake_frac: float) -> float:
        return steady_accel(plant, params, speed_mps, throttle_frac, brake_frac)

    rest_frac = vehicle.nominal.rest_pedal_frac
    return sweep(accel_of, Pedal(rest_frac, vehicle.limits.throttle_frac), Pedal(rest_frac, vehicle.limits.brake_frac))


def write(triples: list[Triple], path: Path) -> None:
    """Write under a temporary name, then rename."""
    columns = np.array(triples, dtype=np.float64).T
    part = path.with_suffix(".part.npz")
    np.savez(part, **dict(zip(KEYS, columns, strict=True)))
    part.replace(path)


def main(words: list[str]) -> int:
    """Make one map; exit 0, or 2 for a wrong name."""
    try:
        name = words[0] if words else "mkz_nominal"
        triples = calibrate(name)
        path = Path(load_model(name).folder) / "calibration.npz"
        write(triples, path)
    except TunefreeError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    accels = [accel for _, accel, _ in triples]
    print(f"{path}: {len(triples)} points, {min(accels):.2f} to {max(accels):.2f} m/s2")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
