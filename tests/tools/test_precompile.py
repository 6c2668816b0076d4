"""What is compiled at installation is what `tune` and `verify` would wait for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.house import ROOT
from tunefree_hil.base.kernel_cache import cache_folder
from tunefree_hil.bench import load, parameters_of
from tunefree_hil.bench.batch import Batch, Job
from tunefree_hil.jobs.tune.margins import EFFECTS

TOOL = ROOT / "tools" / "precompile.py"
BENCH = "bench_configs/mkz_envelope.toml"  # what `make tune` takes


def _precompile(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(TOOL), *words], cwd=ROOT, capture_output=True, text=True, check=False)


def _kernels() -> set[Path]:
    return set(cache_folder().glob("*.kernel"))


def test_a_bench_that_cannot_be_read_is_named() -> None:
    done = _precompile("bench_configs/none.toml")
    assert done.returncode == 2
    assert "bench_configs/none.toml" in done.stderr
    assert "Traceback" not in done.stderr


def test_no_bench_is_a_usage_error() -> None:
    done = _precompile()
    assert done.returncode == 2
    assert "precompile.py BENCH" in done.stderr


@pytest.mark.compiled
def test_nothing_is_left_to_compile() -> None:
    done = _precompile(BENCH)
    assert done.returncode == 0, done.stderr
    bench = load(ROOT / BENCH)
    job = Job(parameters_of(bench), bench.scenarios[bench.spec.scenarios[0]])
    ready = _kernels()
    assert ready
    for model, effects in ((bench.spec.verify_model, EFFECTS), (bench.spec.model, ())):
        with Batch(bench, model, extra_effects=effects) as batch:
            batch.drive([job])
    assert _kernels() == ready
