"""The open-loop map: rows by speed, what is looked up in them, and files that are no map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.open_loop_map import KEYS, Refusal, Triples, read_triples, rows_by_speed, value_at

REFUSAL = Refusal("not_there", "no_map", "take another", "some.key")
SOME = {key: np.array([1.0, 2.0, 3.0]) for key in KEYS}
NUMBERS = st.floats(-40.0, 40.0)
POINTS = st.lists(st.tuples(st.sampled_from((0.0, 1.5, 2.0, 9.0)), st.integers(-4, 4), NUMBERS), min_size=1)


def refused(path: Path) -> InputError:
    with pytest.raises(InputError) as caught:
        read_triples(path, REFUSAL)
    assert caught.value.file == str(path) and caught.value.hint == "take another"
    return caught.value


def written(path: Path, **more: Any) -> Path:
    np.savez(path, allow_pickle=False, **{**SOME, **more})
    return path


def test_between_its_points_it_is_linear_and_held_at_the_ends() -> None:
    rows = rows_by_speed([10.0, 0.0, 0.0, 10.0, 0.0], [0.5, 0.5, -0.5, -0.5, 0.0], [0.0, 1.0, -1.0, -2.0, 0.5])
    assert [value_at(rows, 0.0, at) for at in (-9.0, -0.25, 0.0, 0.25, 9.0)] == [-1.0, -0.25, 0.5, 0.75, 1.0]
    assert value_at(rows, 10.0, 0.0) == -1.0 and value_at(rows, 2.5, 0.0) == pytest.approx(0.125)
    assert value_at(rows, 99.0, 9.0) == 0.0 and value_at(rows, -1.0, -9.0) == -1.0
    assert value_at(rows_by_speed([3.0], [0.7], [0.2]), 9.0, 0.5) == 0.2


@given(POINTS, NUMBERS, st.floats(-6.0, 6.0))
def test_it_gives_its_points_back_and_never_leaves_them(
    points: list[tuple[float, int, float]], speed: float, at: float
) -> None:
    rows = rows_by_speed(*zip(*points, strict=True))
    last = {(speed, place): value for speed, place, value in points}
    assert {key: value_at(rows, *key) for key in last} == last
    assert min(last.values()) - 1e-9 <= value_at(rows, speed, at) <= max(last.values()) + 1e-9


@given(st.permutations([(v, float(at), v * at * at) for v in (0.0, 3.0, 4.5) for at in range(4)]))
def test_the_order_of_triples_does_not_matter(points: list[tuple[float, float, float]]) -> None:
    assert rows_by_speed(*zip(*points, strict=True)) == rows_by_speed(*zip(*sorted(points), strict=True))


def test_columns_that_are_no_triples() -> None:
    with pytest.raises(ValueError, match="shorter"):
        rows_by_speed([1.0, 2.0], [1.0, 2.0], [1.0])
    with pytest.raises(ValueError, match="one point"):
        rows_by_speed([], [], [])


def test_a_file_gives_its_columns_and_other_arrays_are_let_be(tmp_path: Path) -> None:
    path = written(tmp_path / "map.npz", speed_mps=np.array([1, 2, 3]), card=np.array("{}"), support=np.ones((2, 2)))
    assert read_triples(path, REFUSAL) == Triples([1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0])


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    for path in (tmp_path / "none.npz", tmp_path):
        error = refused(path)
        assert (error.code, error.key, error.message) == ("not_there", "some.key", "no such file")


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"accel_mps2": np.ones(4)}, "have 3, 4, 3 values"),
        ({key: np.ones(0) for key in KEYS}, "have 0, 0, 0 values"),
        ({"accel_mps2": np.array([1.0, np.nan, 1.0])}, "finite"),
        ({"speed_mps": np.array([1.0, np.inf, 1.0])}, "finite"),
        ({key: np.ones((3, 1)) for key in KEYS}, "one-dimensional"),
        ({"command_frac": np.array(0.5)}, "one-dimensional"),
        ({"command_frac": np.array(["a", "b", "c"])}, "cannot be read"),
    ],
)
def test_arrays_that_are_no_map(more: dict[str, Any], words: str, tmp_path: Path) -> None:
    error = refused(written(tmp_path / "map.npz", **more))
    assert error.code == "no_map" and words in error.message


def test_a_file_that_lacks_columns_or_is_no_archive(tmp_path: Path) -> None:
    path = tmp_path / "map.npz"
    np.savez(path, speed_mps=[1.0])
    assert refused(path).message == "lacks accel_mps2, command_frac"
    with path.open("wb") as file:
        np.save(file, np.ones((3, 3)))
    assert "cannot be read" in refused(path).message
    whole = written(path).read_bytes()
    for spoilt in (b"", b"some text", whole[: len(whole) // 2]):
        path.write_bytes(spoilt)
        error = refused(path)
        assert error.code == "no_map" and "cannot be read" in error.message


@given(st.data())
def test_a_spoilt_byte_is_refused_or_harmless(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    path = tmp_path_factory.getbasetemp() / "spoilt.npz"
    np.savez_compressed(path, allow_pickle=False, **SOME)
    content = bytearray(path.read_bytes())
    content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    path.write_bytes(content)
    try:
        assert list(read_triples(path, REFUSAL)) == [column.tolist() for column in SOME.values()]
    except InputError as error:
        assert error.code == "no_map"
