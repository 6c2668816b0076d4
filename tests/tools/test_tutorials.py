"""The commands of the gap tutorial, pasted one after the other into an empty folder, lead to an answer."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.house import ROOT
from tests.test_documents import commands

TUTORIAL = ROOT / "docs" / "tutorials" / "gap.md"
BIN = Path(sys.executable).parent


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_gap_tutorial_ends_in_an_answer(tmp_path: Path) -> None:
    lines = list(commands(TUTORIAL.read_text("utf-8")))
    assert len(lines) == 4
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.pop("TUNEFREE_JIT", None)  # the tests run without compiled kernels; a reader does not
    for line in lines:
        words = [word.replace(".venv/bin/", f"{BIN}/") for word in shlex.split(line)]
        done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{line}\n{done.stderr[-2000:]}"
    assert json.loads((tmp_path / "answer" / "gap.json").read_text())["verdict"]
    assert (tmp_path / "answer" / "gap.md").exists()
    assert json.loads(done.stdout)["outcome"] in {"right", "in_set", "silent", "wrong", "cannot_test"}
