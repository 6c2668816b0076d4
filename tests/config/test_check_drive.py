"""What a vehicle folder needs beyond a log reader's: found all at once, and told when a bench file names the folder."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from tests.house import ROOT
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load
from tunefree_hil.config.check_drive import FIELDS, NOMINAL, check_drive
from tunefree_hil.config.load import load_bench, load_vehicle

MKZ = load_vehicle("mkz_bywire")


@pytest.mark.parametrize("path", sorted((ROOT / "bench_configs").glob("*.toml")), ids=lambda path: path.stem)
def test_the_vehicles_of_our_benches_lack_nothing(path: Path) -> None:
    assert check_drive(load_vehicle(load_bench(path).vehicle)) == []


@pytest.mark.parametrize("name", NOMINAL)
def test_a_missing_constant_is_named(name: str) -> None:
    (problem,) = check_drive(replace(MKZ, nominal=replace(MKZ.nominal, **{name: None})))
    assert problem.key == f"nominal.{name}" and problem.file.endswith("mkz_bywire/vehicle.toml") and problem.hint


@pytest.mark.parametrize(("group", "name"), [(group, name) for group, (names, _) in FIELDS.items() for name in names])
def test_a_missing_field_is_named(group: str, name: str) -> None:
    fields = {key: value for key, value in getattr(MKZ, group).items() if key != name}
    (problem,) = check_drive(replace(MKZ, **{group: fields}))
    assert problem.key == f"{group}.{name}" and f"[{group}.{name}]" in problem.hint


def test_a_bench_of_a_vehicle_for_logs_is_refused_with_all_that_it_lacks(tmp_path: Path) -> None:
    text = (ROOT / "bench_configs" / "mkz_steer.toml").read_text(encoding="utf-8")
    file = tmp_path / "b.toml"
    file.write_text(text.replace('"mkz_bywire"', '"rav4_2017"'), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load(file)
    lines = caught.value.message.splitlines()[1:]
    lacking = ("command.throttle_frac", "command.brake_frac", "command.steer_rad", "ins.x_m", "ins.y_m",
               "ins.heading_rad", "ins.speed_mps", "nominal.mass_kg", "nominal.front_axle_m")  # fmt: skip
    assert all(any(line.strip().startswith(f"{key}:") for line in lines) for key in lacking), lines
    assert caught.value.file.endswith("rav4_2017/vehicle.toml")
