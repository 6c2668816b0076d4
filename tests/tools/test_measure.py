"""tools/measure: lists, runs and refuses, and prints nothing but the answer on stdout."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.house import ROOT
from tools.measures._summary import summary

GOOD = '''"""A measure."""
VALUE = "m of rope"
def measure(runs: int = 3, scale: float = 1.0, name: str = "x"):
    print("working")
    return {"value": runs * scale, "unit": "m", "n": runs, "low": None, "high": 4.0, "detail": {"name": name}}
'''
BAD = 'VALUE = "nothing"\ndef measure():\n    return {"value": 1.0}\n'
FAILING = """VALUE = "nothing"
from tunefree_hil.base.errors import PeerGone
def measure():
    raise PeerGone("ecu")
"""


@pytest.fixture
def measure(tmp_path: Path):
    """Runs a copy of the tool over a folder of planted measures."""
    folder = tmp_path / "tools" / "planted"
    folder.mkdir(parents=True)
    tool = folder.parent / "measure"
    tool.write_text((ROOT / "tools" / "measure").read_text().replace('/ "measures"', '/ "planted"'))
    for name, text in {"rope": GOOD, "bad": BAD, "failing": FAILING, "_helper": "x = 1"}.items():
        (folder / f"{name}.py").write_text(text)

    def call(*words: str) -> subprocess.CompletedProcess[str]:
        done = subprocess.run([sys.executable, str(tool), *words], capture_output=True, text=True, timeout=60, cwd=ROOT)
        shutil.rmtree(folder / "__pycache__", ignore_errors=True)
        return done

    return call


def test_it_lists(measure) -> None:
    done = measure()
    assert done.returncode == 0
    assert [line.split()[0] for line in done.stdout.splitlines()] == ["bad", "failing", "rope"]
    assert json.loads(measure("--json").stdout)["rope"] == "m of rope"


def test_it_measures(measure) -> None:
    done = measure("rope", "--json", "--runs", "4", "--scale", "0.5", "--name", "y")
    assert json.loads(done.stdout) == {
        "name": "rope",
        "value": 2.0,
        "unit": "m",
        "n": 4,
        "low": None,
        "high": 4.0,
        "detail": {"name": "y"},
    }
    assert "working" in done.stderr
    assert measure("rope").stdout == "rope: 3 m, n = 3\n"


@pytest.mark.parametrize("words", [["rpoe"], ["rope", "--runs"], ["rope", "--runs", "many"], ["rope", "--walks", "1"]])
def test_it_refuses(measure, words: list[str]) -> None:
    done = measure(*words)
    assert (done.returncode, done.stdout) == (2, "")
    assert "Traceback" not in done.stderr


def test_a_lost_bench_has_its_status(measure) -> None:
    done = measure("failing")
    assert (done.returncode, done.stdout) == (3, "")
    assert "ecu is gone" in done.stderr and "Traceback" not in done.stderr


def test_an_answer_without_its_spread_is_none(measure) -> None:
    done = measure("bad")
    assert done.returncode != 0 and "must return" in done.stderr


def test_a_bootstrap_covers_the_median_and_few_readings_give_their_range() -> None:
    few = summary([3.0, 1.0, 2.0], "s", {})
    assert (few["value"], few["low"], few["high"], few["n"]) == (2.0, 1.0, 3.0, 3)
    many = summary([float(i) for i in range(101)], "s", {})
    assert 0.0 < many["low"] < many["value"] == 50.0 < many["high"] < 100.0
    assert many == summary([float(i) for i in range(101)], "s", {})


def test_every_measure_of_the_project_says_what_it_is() -> None:
    done = subprocess.run([sys.executable, "tools/measure"], cwd=ROOT, capture_output=True, text=True, timeout=60)
    names = [line.split()[0] for line in done.stdout.splitlines()]
    assert done.returncode == 0, done.stderr
    files = (ROOT / "tools" / "measures").glob("[!_]*.py")
    assert sorted(names) == sorted(path.stem for path in files)


@pytest.mark.slow
def test_the_first_line_is_there_at_once() -> None:
    words = ["tools/measure", "start_time", "--json", "--runs", "3"]
    done = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True, timeout=60)
    found = json.loads(done.stdout)
    assert (found["n"], found["unit"]) == (3, "s")
    assert 0.0 < found["low"] <= found["value"] <= found["high"]
