"""Formats are known by what is in a file, not by its name; a missing extra is said with the command that mends it."""

from __future__ import annotations

import builtins
import sys
from pathlib import Path
from typing import Any

import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats import find
from tunefree_hil.bus.formats.rows import Row, survey

ONE = [Row(0.0, "can0", 1, b"a")]


@pytest.mark.parametrize("name", ["blf", "asc", "csv", "mf4", "ros1"])
def test_a_file_is_known_by_its_beginning(name: str, tmp_path: Path) -> None:
    suffix = find.PLACES[name][3][0]
    made = tmp_path / f"x{suffix}"
    find.load_format(name).write(made, ONE, survey(ONE))
    hidden = made.rename(tmp_path / "without_a_name")
    assert find.format_of(hidden) == name


def test_a_ros2_bag_is_a_folder(tmp_path: Path) -> None:
    find.load_format("ros2").write(tmp_path / "bag", ONE, survey(ONE))
    assert find.format_of(tmp_path / "bag") == "ros2"
    with pytest.raises(InputError, match="no ROS 2 bag"):
        find.format_of(tmp_path)


def test_text_is_candump(tmp_path: Path) -> None:
    path = tmp_path / "x.anything"
    path.write_text("(0.0) can0 123#\n")
    assert find.format_of(path) == find.CANDUMP


@pytest.mark.parametrize(("name", "found"), [("x.blf", "blf"), ("x.mf4", "mf4"), ("x", "candump")])
def test_garbage_is_what_its_name_says(name: str, found: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"\x93\x00garbage")
    assert find.format_of(tmp_path / name) == found


def test_candump_under_another_name(tmp_path: Path) -> None:
    (tmp_path / "x.blf").write_text("(0.000000) can0 123#\n")
    assert find.format_of(tmp_path / "x.blf") == find.CANDUMP


def test_missing_and_empty(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such log"):
        find.format_of(tmp_path / "x")
    (tmp_path / "x").touch()
    with pytest.raises(InputError, match="empty"):
        find.format_of(tmp_path / "x")


@pytest.mark.parametrize(
    ("name", "said", "found"),
    [
        ("a.log", "", "candump"),
        ("a.BLF", "", "blf"),
        ("a.mdf", "", "mf4"),
        ("a", "ros2", "ros2"),
        ("a.csv", "asc", "asc"),
    ],
)
def test_the_format_to_write(name: str, said: str, found: str) -> None:
    assert find.format_for(Path(name), said) == found


@pytest.mark.parametrize(("name", "said", "key"), [("a.xyz", "", "OUT"), ("a.log", "trc", "--format")])
def test_an_unknown_format_lists_those_there_are(name: str, said: str, key: str) -> None:
    with pytest.raises(InputError) as caught:
        find.format_for(Path(name), said)
    assert caught.value.key == key and "blf" in caught.value.hint


@pytest.mark.parametrize(("name", "package", "extra"), [("mf4", "asammdf", "mf4"), ("ros2", "rosbags", "rosbag")])
def test_a_missing_extra_is_named(name: str, package: str, extra: str, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(module: str, *arguments: Any, **more: Any) -> Any:
        if module.partition(".")[0] == package:
            raise ModuleNotFoundError(f"No module named {package!r}", name=package)
        return real(module, *arguments, **more)

    for module in [one for one in sys.modules if one.startswith(f"tunefree_hil.bus.formats.{name[:3]}")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError) as caught:
        find.load_format(name)
    assert caught.value.hint == f"pip install 'tunefree_hil[{extra}]'" and package in caught.value.message
