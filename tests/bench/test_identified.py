"""Which steering map a bench's controller has: its model's, the data sheet's, or a file's; and what is refused."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import pytest

from tests import other_vehicle
from tests.bench.tiny import write_bench
from tests.house import ROOT
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, load, model_of
from tunefree_hil.bench.controller import ControllerFor, constants_of
from tunefree_hil.bench.identified import equivalent_lag_s, identified_of, map_of_plant
from tunefree_hil.config.learned.steering_map_schema import load_steering_map
from tunefree_hil.config.schema import ActuatorSpec
from tunefree_hil.control.steering_map import SteeringMap, data_sheet_map
from tunefree_hil.jobs.identity import compute_identity, resolved_toml

MODELS = ROOT / "bench_configs" / "models"
NUMBERS = SteeringMap(16.4, 0.02, 0.03, 2.8448, -4.5, 0.004, 2e-5, 1.4224, 0.005, 0.1, 3.0)
BOUNDS = ("curvature_bound_1pm", "lateral_accel_bound_mps2")


def map_text(vehicle: str = "mkz_bywire", more: str = "", ratio: float = 16.4) -> str:
    """A steering_map.toml of NUMBERS."""
    numbers = NUMBERS._replace(steer_ratio=ratio)._asdict()
    tables = [
        f'[coefficients.{name}]\nvalue = {value}\nassumed = "made"\n'
        for name, value in numbers.items()
        if name not in BOUNDS
    ]
    head = f'schema = "tunefree.steering_map/1"\nvehicle = "{vehicle}"\n{more}samples = 1\nblocks = 1\n'
    head += "residual_rad = 0.0\n" + "".join(f"{name} = {numbers[name]}\n" for name in BOUNDS)
    source = '[source]\nkind = "logs"\nhashes = {}\n'
    covered = "[covered]\nspeed_mps = [3.0, 20.0]\ncurvature_1pm = 0.1\nlateral_accel_mps2 = 3.0\n"
    return "\n".join([head, source, covered, *tables])


def bench_of(folder: Path, choice: str | None = None) -> Bench:
    """A bench whose model folder is its own."""
    model = folder / "own"
    if not model.exists():
        shutil.copytree(MODELS / "mkz_learned", model, ignore=shutil.ignore_patterns("steering_map.toml"))
    more = "" if choice is None else f'[controller]\nsteering_map = "{choice}"\n'
    path = write_bench(folder, more=more)
    path.write_text(path.read_text().replace('model = "mkz_nominal"', f'model = "{model}"', 1))
    return load(path)


def steering(bench: Bench) -> SteeringMap:
    return identified_of(bench, constants_of(bench.vehicle)).steering


def identity(bench: Bench) -> dict[str, object]:
    return compute_identity(bench, bench.spec.model, bench.scenarios.values())


def test_without_a_file_it_is_that_of_the_plants_axles(tmp_path: Path) -> None:
    bench = bench_of(tmp_path)
    constants = constants_of(bench.vehicle)
    expected = map_of_plant(model_of(bench, bench.spec.model), constants)
    assert steering(bench) == expected != data_sheet_map(constants)
    assert steering(bench_of(tmp_path, "")) == expected
    assert "steering_map" not in identity(bench)["hashes"]  # type: ignore[operator]


def test_the_file_of_the_model_folder_is_taken(tmp_path: Path) -> None:
    plain = bench_of(tmp_path)
    before, model = identity(plain), model_of(plain, plain.spec.model)
    (tmp_path / "own" / "steering_map.toml").write_text(map_text())
    bench = bench_of(tmp_path)
    assert steering(bench) == NUMBERS == ControllerFor(bench).identified.steering
    delays = identified_of(bench, constants_of(bench.vehicle)).delays
    assert delays == identified_of(bench_of(tmp_path, "data_sheet"), constants_of(bench.vehicle)).delays
    assert model_of(bench, bench.spec.model).hash == model.hash
    after = identity(bench)
    assert after["identity"] != before["identity"] and "steering_map" in after["hashes"]  # type: ignore[operator]


def test_the_data_sheet_stays_an_option(tmp_path: Path) -> None:
    plain = bench_of(tmp_path)
    (tmp_path / "own" / "steering_map.toml").write_text(map_text())
    bench = bench_of(tmp_path, "data_sheet")
    assert steering(bench) == data_sheet_map(constants_of(bench.vehicle))
    assert identity(bench)["identity"] != identity(plain)["identity"]


def test_a_file_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(map_text(ratio=15.0))
    first = bench_of(tmp_path, "mine.toml")
    assert steering(first).steer_ratio == 15.0
    absolute = bench_of(tmp_path, str(tmp_path / "mine.toml"))
    assert steering(absolute).steer_ratio == 15.0
    assert identity(absolute)["identity"] == identity(first)["identity"], "the content counts, not the path"
    before = identity(first)["identity"]
    (tmp_path / "mine.toml").write_text(map_text(ratio=15.5))
    assert identity(absolute)["identity"] != before and steering(absolute).steer_ratio == 15.5
    assert f'steering_map = "{tmp_path / "mine.toml"}"' in resolved_toml(first)
    assert "steering_map" not in resolved_toml(bench_of(tmp_path))


@pytest.mark.parametrize(
    ("text", "code", "key"),
    [
        (map_text(other_vehicle.NAME), "steering_map_of_other_vehicle", "vehicle"),
        (map_text(more='vehicle_hash = "sha256:00"\n'), "vehicle_changed", "vehicle_hash"),
        (map_text(ratio=0.0), "bad_steering_map", "coefficients.steer_ratio.value"),
    ],
)
def test_a_file_that_is_not_of_this_vehicle(text: str, code: str, key: str, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        steering(bench_of(tmp_path, "mine.toml"))
    assert (caught.value.code, caught.value.key) == (code, key) and caught.value.file.endswith("mine.toml")


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        steering(bench_of(tmp_path, "no.toml"))
    assert caught.value.code == "no_steering_map"


def test_shipped_learned_models_have_the_map_of_their_own_logs() -> None:
    folders = [path.parent for path in MODELS.glob("*_learned/card.json")]
    assert folders
    for folder in folders:
        logs = {log["name"]: log["hash"] for log in json.loads((folder / "card.json").read_text())["logs"]}
        assert load_steering_map(folder / "steering_map.toml").source.hashes == logs


def test_the_lag_of_a_second_order_actuator() -> None:
    """The ramp response of either falls behind by the same time."""
    natural_radps, damping = 12.0, 0.8
    angle, rate, dt_s = 0.0, 0.0, 1e-4
    for k in range(30_000):
        rate += (natural_radps**2 * (k * dt_s - angle) - 2.0 * damping * natural_radps * rate) * dt_s
        angle += rate * dt_s
    spec = ActuatorSpec(order=2, natural_hz=natural_radps / (2.0 * math.pi), damping=damping)
    assert 3.0 - angle == pytest.approx(equivalent_lag_s(spec), abs=2e-4)
