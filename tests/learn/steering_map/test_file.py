"""steering_map.toml: what is written is read again, and what does not fit is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.learn.steering_map.made_turns import BASE, TRUTH, VEHICLE, turning_drive
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.learned.steering_map_schema import load_steering_map
from tunefree_hil.learn.steering_map.file import (
    SteeringSource,
    describe_assumed,
    describe_fit,
    hashes_of_drives,
    write_steering_map,
)
from tunefree_hil.learn.steering_map.fit import SteeringFit, fit_steering_map
from tunefree_hil.learn.steering_map.samples import collect_steady_samples


@pytest.fixture(scope="module")
def fit() -> SteeringFit:
    return fit_steering_map(collect_steady_samples([turning_drive(seconds=150.0)], VEHICLE), BASE, "data sheet")


@pytest.fixture
def file(fit: SteeringFit, tmp_path: Path) -> Path:
    path = tmp_path / "new" / "steering_map.toml"
    return write_steering_map(path, fit, VEHICLE, SteeringSource.LOGS, {"a.log": "sha256:1"})


def test_what_is_written_is_read_again(fit: SteeringFit, file: Path) -> None:
    spec = load_steering_map(file)
    understeer, zone = spec.coefficients.understeer_s2pm, spec.coefficients.dead_zone_rad
    assert understeer.value == fit.steering.understeer_s2pm and understeer.assumed == ""
    assert understeer.low == fit.estimates["understeer_s2pm"].low < understeer.value
    assert zone.low is None and zone.assumed == fit.estimates["dead_zone_rad"].why
    assert (spec.samples, spec.blocks) == (len(fit.samples.block), fit.n_blocks)
    assert spec.notes == describe_assumed(fit) != []
    assert spec.source.kind == "logs" and spec.source.hashes == {"a.log": "sha256:1"}
    assert spec.lateral_accel_bound_mps2 == fit.steering.lateral_accel_bound_mps2
    assert spec.vehicle == VEHICLE.name and spec.path == str(file) and len(spec.hash) == 64
    assert [path.name for path in file.parent.iterdir()] == ["steering_map.toml"]


def test_the_texts_tell_fitted_from_assumed(fit: SteeringFit) -> None:
    assert "understeer 0.004" in describe_fit(fit) and "dead zone" not in describe_fit(fit)
    assert any(line.startswith("dead zone: data sheet: ") for line in describe_assumed(fit))
    assert not any("understeer:" in line for line in describe_assumed(fit))


def test_two_logs_of_one_name_keep_both_hashes() -> None:
    drive = turning_drive(seconds=1.0)
    assert len(hashes_of_drives([drive, drive._replace(log_hash="sha256:2")])) == 2
    assert TRUTH.understeer_s2pm > 0.0


@pytest.mark.parametrize(
    ("old", "new", "code", "key"),
    [
        ("low = ", "lowest = ", "unknown_key", "coefficients"),
        ("[coefficients.length_m]", "[coefficients.height_m]", "unknown_key", "coefficients.height_m"),
        ('schema = "tunefree.steering_map/1"', 'schema = "tunefree.steering_map/2"', "wrong_type", "schema"),
        ('assumed = "', 'assumed = ""  # "', "bad_steering_map", "coefficients"),
        ("high = ", "high = -1e3  # ", "bad_steering_map", "coefficients"),
        ("curvature_bound_1pm = ", "curvature_bound_1pm = -", "bad_steering_map", "curvature_bound_1pm"),
        ("samples = ", "samples = [", "not_toml", ""),
    ],
)
def test_a_file_that_does_not_fit_is_named(file: Path, old: str, new: str, code: str, key: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_steering_map(file)
    assert caught.value.code == code and caught.value.file == str(file)
    assert caught.value.key.startswith(key) and caught.value.hint


def test_a_ratio_of_nothing_and_half_an_interval_are_refused(file: Path) -> None:
    text = file.read_text()
    begin = text.index("[coefficients.steer_ratio]")
    end = text.index("[", begin + 1)
    for table in ("value = -16.0\nlow = -17.0\nhigh = -15.0\n\n", "value = 16.0\nlow = 15.0\n\n"):
        file.write_text(text[:begin] + "[coefficients.steer_ratio]\n" + table + text[end:])
        with pytest.raises(InputError) as caught:
            load_steering_map(file)
        assert caught.value.key.startswith("coefficients.steer_ratio")


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load_steering_map(tmp_path / "no.toml")
    assert caught.value.code == "no_steering_map" and caught.value.hint
