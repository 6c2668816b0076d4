"""The vehicle with end-to-end protection, found by what it is: no Python names a vehicle that came later."""

from __future__ import annotations

from pathlib import Path

from tests.house import ROOT
from tunefree_hil.config.load import load_bench, load_model, load_vehicle

FIRST = "mkz_bywire"  # the vehicle that tests may name


def _folder() -> Path:
    for path in sorted((ROOT / "dbc").glob("*/vehicle.toml")):
        messages = load_vehicle(path.parent, check=False).command.values()
        if path.parent.name != FIRST and any(one.e2e is not None and one.e2e.profile != "none" for one in messages):
            return path.parent
    raise AssertionError("no vehicle folder has protected commands")


FOLDER = _folder()
NAME = FOLDER.name
NOMINAL = next(  # a model folder of it with physics
    path.parent
    for path in sorted((ROOT / "bench_configs" / "models").glob("*/model.toml"))
    if load_model(path.parent).vehicle == NAME and load_model(path.parent).plant.kind == "physics"
)
BENCH = next(
    path
    for path in sorted((ROOT / "bench_configs").glob("*.toml"), reverse=True)
    if Path(load_bench(path).vehicle).name == NAME
)
