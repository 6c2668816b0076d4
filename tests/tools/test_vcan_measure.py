"""The measures `vcan` and `episodes`: what they make of what was found elsewhere, and how they go on when cut off."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.bench.tiny import write_bench
from tools.measures import _over_vcan, episodes, vcan
from tunefree_hil.base.errors import BenchError

TRIPS = {"tfhub": [400.0, 500.0], "vcan": [200.0, 250.0]}


def drive(other: str = "a") -> dict[str, Any]:
    return {"ticks": 500, "hashes": {"tfhub": "a", "vcan": other}, "wall_s": {"tfhub": 10.0, "vcan": 15.0}}


class Kernel:
    """In the place of _over_vcan.py: cut off after `most` lines; `asked`: the words of each run."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, most: int = 99) -> None:
        self.most = most
        self.asked: list[list[str]] = []
        monkeypatch.setattr(vcan, "_found", self.found)

    def found(self, words: list[str], emulated: bool, limit_s: int) -> Iterator[dict[str, Any]]:
        self.asked.append(words)
        lines: list[dict[str, Any]] = []
        if "--scenarios" in words:
            names = words[words.index("--scenarios") + 1].split(",")
            lines = [{"scenario": name, "found": drive("b" if name == "two" else "a")} for name in names]
        if "--runs" in words:
            lines.append({"round_trips_per_s": TRIPS})
        yield from lines[: self.most]
        if self.most < len(lines):
            raise BenchError("the machine ended", code="over_vcan")


@pytest.fixture
def bench(tmp_path: Path) -> str:
    return str(write_bench(tmp_path, scenarios=("one", "two", "three")))


def test_differing_hashes_are_counted_and_named(bench: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Kernel(monkeypatch)
    answer = vcan.measure(bench=bench, folder=str(tmp_path / "kept"))
    assert (answer["value"], answer["low"], answer["high"], answer["n"]) == (1.0, 1.0, 1.0, 3)
    detail = answer["detail"]
    assert detail["differing"] == ["two"] and set(detail["drives"]) == {"one", "two", "three"}
    assert detail["factor_of_drives"]["median"] == 1.5
    assert detail["ticks_per_s"]["tfhub"]["median"] == 50.0
    assert detail["factor_of_round_trips"] == {"median": 2.0, "low": 2.0, "high": 2.0, "n": 2}


def test_cut_off_it_goes_on_with_what_is_missing(bench: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = Kernel(monkeypatch, most=1)
    with pytest.raises(BenchError, match="the machine ended"):
        vcan.measure(bench=bench, folder=str(tmp_path / "kept"))
    kernel.most = 99
    first = vcan.measure(bench=bench, folder=str(tmp_path / "kept"))
    assert "one,two,three" in kernel.asked[0] and "two,three" in kernel.asked[1]
    assert vcan.measure(bench=bench, folder=str(tmp_path / "kept")) == first
    assert len(kernel.asked) == 2, "all was known"
    vcan.measure(bench=bench, rounds=7, folder=str(tmp_path / "kept"))
    assert "--scenarios" not in kernel.asked[2] and kernel.asked[2][-1] == "7"


def test_a_part_that_fails_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vcan, "PART", "tools.measures._no_such_part")
    with pytest.raises(BenchError, match="ended with status 1"):
        list(vcan._found(["vcan0"], False, 10))


@pytest.mark.slow
def test_round_trips_are_counted_between_two_processes(tmp_path: Path) -> None:
    with _over_vcan.start_hub(str(tmp_path / "hub"), clock="sender") as hub:
        address = f"tfhub:{hub.vehicle}"
        with _over_vcan._asker(address) as bus:
            assert _over_vcan.rate_of(bus, 20) > 1.0


def fake_python(folder: Path, line: str, status: int = 0) -> str:
    path = folder / "python"
    path.write_text(f"#!/bin/sh\necho '{line}'\nexit {status}\n")
    path.chmod(0o755)
    return str(path)


def test_highway_env_is_run_where_it_is_and_said_to_be_missing_where_not(tmp_path: Path) -> None:
    other = fake_python(tmp_path, '{"seconds": [0.5, 0.25, 1.0], "version": "1"}')
    assert episodes._highway_env(other, 3, needed=True) == {"version": "1", "episodes_per_s": 2.0, "fastest": 4.0}
    without = fake_python(tmp_path, "no", 1)
    assert "--peer install" in episodes._highway_env(without, 3, needed=False)["not_run"]
    with pytest.raises(BenchError, match="cannot run highway-env"):
        episodes._highway_env(without, 3, needed=True)


def test_its_environment_is_used_once_it_is_whole(tmp_path: Path) -> None:
    assert episodes._peer("", tmp_path) == sys.executable
    assert episodes._peer("/some/python", tmp_path) == "/some/python"
    (tmp_path / "made").touch()
    assert episodes._peer("", tmp_path) == episodes._peer("install", tmp_path) == str(tmp_path / "bin" / "python")
