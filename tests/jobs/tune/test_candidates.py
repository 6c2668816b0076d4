"""The winner of a study as its folder has it, and what is said of a folder that is broken."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load, part_values
from tunefree_hil.control.parameters import round32
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune.candidates import BENCH_VALUES, compute_baseline_vectors
from tunefree_hil.jobs.tune.verdict.best_file import read_best


def test_the_winner_is_read(tmp_path: Path) -> None:
    (tmp_path / "best.toml").write_text("slot = 3\n\n[parameters]\nlat_kp = 0.5\n")
    assert read_best(RunFolder(tmp_path, {})) == {"slot": 3, "parameters": {"lat_kp": 0.5}}


def test_one_without_numbers_says_how_to_write_it_anew(tmp_path: Path) -> None:
    (tmp_path / "best.toml").write_text("slot = 3\n")
    with pytest.raises(InputError, match="is missing") as caught:
        read_best(RunFolder(tmp_path, {}))
    assert caught.value.key == "parameters" and "--resume" in caught.value.hint


def test_a_study_without_one_is_not_finished(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not finished"):
        read_best(RunFolder(tmp_path, {}))


@pytest.mark.parametrize("content", [b"by = 'Stra\xdfe'", b"slot ="])
def test_a_broken_one_is_one_message(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "best.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_best(RunFolder(tmp_path, {}))
    assert caught.value.file == str(path) and caught.value.code == "not_toml"


PARTS = '[controller]\nlateral = "lqr_preview"\nlongitudinal = "pid_preview"\ninner = "mrac_robust"\n'


def test_built_in_parts_with_further_parameters_have_the_usual_manual_sets(tmp_path: Path) -> None:
    plain, more = load(write_bench(tmp_path / "a")), load(write_bench(tmp_path / "b", more=PARTS))
    vectors = compute_baseline_vectors(more)
    assert list(vectors) == list(compute_baseline_vectors(plain)) and BENCH_VALUES not in vectors
    own_values = part_values(more)
    assert own_values
    for vector in vectors.values():
        assert {name: vector[name] for name in own_values} == {name: round32(x) for name, x in own_values.items()}


def test_a_value_of_the_bench_file_is_in_every_manual_set(tmp_path: Path) -> None:
    chosen = PARTS + '\n[controller.parameters]\n"steer.preview" = 0.5\n'
    vectors = compute_baseline_vectors(load(write_bench(tmp_path, more=chosen)))
    assert {vector["steer.preview"] for vector in vectors.values()} == {0.5}


@pytest.mark.parametrize(
    "controller", ['[controller]\ncommand = ["mine"]\n\n[controller.parameters]\n"pi.kp" = 1.0\n', '"pi.kp" = 1.0\n']
)
def test_a_foreign_controller_has_the_values_of_the_bench_file_alone(tmp_path: Path, controller: str) -> None:
    """The second one is joined: its parts in the bench file are the built-in ones."""
    table = controller if controller.startswith("[") else f"[controller.parameters]\n{controller}"
    vectors = compute_baseline_vectors(load(write_bench(tmp_path, more=table)))
    assert list(vectors) == [BENCH_VALUES] and vectors[BENCH_VALUES]["pi.kp"] == 1.0
