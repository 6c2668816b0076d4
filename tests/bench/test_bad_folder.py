"""A vehicle folder with mistakes of every kind: one message that lists all of them, from `drive` and from `doctor`."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tests.house import ROOT
from tests.jobs.command import one_message, tunefree
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load
from tunefree_hil.jobs.doctor import check_vehicle_folder
from tunefree_hil.jobs.machine import FAULT

# file, what stands there, the mistake, and two words that its line must say: where, and what or what to do
MISTAKES = (
    ("vehicle.toml", 'signal = "SCMD"', 'signal = "SCMMD"', "command.steer_rad.signal", "did you mean SCMD?"),
    ("vehicle.dbc", " SG_ PC : 16|16", " SG_ PC : 12|16", "message BRAKE_REPORT", "PI and PC overlap"),
    ("vehicle.toml", 'signal = "STATE"\nperiod_ms = 50', 'signal = "STATE"\nperiod_ms = 25', "report.gear.period_ms",
     "25 is no multiple of the tick"),
    ("vehicle.toml", 'ignore = "IGNORE"\ncounter = "COUNT"', 'ignore = "IGNORE"\ne2e = { profile = "P9" }',
     "command.throttle_frac.e2e.profile", "P9"),
    ("vehicle.toml", 'signal = "SPEED"\nscale = 0.2777777777777778', 'signal = "SPEED"\nscale = 1.0',
     "report.speed_mps.scale", "0.277777778"),
)  # fmt: skip


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A bench file whose vehicle is a folder beside it with all the mistakes."""
    folder = tmp_path / "dbc" / "bad_car"
    shutil.copytree(ROOT / "dbc" / "mkz_bywire", folder)
    for name, old, new, _, _ in MISTAKES:
        text = (folder / name).read_text()
        assert old in text, old
        (folder / name).write_text(text.replace(old, new, 1))
    file = write_bench(tmp_path)
    file.write_text(file.read_text().replace('vehicle = "mkz_bywire"', 'vehicle = "dbc/bad_car"'))
    return file


def test_loading_gives_one_error_with_all_of_them(bench: Path) -> None:
    with pytest.raises(InputError) as caught:
        load(bench)
    lines = caught.value.message.splitlines()
    for _, _, _, where, words in MISTAKES:
        assert [line for line in lines if where in line and words in line], f"{where}, {words}:\n{caught.value}"
    assert lines[0].startswith(f"{len(lines) - 1} things")
    assert caught.value.file.endswith("bad_car/vehicle.toml") and caught.value.hint


def test_the_doctor_finds_the_same(bench: Path) -> None:
    with pytest.raises(InputError) as caught:
        load(bench)
    found = [one.text for one in check_vehicle_folder(bench.parent / "dbc" / "bad_car") if one.kind == FAULT]
    assert len(found) == len(set(found)) == len(caught.value.message.splitlines()) - 1
    for _, _, _, where, _ in MISTAKES:
        assert any(where in text for text in found)


@pytest.mark.slow
def test_a_person_gets_one_message(bench: Path) -> None:
    ended = tunefree("drive", bench, "--bus", "tfhub")
    assert ended.status == 2
    one_message(ended, *(word for mistake in MISTAKES for word in mistake[3:]), "what to do")
