"""Settings for all tests: un-jitted kernels, a hypothesis that repeats, the shared measured data, no colours."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings

os.environ["TUNEFREE_JIT"] = "0"  # before any kernel is imported; jitted paths are tested in processes of their own
os.environ.setdefault("MPLBACKEND", "Agg")
# `make test &` in a script has SIGINT ignored, and every process of the tests would ignore the Ctrl-C that it is sent.
signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).resolve().parents[1]

# Folders and files of what trains, collects or calibrates. The fast ones are run by tools/check, the slow ones are a
# stage of their own in CI: `make test` would take too long with them.
LEARNING = (
    "learn/",
    "collect/",
    "jobs/learn/test_calibrate.py",
    "jobs/collect/test_collect.py",
    "jobs/learn/test_learn.py",
    "jobs/learn/test_map.py",
    "jobs/learn/test_outside.py",
    "tools/test_actuators_measure.py",
)

settings.register_profile("house", derandomize=True, deadline=None, max_examples=50, database=None)
settings.load_profile("house")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark LEARNING, before anything is chosen by its marks; and say what two workers may not do side by side.

    Tests with real processes are one group, so one after another: together they would wait for the two cores. Of the
    others each file is a group, for what its tests share. Without workers (-n) a group means nothing.
    """
    for item in items:
        place = item.path.relative_to(ROOT / "tests").as_posix()
        if place.startswith(LEARNING):
            item.add_marker("learning")
        group = "processes" if item.get_closest_marker("slow") else place
        item.add_marker(pytest.mark.xdist_group(group))


@pytest.fixture(scope="session")
def repo() -> Path:
    """The root of the repository."""
    return ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of measured logs that lies beside the repository; the test is skipped where it does not."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("no ../shared/data beside the repository")
    return folder


@pytest.fixture(autouse=True)
def _plain_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a person set for their own terminal must not change an answer."""
    for name in ("NO_COLOR", "FORCE_COLOR", "COLUMNS", "TUNEFREE_HUB"):
        monkeypatch.delenv(name, raising=False)
