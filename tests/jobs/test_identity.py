"""What a score depends on is in the identity of a run: the user's own modules too, and nothing else than before."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tunefree_hil.bench import load
from tunefree_hil.config.dump import plain
from tunefree_hil.jobs.identity import compute_identity

NOMINAL = Path(__file__).parents[2] / "bench_configs" / "models" / "mkz_nominal"
PART = "from tunefree_hil.control.lateral.lqr import CONTROLLER\n"
PLANT = "from tunefree_hil.plant.reference import PLANT\n"
MODEL = 'schema = "tunefree.model/1"\nvehicle = "mkz_bywire"\n[plant]\nkind = "{path}:PLANT"\n'


def with_part(folder: Path) -> tuple[Path, Path]:
    """(bench file, module) of a controller with a part of the user's own."""
    module = folder / "mine.py"
    module.write_text(PART)
    return write_bench(folder, more=f'[controller]\nlateral = "{module}:CONTROLLER"'), module


def with_plant(folder: Path) -> tuple[Path, Path]:
    """(bench file, module) of a plant of the user's own."""
    module, model = folder / "mine.py", folder / "models" / "own" / "model.toml"
    module.write_text(PLANT)
    model.parent.mkdir(parents=True)
    shutil.copy(NOMINAL / "calibration.npz", model.parent)
    model.write_text(MODEL.format(path=module))
    path = write_bench(folder)
    path.write_text(path.read_text().replace('model = "mkz_nominal"', 'model = "own"', 1))
    return path, module


def identity(path: Path) -> str:
    bench = load(path)
    return compute_identity(bench, bench.spec.model, bench.scenarios.values())["identity"]


@pytest.mark.parametrize("made", [with_part, with_plant])
def test_a_module_that_was_changed_makes_another_run(made: Callable[[Path], tuple[Path, Path]], tmp_path: Path) -> None:
    bench, module = made(tmp_path)
    first = identity(bench)
    assert identity(bench) == first
    module.write_text(module.read_text() + "GAIN = 2.0\n")
    assert identity(bench) != first


def test_a_bench_without_modules_keeps_the_identity_that_it_had(tmp_path: Path) -> None:
    """Or a tune that was cut off would begin anew with the next version."""
    bench = load(write_bench(tmp_path))
    found = compute_identity(bench, "mkz_nominal", bench.scenarios.values())
    assert set(found["hashes"]) == {"bench", "vehicle", "model", "calibration", "weights", "scenarios"}
    controller = {key: value for key, value in plain(bench.spec.controller).items() if key != "calibration"}
    counted = [{key: value for key, value in found["hashes"].items() if key != "bench"}, controller, [[], []]]
    assert found["identity"] == hashlib.sha256(json.dumps(counted, sort_keys=True).encode()).hexdigest()
