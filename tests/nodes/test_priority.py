"""Punctuality is taken where it is allowed, and given back."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

import pytest

from tunefree_hil.nodes.priority import PRIORITY, lock_memory, punctual

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="scheduling policies are Linux's")


def locked_kb() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmLck"))


def test_what_is_said_is_what_is_had_and_it_is_given_back():
    before = os.sched_getscheduler(0)
    with punctual() as had:
        assert (os.sched_getscheduler(0) == os.SCHED_FIFO) == had
        assert (os.sched_getparam(0).sched_priority == PRIORITY) == had
    assert os.sched_getscheduler(0) == before


def test_memory_is_locked_where_it_may_be():
    locked = lock_memory()
    try:
        assert (locked_kb() > 0) == locked
    finally:
        ctypes.CDLL(None).munlockall()
    assert locked_kb() == 0


def test_without_permission_it_goes_on(monkeypatch: pytest.MonkeyPatch):
    def refused(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr("resource.getrlimit", lambda _: (65536, 65536))
    with punctual() as had:
        assert not had
    assert not lock_memory()
