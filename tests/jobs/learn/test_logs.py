"""What `calibrate`, `learn` and `map` read: the drives, what is said of them, and what is refused or excused."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from msgspec.structs import replace

from tests.jobs.ended import ended
from tests.learn.made_logs import MKZ, car, good, rows_of, with_report, write_log
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.learn import calibrate, learn
from tunefree_hil.jobs.learn import map as map_job
from tunefree_hil.jobs.learn.logs import read_logs
from tunefree_hil.jobs.learn.options import CalibrateOptions, LearnOptions, MapOptions
from tunefree_hil.learn.drives.drive import Drive


class Heard(NamedTuple):
    """What a reading said and gave."""

    events: list[Event]
    drives: list[Drive]

    def said(self, kind: str) -> list[str]:
        """The words of events of a kind."""
        return [event.message for event in self.events if event.kind == kind]


def heard(logs: Sequence[Path], excused: Collection[str] = ()) -> Heard:
    """The reading of logs as the MKZ's, to its end."""
    drives, events = ended(read_logs(logs, car(MKZ).spec, excused))
    return Heard(events, drives)


@pytest.mark.slow
def test_drives_in_the_order_given_and_how_much_they_are(tmp_path: Path) -> None:
    logs = [write_log(tmp_path / name, good(MKZ, seed)) for name, seed in (("b.log", 2), ("a.log", 1))]
    found = heard(logs)
    assert [drive.name for drive in found.drives] == ["b.log", "a.log"]
    assert found.said("note") == ["reading 2 logs of mkz_bywire", "1.0 minutes of driving"]
    (warning,) = found.said("warning")
    assert "the model will be rough" in warning
    assert heard(logs[:1]).said("note") == ["reading 1 log of mkz_bywire", "0.5 minutes of driving"]


def test_an_ins_that_says_where_another_point_is_says_no_place(tmp_path: Path) -> None:
    log, vehicle = write_log(tmp_path / "a.log", good(MKZ)), car(MKZ).spec
    other = replace(vehicle, ins_frame=replace(vehicle.ins_frame, point="imu"))
    (drive,), events = ended(read_logs([log], other))
    assert not {"ins.x_m", "ins.y_m"} & drive.fields.keys() and "ins.heading_rad" in drive.fields
    assert any(one.kind == "warning" and "are of 'imu'" in one.message for one in events)


def test_a_refusal_is_excused_by_its_code_only(tmp_path: Path) -> None:
    log = write_log(tmp_path / "short.log", rows_of(MKZ, 6.0))
    for excused in ((), ("one_speed",)):
        with pytest.raises(InputError, match="too short") as caught:
            heard([log], excused)
        assert caught.value.code == "too_short"
    found = heard([log], ["too_short"])
    assert len(found.drives) == 1 and any("too short" in words for words in found.said("warning"))


def test_what_is_not_excused_is_refused_without_what_is(tmp_path: Path) -> None:
    rows = [row._replace(time_s=row.time_s - (0.5 if row.time_s > 4.0 else 0.0)) for row in rows_of(MKZ, 6.0)]
    log = write_log(tmp_path / "back.log", rows)
    with pytest.raises(InputError, match="2 problems"):
        heard([log])
    with pytest.raises(InputError, match="because of 1 problem") as caught:
        heard([log], ["too_short"])
    assert caught.value.code == "clock_jump" and "too short" not in caught.value.message


def test_a_frame_that_says_what_no_car_can_is_left_out_with_a_word(tmp_path: Path) -> None:
    broken = with_report(lambda k, report: report._replace(speed_mps=40.0) if k == 300 else report)
    log = write_log(tmp_path / "flipped.log", rows_of(MKZ, 6.0, change=broken))
    found = heard([log], ["too_short"])
    assert any("1 of report.speed_mps" in words for words in found.said("warning"))
    assert np.nanmax(found.drives[0].fields["report.speed_mps"]) < 20.0


def test_no_log_and_one_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no log is named") as caught:
        heard([])
    assert (caught.value.code, caught.value.key) == ("no_log", "LOG")
    with pytest.raises(InputError, match="no such log"):
        heard([tmp_path / "none.log"])


@pytest.mark.slow
def test_only_a_calibration_takes_what_is_too_little_to_learn_from(tmp_path: Path) -> None:
    """It refuses what no channel can be told from, and has said by then what the logs lack."""
    log, out = write_log(tmp_path / "short.log", rows_of(MKZ, 6.0)), tmp_path / "out"
    steps = calibrate.calibrate(CalibrateOptions([log], MKZ, out))
    while (event := next(steps)).kind != "warning":
        pass
    steps.close()  # type: ignore[attr-defined]
    assert "too short" in event.message
    pytest.importorskip("torch", reason="the extra `learn` is not installed")
    for job in (learn.learn(LearnOptions([log], MKZ, out)), map_job.map_logs(MapOptions([log], MKZ, out))):
        with pytest.raises(InputError, match="too short"):
            list(job)
