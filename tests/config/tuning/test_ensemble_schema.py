"""The table [ensemble] of a bench file: what it may say, and the message for what it may not."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import fields

from tests.bench.tiny import write_bench
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load
from tunefree_hil.config.load import load_bench
from tunefree_hil.config.tuning.ensemble_schema import ENSEMBLE_WORDS, EnsembleSpec
from tunefree_hil.jobs.identity import compute_identity, resolved_toml


def test_a_bench_file_may_leave_it_out_and_an_empty_one_has_defaults(tmp_path: Path) -> None:
    assert load_bench(write_bench(tmp_path)).ensemble is None
    assert load_bench(write_bench(tmp_path, more="[ensemble]\n")).ensemble == EnsembleSpec()


def test_the_copy_in_a_run_says_the_same(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path, more='[ensemble]\ncars = 3\njudge = "constraint"\nmass = [0.8, 1]\n'))
    copy = tmp_path / "copy.toml"
    copy.write_text(resolved_toml(bench))
    assert load_bench(copy).ensemble == bench.spec.ensemble


def test_a_study_of_other_cars_is_another_study(tmp_path: Path) -> None:
    texts = ("", "[ensemble]\n", "[ensemble]\nmass = [0.8, 1]\n")
    benches = [load(write_bench(tmp_path, more=more)) for more in texts]
    assert len({compute_identity(bench, bench.spec.model, [])["identity"] for bench in benches}) == 3


@pytest.mark.parametrize(
    ("line", "key"),
    [
        ("cars = 1", "ensemble.cars"),
        ("tail = 0", "ensemble.tail"),
        ("racing = -1", "ensemble.racing"),
        ("mass = [1.1, 1.2]", "ensemble.mass"),
        ("lag = [1.0]", "ensemble.lag"),
        ("friction = [0.0, 1.0]", "ensemble.friction"),
        ("dead_time = [0.8, nan]", "ensemble.dead_time[1]"),
        ('select_roads = "familys:3"', "ensemble.select_roads"),
        ('judge = "worst"', "ensemble.judge"),
        ("masses = [0.9, 1.1]", "ensemble.masses"),
    ],
)
def test_what_makes_no_ensemble_is_refused(tmp_path: Path, line: str, key: str) -> None:
    file = write_bench(tmp_path, more=f"[ensemble]\n{line}\n")
    with pytest.raises(InputError) as caught:
        load_bench(file)
    assert caught.value.key == key and caught.value.file == str(file) and caught.value.hint


def test_every_key_is_described() -> None:
    assert list(ENSEMBLE_WORDS) == [field.name for field in fields(EnsembleSpec)]
