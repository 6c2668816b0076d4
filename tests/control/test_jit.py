"""Compiled and plain give the same bits over whole drives of the whole controller."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

DRIVE = Path(__file__).with_name("jit_drive.py")


def say(jit: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, str(DRIVE)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "TUNEFREE_JIT": jit},
        timeout=110,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.compiled
def test_same_bits_jitted_and_plain():
    plain = say("0")
    assert len(plain) == 5
    assert all("replans=0" not in line and "last_code=1" in line for line in plain)  # the drive has it all
    assert say("1") == plain
