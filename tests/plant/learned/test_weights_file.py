"""plant.npz: what is written is read, and what does not fit is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.plant.model_files import NETS, arrays_of
from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.plant.learned.weights_file import INPUTS, load_plant_file, save_plant


@pytest.mark.parametrize("kind", NETS)
def test_what_is_written_is_read(kind: str, tmp_path: Path) -> None:
    path, again = tmp_path / "plant.npz", tmp_path / "again.npz"
    arrays = arrays_of(kind)
    save_plant(path, kind, arrays)
    save_plant(again, kind, arrays)
    found = load_plant_file(path, kind)
    assert found.inputs == INPUTS[kind] and set(found.arrays) == set(arrays)
    assert all((found.arrays[name] == arrays[name]).all() for name in arrays)
    assert path.read_bytes() == again.read_bytes() and path.stat().st_size < 20_000
    assert sorted(one.name for one in tmp_path.iterdir()) == ["again.npz", "plant.npz"]


def refused(path: Path, kind: str = "lstm") -> InputError:
    with pytest.raises(InputError) as caught:
        load_plant_file(path, kind)
    assert caught.value.file == str(path) and caught.value.hint
    return caught.value


def test_no_file_and_no_npz(tmp_path: Path) -> None:
    assert refused(tmp_path / "none.npz").code == "no_plant_file"
    (tmp_path / "text.npz").write_text("weights")
    assert refused(tmp_path / "text.npz").code == "bad_plant_file"
    save_plant(tmp_path / "cut.npz", "lstm", arrays_of("lstm"))
    data = (tmp_path / "cut.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(data[: len(data) // 2])
    assert refused(tmp_path / "cut.npz").code == "bad_plant_file"


def test_another_kinds_file(tmp_path: Path) -> None:
    save_plant(tmp_path / "plant.npz", "hybrid", arrays_of("hybrid"))
    error = refused(tmp_path / "plant.npz")
    assert error.code == "other_plant_kind" and "hybrid" in error.message and "lstm" in error.message


def test_inputs_in_another_order(tmp_path: Path) -> None:
    path = tmp_path / "plant.npz"
    np.savez(
        path, allow_pickle=False, kind=np.array("lstm"), inputs=np.array(INPUTS["lstm"][::-1]), **arrays_of("lstm")
    )
    assert refused(path).key == "inputs"


def test_somebody_elses_npz(tmp_path: Path) -> None:
    np.savez(tmp_path / "plant.npz", allow_pickle=False, speed_mps=np.zeros(3))
    assert refused(tmp_path / "plant.npz").code == "other_plant_kind"


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("w_rec", lambda a: a[:, :-1]),
        ("bias", lambda a: a[:-4]),
        ("mean", lambda a: a * np.nan),
        ("scale", lambda a: a * 0.0),
        ("bound", lambda a: -a),
        ("w_in", lambda a: a.astype(np.float32)),
    ],
)
def test_an_array_that_does_not_fit(name: str, change, tmp_path: Path) -> None:
    arrays = arrays_of("lstm")
    path = tmp_path / "plant.npz"
    kept = {key: value for key, value in arrays.items() if key != name}
    np.savez(
        path,
        allow_pickle=False,
        kind=np.array("lstm"),
        inputs=np.array(INPUTS["lstm"]),
        **kept,
        **{name: change(arrays[name])},
    )
    error = refused(path)
    assert error.code == "bad_plant_file" and error.key in (name, "w_in", "w_rec")
    np.savez(path, allow_pickle=False, kind=np.array("lstm"), inputs=np.array(INPUTS["lstm"]), **kept)
    assert refused(path).key == name and f"lacks {name}" in refused(path).message


def test_nothing_is_written_that_could_not_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="lacks w_out"):
        save_plant(tmp_path / "plant.npz", "lstm", {k: v for k, v in arrays_of("lstm").items() if k != "w_out"})
    with pytest.raises(InputError, match="no learned plant is of kind 'gru'"):
        save_plant(tmp_path / "plant.npz", "gru", arrays_of("lstm"))
    with pytest.raises(BenchError):
        save_plant(tmp_path / "nowhere" / "plant.npz", "lstm", arrays_of("lstm"))
    assert list(tmp_path.iterdir()) == []
