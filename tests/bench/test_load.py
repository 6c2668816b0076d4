"""A bench file is read with all it names; whatever does not fit is one InputError with file, key and a way on."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.bench.tiny import hash_of, write_bench, write_scenario
from tests.house import ROOT
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load, model_of, scenario_of_hash


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write_bench(tmp_path)


def change(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def mistake(call: Callable[[], object]) -> InputError:
    with pytest.raises(InputError) as caught:
        call()
    assert caught.value.hint, "what to do must be said"
    return caught.value


@pytest.mark.parametrize("path", sorted((ROOT / "bench_configs").glob("*.toml")), ids=lambda path: path.stem)
def test_the_bench_files_of_the_project_load_and_can_be_driven(path: Path) -> None:
    bench = load(path)
    for scenario in bench.scenarios.values():
        assert bench.course(scenario).ticks > 0
    assert model_of(bench, bench.spec.model).vehicle == bench.vehicle.name


def test_what_it_holds(file: Path, tmp_path: Path) -> None:
    bench = load(file)
    assert (bench.file, bench.dt_s, list(bench.scenarios)) == (str(file), 0.01, ["tiny"])
    assert bench.scenarios["tiny"].path == str(tmp_path / "scenarios" / "tiny.toml")
    scenario = bench.scenarios["tiny"]
    assert bench.course(scenario) is bench.course(scenario)
    assert bench.course(scenario).ticks == 200


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ('vehicle = "mkz_bywire"', 'vehicle = "mkz_bywiré"', "unknown_vehicle"),
        ('scenarios = ["tiny"]', 'scenarios = ["tiny", "tinny"]', "unknown_scenario"),
        ("seed = 1", 'seed = 1\nweights = "heavy"', "unknown_weights"),
    ],
)
def test_a_name_that_there_is_not(file: Path, old: str, new: str, code: str) -> None:
    change(file, old, new)
    error = mistake(lambda: load(file))
    assert error.code == code
    assert "there are" in error.message, "the names there are must be listed"


@pytest.mark.parametrize("key", ["model", "verify_model"])
def test_a_model_that_there_is_not(file: Path, key: str) -> None:
    text = file.read_text()
    file.write_text(re.sub(rf'^{key} = "mkz_nominal"$', f'{key} = "mkz_nominl"', text, flags=re.MULTILINE))
    bench = load(file)
    error = mistake(lambda: model_of(bench, getattr(bench.spec, key)))
    assert error.code == "unknown_model" and "mkz_nominal" in error.message + error.hint


def test_a_bench_file_that_there_is_not(tmp_path: Path) -> None:
    assert "mkz_steer" in mistake(lambda: load(tmp_path / "nothing.toml")).message


def test_a_model_of_another_vehicle(file: Path, tmp_path: Path) -> None:
    folder = tmp_path / "models" / "theirs"
    shutil.copytree(ROOT / "bench_configs" / "models" / "mkz_nominal", folder)
    change(folder / "model.toml", 'vehicle = "mkz_bywire"', 'vehicle = "other_car"')
    bench = load(file)
    error = mistake(lambda: model_of(bench, "theirs"))
    assert (error.code, error.key) == ("model_of_other_vehicle", "vehicle")
    assert (
        error.file == str(folder / "model.toml") and "'other_car'" in error.message and "'mkz_bywire'" in error.message
    )


def test_a_scenario_that_the_vehicle_cannot_drive(file: Path, tmp_path: Path) -> None:
    path = write_scenario(tmp_path, curvature=0.9)
    bench = load(file)
    error = mistake(lambda: bench.course(bench.scenarios["tiny"]))
    assert error.file == str(path) and "curvature" in str(error)


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("seed = 1", "sead = 1", "sead"),
        ("seed = 1", 'seed = "one"', "seed"),
        ("seed = 1", "seed = 1.5", "seed"),
        ("trials = 3", "trials = 0", "tune.trials"),
        ('set = "mrac"', 'set = "mrak"', "tune.set"),
        ('model = "mkz_nominal"\nverify', "verify", "model"),
        ('schema = "tunefree.bench/1"', 'schema = "tunefree.bench/9"', "schema"),
        ("seed = 1", "seed = 1\n[controller]\nlook_ahead_m = nan", "controller.look_ahead_m"),
        ("seed = 1", 'seed = 1\n[controller.parameters]\n"lqr.q9" = 1.0', "controller.parameters.lqr.q9"),
    ],
)
def test_a_key_that_is_missing_unknown_or_of_the_wrong_kind(file: Path, old: str, new: str, key: str) -> None:
    change(file, old, new)
    error = mistake(lambda: load(file))
    assert (error.file, error.key) == (str(file), key)


def test_a_scenario_is_found_by_its_hash(file: Path, tmp_path: Path) -> None:
    bench = load(file)
    assert scenario_of_hash(bench, hash_of(tmp_path)).name == "tiny"
    other = write_scenario(tmp_path, "another", 3.0)
    assert scenario_of_hash(bench, hash_of(tmp_path, "another")).path == str(other), "one the bench file does not name"


def test_an_unknown_hash_lists_the_files_there_are(file: Path, tmp_path: Path) -> None:
    bench = load(file)
    error = mistake(lambda: scenario_of_hash(bench, b"\x01\x02\x03\x04\x05\x06"))
    assert error.code == "unknown_scenario" and "010203040506" in error.message
    assert f"tiny ({hash_of(tmp_path).hex()})" in error.message and "left_turn (" in error.message
    assert "byte for byte" in error.hint


def test_a_broken_scenario_of_somebody_else_does_not_hide_the_answer(file: Path, tmp_path: Path) -> None:
    """While looking for a hash, a file beside it that cannot be read is not the user's question."""
    (tmp_path / "scenarios" / "aaa_broken.toml").write_text("schema = [")
    bench = load(file)
    write_scenario(tmp_path, "zebra", 3.0)
    assert scenario_of_hash(bench, hash_of(tmp_path, "zebra")).name == "zebra"


def test_two_scenarios_of_one_name_are_refused(file: Path, tmp_path: Path) -> None:
    other = write_scenario(tmp_path / "else", "tiny", 3.0)
    change(file, '\nscenarios = ["tiny"]', f'\nscenarios = ["tiny", "{other}"]')
    error = mistake(lambda: load(file))
    assert (error.file, error.key) == (str(file), "scenarios") and str(other) in error.message
