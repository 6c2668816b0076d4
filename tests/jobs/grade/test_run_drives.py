"""Which run, and which of its candidates, a name on the command line means."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.made_runs import made_drive
from tunefree_hil.base.errors import InputError
from tunefree_hil.jobs.grade.run_drives import read_run, split_run


@pytest.mark.parametrize(
    ("text", "folder", "candidate"),
    [
        ("runs/x", "runs/x", ""),
        ("runs/x:mrac_on", "runs/x", "mrac_on"),
        ("runs/x/verify", "runs/x/verify", ""),
        ("runs/x/verify:as_shipped", "runs/x/verify", "as_shipped"),
        ("runs/12:30:tuned", "runs/12:30", "tuned"),
        ("runs/12:30/verify", "runs/12:30/verify", ""),
        ("runs/x:", "runs/x", ""),
        (":mrac_on", ":mrac_on", ""),
    ],
)
def test_a_name_after_the_last_colon_is_a_candidate(text: str, folder: str, candidate: str) -> None:
    assert split_run(text) == (Path(folder), candidate)


def test_a_folder_of_that_very_name_is_meant_before_a_candidate(tmp_path: Path) -> None:
    (tmp_path / "x:mrac_on").mkdir()
    assert split_run(f"{tmp_path}/x:mrac_on") == (tmp_path / "x:mrac_on", "")
    assert split_run(f"{tmp_path}/x:as_shipped") == (tmp_path / "x", "as_shipped")


def test_a_drive_has_its_scenarios_and_no_candidates(tmp_path: Path) -> None:
    run = made_drive(write_bench(tmp_path, scenarios=("tiny", "other"), duration_s=1.0), tmp_path / "runs", "a", {})
    read = read_run(str(run))
    assert list(read.drives) == ["tiny", "other"] and read.label == run.name and read.vehicle == "mkz_bywire"
    assert list(read.only(["other"]).drives) == ["other"]
    shutil.copytree(run / "episodes" / "0", run / "episodes" / "old")
    assert read_run(str(run)).score() == read.score(), "a person's copy is no episode"
    with pytest.raises(InputError, match="has no candidate 'mrac_on'") as caught:
        read_run(f"{run}:mrac_on")
    assert caught.value.file == str(run)
