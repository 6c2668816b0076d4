"""The bench of `gap --drive`: over the bus or within one process, from standstill to standstill."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tests.gap.made_answer import VEHICLE
from tests.jobs.command import no_orphans
from tunefree_hil.base.errors import BenchError
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.episode.candump import read_candump
from tunefree_hil.gap.experiment_design import MANOEUVRES, Manoeuvre
from tunefree_hil.jobs.gap.drive_bench import ManoeuvreJob, drive_jobs, open_bench, plan_jobs
from tunefree_hil.jobs.gap.options import GapDriveOptions
from tunefree_hil.learn.drives.read import read_drives

SHORT = Manoeuvre("short", "a short drive", (3,), (0,), (3,), 1.0, drive_s=9.0)


@pytest.fixture
def wish(tmp_path: Path) -> GapDriveOptions:
    return GapDriveOptions(write_bench(tmp_path), "virtual")


def driven(folder: Path, wish: GapDriveOptions) -> ManoeuvreJob:
    """A short drive of a bench, over the bus or in this process."""
    run, loaded = open_bench(wish, folder)
    jobs = plan_jobs(run, loaded, [SHORT], 0)
    list(drive_jobs(run, loaded, jobs, wish))
    return jobs[0]


@pytest.mark.slow
def test_in_this_process_the_frames_are_those_of_the_bus(wish: GapDriveOptions, tmp_path: Path) -> None:
    inside = driven(tmp_path / "inside", wish)
    with no_orphans(f"gap-{os.getpid()}"):
        outside = driven(tmp_path / "outside", wish._replace(bus="tfhub"))
    first, second = ([(one.time_s, one.can_id, one.data) for one in read_candump(job.log)] for job in (inside, outside))
    assert len(first) > 5000 and first == second
    (drive,) = read_drives([inside.log], Codec(VEHICLE))
    speed = drive.get("report.speed_mps")
    assert speed is not None and speed.max() > 1.0 and abs(speed[-1]) < 0.2


@pytest.mark.slow
def test_a_drive_that_does_not_end_standing_is_none(
    wish: GapDriveOptions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tunefree_hil.jobs.collect.plan.STOP_MARGIN_S", -5.0)  # the course ends before it could stop
    with pytest.raises(BenchError, match="did not come to a stop in time"):
        driven(tmp_path / "out", wish)
    assert not list((tmp_path / "out" / "logs").glob("*.log"))


def test_the_names_of_drives_follow_the_menu(wish: GapDriveOptions, tmp_path: Path) -> None:
    run, loaded = open_bench(wish, tmp_path / "d")
    jobs = plan_jobs(run, loaded, [MANOEUVRES["circles"], MANOEUVRES["gentle"]], 4)
    assert [one.log.name for one in jobs] == ["drive-005-circles.log", "drive-006-gentle.log"]
