"""The table [require] of a bench file: what it may say, and the message for what it may not."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load
from tunefree_hil.config.load import load_bench
from tunefree_hil.config.tuning.require_schema import REQUIRE_WORDS, REQUIREMENTS
from tunefree_hil.jobs.identity import resolved_toml


def test_a_bench_file_may_leave_it_out(tmp_path: Path) -> None:
    assert load_bench(write_bench(tmp_path)).require is None


def test_limits_are_numbers_and_inf_is_one(tmp_path: Path) -> None:
    file = write_bench(tmp_path, more="[require]\nlateral_error_peak_m = 1\nreplans = inf\n")
    require = load_bench(file).require
    assert require is not None
    assert (require.lateral_error_peak_m, require.replans, require.steer_oscillation_rad) == (1.0, math.inf, None)


def test_the_copy_in_a_run_says_the_same(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path, more="[require]\nlateral_error_peak_m = 0.3\nreplans = inf\n"))
    copy = tmp_path / "copy.toml"
    copy.write_text(resolved_toml(bench))
    assert load_bench(copy).require == bench.spec.require


@pytest.mark.parametrize(
    ("line", "key", "said"),
    [
        ("lateral_error_m = 0.2", "require.lateral_error_m", "unknown key"),
        ("lateral_error_peak_m = -0.1", "require.lateral_error_peak_m", "no drive can keep that"),
        ("lateral_error_peak_m = 0.0", "require.lateral_error_peak_m", "no drive can keep that"),
        ("lateral_error_peak_m = nan", "require.lateral_error_peak_m", "finite number"),
        ("lateral_error_peak_m = -inf", "require.lateral_error_peak_m", "no drive can keep that"),
        ("replans = -1", "require.replans", "no drive can keep that"),
        ('replans = "none"', "require.replans", "expected a number"),
    ],
)
def test_a_limit_that_makes_no_sense_is_refused(tmp_path: Path, line: str, key: str, said: str) -> None:
    file = write_bench(tmp_path, more=f"[require]\n{line}\n")
    with pytest.raises(InputError, match=said) as caught:
        load_bench(file)
    assert caught.value.key == key and caught.value.file == str(file) and caught.value.hint


def test_every_limit_is_described() -> None:
    assert tuple(REQUIRE_WORDS) == REQUIREMENTS
