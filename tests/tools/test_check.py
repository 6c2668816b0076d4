"""tools/check says which stage failed and hands on the status of the first."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.house import ROOT

STAGES = ("format", "check", "pyright", "pytest")


@pytest.fixture
def check(tmp_path: Path):
    """Runs a copy of the tool in a project whose ruff, pyright and pytest are planted modules."""
    tool = tmp_path / "tools" / "check"
    tool.parent.mkdir()
    tool.write_text((ROOT / "tools" / "check").read_text())

    def call(*words: str, **statuses: int) -> subprocess.CompletedProcess[str]:
        plant = "import sys\nstatuses = %r\nname = sys.argv[1] if %r == 'ruff' else %r\n"
        for name in ("ruff", "pyright", "pytest"):
            text = plant % (statuses, name, name) + "print(sys.argv[1:])\nprint('3 passed in 0.10s')\n"
            text += "sys.exit(statuses.get(name, 0))\n"
            (tmp_path / f"{name}.py").write_text(text)
        return subprocess.run([sys.executable, str(tool), *words], capture_output=True, text=True, timeout=60)

    return call


def test_all_is_well(check) -> None:
    done = check()
    lines = done.stdout.splitlines()
    assert done.returncode == 0
    assert len(lines) == len(STAGES) and all(" ok" in line and line.endswith(" s") for line in lines)
    assert "(3 passed)" in lines[-1]


def test_the_first_failure_counts_and_all_stages_run(check) -> None:
    done = check(check=7, pytest=1)
    assert done.returncode == 7
    assert "FAILED, status 7" in done.stdout and "FAILED, status 1" in done.stdout


def test_no_test_at_all_is_a_failure(check) -> None:
    done = check(pytest=5)
    assert done.returncode == 5
    assert "no test was collected" in done.stdout


def test_of_the_fast_tests_those_of_a_marker(check) -> None:
    for words, asked in ((), "and not foreign'"), (("learning",), "and not foreign and learning'"):
        done = check(*words, pytest=1)
        assert done.returncode == 1 and asked in done.stdout
