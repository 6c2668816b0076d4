"""CSV files as they come: gaps and empty cells named and not filled; wrong rows refused with their line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.episode.drives import ROWS, motion, write_csv, write_map
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_import
from tunefree_hil.episode.csv_drive import CsvDrive, Gap, read_csv_drive


def read(folder: Path, rows: list[dict], **mapping: object) -> CsvDrive:
    spec = load_import(write_map(folder / "m.toml", **mapping))  # type: ignore[arg-type]
    return read_csv_drive(write_csv(folder / "d.csv", rows), spec)


def refused(folder: Path, rows: list[dict]) -> InputError:
    with pytest.raises(InputError) as caught:
        read(folder, rows)
    assert caught.value.hint
    return caught.value


def test_a_whole_drive(tmp_path: Path) -> None:
    drive = read(tmp_path, motion())
    assert len(drive.time_s) == ROWS and drive.gaps == [] and drive.step_s == pytest.approx(0.02)
    assert drive.columns["report.speed_mps"].values[0] == 10.0
    assert all(column.sent.all() for column in drive.columns.values())


def test_units_scale_and_offset(tmp_path: Path) -> None:
    spec = load_import(write_map(tmp_path / "m.toml", {"v": "km/h", "psi": "deg"}, ["v", "psi"]))
    first, second = spec.columns
    text = (tmp_path / "m.toml").read_text().replace('unit = "deg"\n', 'unit = "deg"\nscale = -1.0\noffset = 90.0\n')
    (tmp_path / "m.toml").write_text(text)
    rows = [{"t": 0.0, "v": 36.0, "psi": 0.0}, {"t": 0.1, "v": 72.0, "psi": 90.0}]
    drive = read_csv_drive(write_csv(tmp_path / "d.csv", rows), load_import(tmp_path / "m.toml"))
    assert drive.columns[first.field].values == pytest.approx([10.0, 20.0])
    assert drive.columns[second.field].values == pytest.approx([np.pi / 2.0, 0.0]), "a compass bearing made a heading"


def test_gaps_are_named_with_their_times(tmp_path: Path) -> None:
    rows = [row for row in motion() if not 5.0 < row["t"] < 6.5]
    drive = read(tmp_path, rows)
    assert len(drive.gaps) == 1 and drive.gaps[0].what == ""
    assert drive.gaps[0][1:] == pytest.approx((5.0, 6.5))
    assert len(drive.time_s) == len(rows), "nothing is filled in"


@pytest.mark.parametrize("word", ["", "NaN", "nan", "n/a", "-"])
def test_empty_cells_are_held_out(tmp_path: Path, word: str) -> None:
    rows: list[dict] = [row | ({"v": word} if 100 <= k < 150 else {}) for k, row in enumerate(motion())]
    drive = read(tmp_path, rows)
    assert drive.held_out("report.speed_mps") == 50 and drive.held_out("ins.x_m") == 0
    assert not drive.columns["report.speed_mps"].sent[100:150].any()
    assert [gap.what for gap in drive.gaps] == ["report.speed_mps"]
    assert drive.gaps[0] == Gap("report.speed_mps", pytest.approx(1.98), pytest.approx(3.0))  # type: ignore[arg-type]


def test_times_that_go_back_or_stand_still(tmp_path: Path) -> None:
    rows = motion()
    rows[40], rows[41] = rows[41], rows[40]
    error = refused(tmp_path, rows)
    assert error.code == "unsorted_time" and error.file.endswith("d.csv:43") and "goes back" in error.message
    rows = motion()
    rows[40]["t"] = rows[39]["t"]
    error = refused(tmp_path, rows)
    assert error.code == "repeated_time" and error.file.endswith("d.csv:42") and "stands still" in error.message


@pytest.mark.parametrize(("cell", "code"), [("fast", "bad_cell"), ("inf", "bad_cell"), ("1,5", "truncated_log")])
def test_cells_that_are_no_numbers(tmp_path: Path, cell: str, code: str) -> None:
    rows: list[dict] = list(motion())
    rows[7] = rows[7] | {"v": cell}
    error = refused(tmp_path, rows)
    assert error.file.endswith("d.csv:9") and error.code in (code, "bad_line")


def test_a_file_that_is_cut_off(tmp_path: Path) -> None:
    spec = load_import(write_map(tmp_path / "m.toml"))
    path = write_csv(tmp_path / "d.csv", motion()[:20])
    path.write_text(path.read_text()[:-60])
    with pytest.raises(InputError) as caught:
        read_csv_drive(path, spec)
    assert caught.value.code == "truncated_log" and caught.value.file.endswith(":21")


def test_a_time_without_a_value(tmp_path: Path) -> None:
    rows: list[dict] = list(motion())
    rows[5] = rows[5] | {"t": ""}
    assert refused(tmp_path, rows).code == "no_time"


def test_columns_by_name(tmp_path: Path) -> None:
    rows: list[dict] = [{"speed" if name == "v" else name: value for name, value in row.items()} for row in motion()]
    error = refused(tmp_path, rows)
    assert error.code == "no_column" and error.key == "v" and error.file.endswith(":1")
    path = write_csv(tmp_path / "d.csv", motion())
    path.write_text(path.read_text().replace(",", ";"))
    with pytest.raises(InputError) as caught:
        read_csv_drive(path, load_import(tmp_path / "m.toml"))
    assert "delimiter" in caught.value.hint


def test_empty_files(tmp_path: Path) -> None:
    spec = load_import(write_map(tmp_path / "m.toml"))
    for text in ("", "t,v,a,r,x,y,psi,thr\n"):
        (tmp_path / "d.csv").write_text(text)
        with pytest.raises(InputError) as caught:
            read_csv_drive(tmp_path / "d.csv", spec)
        assert caught.value.code == "empty_log"


def test_a_cell_without_end(tmp_path: Path) -> None:
    """What is no text has no commas either."""
    spec = load_import(write_map(tmp_path / "m.toml"))
    (tmp_path / "d.csv").write_bytes(b"\xff" * 200_000)
    with pytest.raises(InputError, match="no CSV") as caught:
        read_csv_drive(tmp_path / "d.csv", spec)
    assert caught.value.file == str(tmp_path / "d.csv") and caught.value.hint


def test_semicolons_decimal_commas_and_a_byte_order_mark(tmp_path: Path) -> None:
    write_map(tmp_path / "m.toml", None, ["v"], 'delimiter = ";"\ndecimal = ","\n')
    (tmp_path / "d.csv").write_text("\ufefft;v\n0,0;10,5\n0,1;11,5\n", encoding="utf-8")
    drive = read_csv_drive(tmp_path / "d.csv", load_import(tmp_path / "m.toml"))
    assert drive.columns["report.speed_mps"].values.tolist() == [10.5, 11.5]


def test_slow_columns_are_sent_at_their_own_rate(tmp_path: Path) -> None:
    write_map(tmp_path / "m.toml")
    text = (tmp_path / "m.toml").read_text()
    text = text.replace('unit = "m/s"\n', 'unit = "m/s"\nperiod_ms = 100\n')
    text = text.replace('unit = "rad/s"\n', 'unit = "rad/s"\nnew_when = "tick"\n')
    (tmp_path / "m.toml").write_text(text)
    rows = [row | {"tick": k // 4} for k, row in enumerate(motion())]
    drive = read_csv_drive(write_csv(tmp_path / "d.csv", rows), load_import(tmp_path / "m.toml"))
    assert np.flatnonzero(drive.columns["report.speed_mps"].sent)[:4].tolist() == [0, 5, 10, 15]
    assert np.flatnonzero(drive.columns["report.yaw_rate_radps"].sent)[:4].tolist() == [0, 4, 8, 12]
