"""Settings for all tests: un-jitted kernels, a hypothesis that repeats, the shared measured data, no colours."""

from __future__ import annotations

import gc
import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings

os.environ["TUNEFREE_JIT"] = "0"  # before any kernel is imported; jitted paths are tested in processes of their own
os.environ.setdefault("MPLBACKEND", "Agg")
# `make test &` in a script has SIGINT ignored, and every process of the tests would ignore the Ctrl-C that it is sent.
signal.signal(signal.SIGINT, signal.default_int_handler)
gc.disable()  # until all tests are collected: thousands of them stay, and need not be looked at again and again

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
    "jobs/learn/test_report_text_outside.py",
    "tools/test_actuators_measure.py",
    "tools/gap_exam/test_exam.py",
    "tools/test_gap_exam_measure.py",
    "tune/weight_regression/",
    "jobs/weights/",
)

# Slow ones so marked are no part of `make test`; "tooling" neither, but it keeps its place among real processes.
OWN = ("compiled", "learning", "postgres", "foreign")

# Slow ones that need no clock, only one processor: they may run beside the tests with real processes. Begun first, the
# longest before the others, so that neither worker waits long for the other one at the end.
LONG = (
    "jobs/commission/test_kill.py",
    "jobs/gap/test_calibration_logs.py",
    "jobs/gap/test_whole.py",
    "tools/gap_exam/",
    "tools/test_gap_exam_measure.py",
    "bench/test_learned.py",
    "learn/",
    "control/test_jit.py",
    "plant/test_jit.py",
    "jobs/collect/",
    "jobs/learn/",
)

settings.register_profile("house", derandomize=True, deadline=None, max_examples=50, database=None)
settings.load_profile("house")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark LEARNING and tooling before anything is chosen by its marks; order all; say what two workers may not share.

    Tests with real processes are one group, so one after another: together they would wait for the two cores. Of the
    others each file is a group, for what its tests share. Without workers (-n) a group means nothing.
    """
    ranks = {}
    for item in items:
        place = item.path.relative_to(ROOT / "tests").as_posix()
        if place.startswith(LEARNING):
            item.add_marker("learning")
        if place.startswith("tools/") and item.get_closest_marker("slow"):
            item.add_marker("tooling")
        rank = next((k for k, long in enumerate(LONG) if place.startswith(long)), len(LONG))
        together = item.get_closest_marker("slow") and rank == len(LONG) and not any(map(item.get_closest_marker, OWN))
        item.add_marker(pytest.mark.xdist_group("processes" if together else place))
        ranks[item] = -1 if together else rank
    items.sort(key=ranks.__getitem__)


def pytest_collection_finish() -> None:
    """What is there now stays to the end."""
    gc.enable()
    gc.collect()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_node_collection_finished(node, ids: list[str]) -> None:
    """The scheduler knows a test's group by its name alone, and runs all on any worker where the names have none."""
    if node.config.getoption("dist") == "loadgroup" and not all("@" in name for name in ids):
        pytest.exit(
            f"pytest {pytest.__version__} and this pytest-xdist do not keep grouped tests on one worker; "
            "install requirements-test.lock",
            returncode=pytest.ExitCode.USAGE_ERROR,
        )


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
