#!/usr/bin/env python3
"""`tools/make_calibration.py [MODEL]`: drives a model with held pedals and writes its open-loop map, calibration.npz.

The drive and the points are those of tunefree_hil/learn/open_loop_map/build.py, which `calibrate` uses too.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from tunefree_hil.base.errors import InputError, TunefreeError  # noqa: E402
from tunefree_hil.config.load import load_model, load_vehicle  # noqa: E402
from tunefree_hil.learn.open_loop_map.build import MapTriple, arrays_from_triples, sample_plant_map  # noqa: E402
from tunefree_hil.plant.single_track import PLANT as PHYSICS  # noqa: E402
from tunefree_hil.plant.types import Plant  # noqa: E402

PLANTS: dict[str, Plant] = {"physics": PHYSICS}


def calibrate(model_name: str) -> list[MapTriple]:
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
    return sample_plant_map(PLANTS[model.plant.kind], dict(model.plant.params), load_vehicle(model.vehicle))


def write(triples: list[MapTriple], path: Path) -> None:
    """Write under a temporary name, then rename."""
    part = path.with_suffix(".part.npz")
    np.savez(part, **arrays_from_triples(triples))  # type: ignore[arg-type]
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
