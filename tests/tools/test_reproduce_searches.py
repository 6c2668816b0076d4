"""Searches of the reproduction go on after a kill, and a part runs as a user calls it."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.house import ROOT
from tools.reproduction.records import read_record
from tools.reproduction.runner import NAMES

TOOL = ROOT / "tools" / "reproduce"
DEADLINE_S = 100.0
pytestmark = [pytest.mark.slow, pytest.mark.compiled]


def start(*words: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "TUNEFREE_JIT": "0"}
    command = [sys.executable, str(TOOL), "fig10", "--quick", *words]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, text=True, cwd=ROOT, env=environment, stdout=pipe, stderr=pipe)


def journals(folder: Path) -> dict[str, list[str]]:
    """Complete lines of the searches' journals by folder."""
    files = sorted(folder.glob("searches/*/trials.jsonl"))
    return {path.parent.name: path.read_text(encoding="utf-8").split("\n")[:-1] for path in files}


def wait_for_trials(folder: Path, lines: int, process: subprocess.Popen[str]) -> dict[str, list[str]]:
    began = time.monotonic()
    while time.monotonic() - began < DEADLINE_S:
        known = journals(folder)
        if sum(map(len, known.values())) >= lines:
            return known
        assert process.poll() is None, process.stderr and process.stderr.read()
        time.sleep(0.05)
    raise AssertionError("no trial was driven in time")


@pytest.mark.timeout(300)
def test_a_part_that_was_killed_goes_on_and_gives_what_a_whole_run_gives(tmp_path: Path) -> None:
    cut, whole = tmp_path / "cut", tmp_path / "whole"
    process = start("--work", str(cut), "--out", str(cut / "out"))
    before = wait_for_trials(cut, 3, process)
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=30)
    for work in (cut, whole):
        done = start("--work", str(work), "--out", str(work / "out"))
        said, told = done.communicate(timeout=DEADLINE_S)
        assert done.returncode == 0, told
        assert "fig10" in said and "QUICK" not in said and "%" in told
    after = journals(cut)
    assert all(after[name][: len(lines)] == lines for name, lines in before.items())
    records = [read_record(work / "out" / "fig10.json") for work in (cut, whole)]
    assert records[0].record == records[1].record and records[0].origin.is_quick
    assert json.loads((cut / "out" / "fig10.json").read_text(encoding="utf-8"))["name"] == "fig10"
    assert (cut / "out" / "fig10.png").stat().st_size > 20_000 and not (cut / "out" / "reproduction.md").exists()


@pytest.mark.timeout(1200)
def test_all_parts_and_the_page_are_made_by_one_command(tmp_path: Path) -> None:
    command = [sys.executable, str(TOOL), "--quick", "--out", str(tmp_path / "out"), "--work", str(tmp_path / "work")]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "TUNEFREE_JIT": "0"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    (page,) = (tmp_path / "out").rglob("*.md")
    text = page.read_text("utf-8")
    assert "Quick run" in text
    for name in NAMES:
        assert read_record(next((tmp_path / "out").rglob(f"{name}.json"))) is not None
    pictures = set(re.findall(r"\]\(([^)]+\.png)\)", text))
    assert len(pictures) == sum(name.startswith("fig") for name in NAMES)
    assert all((page.parent / picture).stat().st_size > 10_000 for picture in pictures)
