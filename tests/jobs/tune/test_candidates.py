"""The winner of a study as its folder has it, and what is said of a folder that is broken."""

from __future__ import annotations

from pathlib import Path

import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune.candidates import read_best


def test_the_winner_is_read(tmp_path: Path) -> None:
    (tmp_path / "best.toml").write_text("slot = 3\n\n[parameters]\nlat_kp = 0.5\n")
    assert read_best(RunFolder(tmp_path, {})) == {"slot": 3, "parameters": {"lat_kp": 0.5}}


def test_one_without_numbers_says_how_to_write_it_anew(tmp_path: Path) -> None:
    (tmp_path / "best.toml").write_text("slot = 3\n")
    with pytest.raises(InputError, match="is missing") as caught:
        read_best(RunFolder(tmp_path, {}))
    assert caught.value.key == "parameters" and "--resume" in caught.value.hint


def test_a_study_without_one_is_not_finished(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not finished"):
        read_best(RunFolder(tmp_path, {}))


@pytest.mark.parametrize("content", [b"by = 'Stra\xdfe'", b"slot ="])
def test_a_broken_one_is_one_message(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "best.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_best(RunFolder(tmp_path, {}))
    assert caught.value.file == str(path) and caught.value.code == "not_toml"
