"""Processes of ours run our code, whatever lies in the folder they are started from."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.jobs.command import PATIENCE_S
from tunefree_hil.base.own_python import ROOT, own_python

SHADOWS = ("can.py", "queue.py", "signal.py", "tunefree_hil/__init__.py")


def test_a_folders_own_modules_do_not_take_the_place_of_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in SHADOWS:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("raise SystemExit('shadowed')\n")
    monkeypatch.chdir(tmp_path)
    done = subprocess.run(
        own_python("tunefree_hil", "--version"), capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_in_the_folder_of_a_checkout_its_package_is_found_without_installation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    assert "-P" not in own_python("tunefree_hil") and (ROOT / "tunefree_hil" / "__init__.py").is_file()
