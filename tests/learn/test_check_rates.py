"""How many frames came, and by which clock: a clock that stands still or has other units, a message that hardly comes,
a log of an instant.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.learn.made_logs import MKZ, car, checked, good, refusals, rows_of, write_log
from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.drives.read import read_drives


def test_a_clock_that_stands_still(tmp_path: Path) -> None:
    found = refusals(checked(tmp_path, MKZ, [row._replace(time_s=5.0) for row in good(MKZ)]))
    assert "clock stands still" in found["clock_stands"].message and "wrong_rate" not in found


def test_a_drive_within_less_than_a_second(tmp_path: Path) -> None:
    rows = [row._replace(time_s=round(row.time_s * 0.001, 6)) for row in good(MKZ)]
    words = refusals(checked(tmp_path, MKZ, rows))["wrong_rate"].message
    assert "other units" in words and "1000 times" in words and "two vehicles" not in words


@pytest.mark.parametrize(("name", "frames", "said"), [("THROTTLE_REPORT", 3, "3 frames"), ("GYRO", 1, "1 frame")])
def test_a_message_that_hardly_comes_is_named(name: str, frames: int, said: str, tmp_path: Path) -> None:
    codec = car(MKZ).codec
    key, rows = codec.by_name[name].key, list(good(MKZ))
    first = [row for row in rows if row.can_id == key][:frames]
    found = checked(tmp_path, MKZ, [row for row in rows if row.can_id != key or row in first])
    (told,) = [one for one in found if one.code == "missing_frames"]
    assert told.severity == "warn" and f"only {said} of {name} came" in told.message


def test_a_log_of_an_instant_is_too_short_and_no_other_vehicles(tmp_path: Path) -> None:
    whole = rows_of(MKZ, 0.04)
    for rows in (whole[:1], [row for row in whole if row.time_s == 0.0]):
        found = refusals(checked(tmp_path, MKZ, rows))
        assert found.keys() == {"scrap"} and "too short" in found["scrap"].message
    assert "other_vehicle" not in refusals(checked(tmp_path, MKZ, whole))


def test_stamps_in_microseconds_and_a_compressed_log(tmp_path: Path) -> None:
    log = write_log(tmp_path / "us.log", [row._replace(time_s=row.time_s * 1e6) for row in rows_of(MKZ, 2.0)])
    with pytest.raises(InputError, match="clock jumps") as caught:
        read_drives([log], car(MKZ).codec)
    assert "not in seconds" in caught.value.hint and "cut the log" not in caught.value.hint
    packed = tmp_path / "a.log.gz"
    packed.write_bytes(b"\x1f\x8b\x08\x00" + bytes(60))
    with pytest.raises(InputError, match=r"compressed \(gzip\)") as caught:
        read_drives([packed], car(MKZ).codec)
    assert caught.value.file == str(packed) and "decompress" in caught.value.hint
