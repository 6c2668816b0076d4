"""A folder whose protection cannot work is refused, each mistake by its key."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bus.e2e_car import P02, write_car
from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.dbc.check_vehicle import check_vehicle
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.e2e import Nibble
from tunefree_hil.config.load import load_vehicle

OTHER = P02.replace("CRC", "SUM")
KEY = "command.throttle_frac.e2e"


def problems_of(folder: Path) -> dict[str, InputError]:
    return {problem.key: problem for problem in check_vehicle(load_vehicle(folder, check=False))}


def test_a_small_can_fd_folder_loads(tmp_path: Path) -> None:
    codec = Codec(load_vehicle(write_car(tmp_path)))
    drive, state, extra = (codec.by_name[name] for name in ("DRIVE", "STATE", "EXTRA"))
    assert (drive.extended, drive.fd, drive.can_id) == (True, True, 0x18FEF1FE)
    assert drive.bywire == ("brake", "steer", "throttle"), "all in one frame"
    assert drive.e2e is not None and state.e2e is not None and extra.e2e is not None
    assert (drive.e2e.crc_at, drive.e2e.counter_at, drive.e2e.id_nibble_at) == (2, Nibble(3, 4), Nibble(3, 0))
    assert (state.e2e.crc_at, state.e2e.counter_at) == (0, Nibble(1, 0))
    assert (extra.e2e.crc_at, extra.e2e.counter_at) == (0, Nibble(1, 4)), "little-endian"
    assert [one.counter_modulus for one in (drive, state, extra)] == [15, 16, 16]
    assert [one.unproven_frames for one in (drive, state, extra)] == [1, 1, 1]


def test_without_protection_every_frame_is_proven() -> None:
    codec = Codec(load_vehicle("mkz_bywire"))
    assert {message.unproven_frames for message in (*codec.commands, *codec.telemetry)} == {0}


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ('"P01"', '"P09"', f"{KEY}.profile", "unknown E2E profile 'P09'"),
        ('crc = "SUM"', 'crc = "SUMM"', f"{KEY}.crc", "no signal"),
        ('crc = "SUM", ', "", f"{KEY}.crc", "needs it"),
        ('crc = "SUM"', 'crc = "ALIVE"', f"{KEY}.crc", "4 bits"),
        ('crc = "SUM"', 'crc = "THR"', f"{KEY}.crc", "value of its own"),
        ('counter = "ALIVE"', 'counter = "EN"', f"{KEY}.counter", "1 bits"),
        (', nibble = "ID_HIGH"', "", f"{KEY}.nibble", "needs it"),
        ("[0x123]", "[0x123, 5]", f"{KEY}.data_ids", "2 given"),
        ("[0x123]", "[0x1123]", f"{KEY}.data_ids[0]", "does not fit"),
        ('"nibble"', '"middle"', f"{KEY}.id_mode", "no id mode"),
        ('id_mode = "nibble"', 'id_mode = "nibble", max_delta = 14', f"{KEY}.max_delta", "no step"),
        ("24, 25]", "24, 256]", "report.speed_mps.e2e.data_ids[15]", "does not fit"),
        ('"P02"', '"P02", id_mode = "both"', "report.speed_mps.e2e.id_mode", "no id mode"),
        ("SUM : 23|8@0+", "SUM : 21|8@0+", f"{KEY}.crc", "a byte by itself"),
        ("SUM : 23|8@0+", "SUM : 23|8@0-", f"{KEY}.crc", "signed"),
        ("ALIVE : 31|4@0+", "ALIVE : 30|4@0+", f"{KEY}.counter", "half a byte"),
        ("CRC : 0|8@1+", "CRC : 1|8@1+", "extra.EXTRA.e2e.crc", "a byte by itself"),
        ('signal = "BRK"\n', f'signal = "BRK"\ne2e = {OTHER}\n', "command.brake_frac.e2e", "otherwise"),
        ('enable = "EN"', 'constants = { SUM = 1 }', f"{KEY}.crc", "value of its own"),
    ],
)  # fmt: skip
def test_a_mistake_is_found(tmp_path: Path, old: str, new: str, key: str, words: str) -> None:
    found = problems_of(write_car(tmp_path, (old, new)))
    assert key in found and words in found[key].message, {k: str(v) for k, v in found.items()}


def test_an_unknown_profile_has_its_own_code_and_names_the_known(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        Codec(load_vehicle(write_car(tmp_path, ('"P01"', '"P05"'))))
    assert (caught.value.code, caught.value.exit_status) == ("unknown_e2e_profile", 2)
    assert "P01, P02" in caught.value.hint and caught.value.file.endswith("vehicle.toml")


def test_all_mistakes_at_once(tmp_path: Path) -> None:
    folder = write_car(tmp_path, ("[0x123]", "[]"), ('crc = "SUM"', 'crc = "SUMM"'), ('"P02"', '"P2"'))
    with pytest.raises(InputError, match="3 things"):
        Codec(load_vehicle(folder))
