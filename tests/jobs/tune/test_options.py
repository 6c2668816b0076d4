"""What a `tune` comes to: refused before there is a run folder, and gone on with as it was begun."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.bench.tiny import write_bench
from tunefree_hil.base.errors import InputError
from tunefree_hil.jobs.options.records import TuneOptions
from tunefree_hil.jobs.tune.folder import open_run_folder
from tunefree_hil.jobs.tune.options import TunePlan, make_tune_plan

BEGUN: dict[str, Any] = {
    "trials": 5, "set_name": "lateral", "sampler": "tpe_relative", "seed": 7, "scale": "linear", "verify": False,
    "confirm": 2,
}  # fmt: skip


def begun(folder: Path, **more: Any) -> Path:
    """The run folder of a tune that was cut off."""
    wish = make_tune_plan(TuneOptions(write_bench(folder), out=folder / "runs", **more))
    with open_run_folder(wish) as (run, _):
        return run.path


def resumed(run: Path, **more: Any) -> TunePlan:
    """`tune --resume RUN`, as the command line hands it on."""
    return make_tune_plan(TuneOptions(resume=run, **more))


def test_a_run_goes_on_with_the_options_that_it_was_begun_with(tmp_path: Path) -> None:
    run = begun(tmp_path, **BEGUN)
    wish = resumed(run)
    assert {name: getattr(wish.options, name) for name in BEGUN} == BEGUN and wish.trials == 5
    assert wish.settings.as_data() == json.loads((run / "run.json").read_text())["settings"]


def test_what_the_command_says_counts_and_is_kept_for_the_next(tmp_path: Path) -> None:
    run = begun(tmp_path, **BEGUN)
    with open_run_folder(resumed(run, trials=9)) as (_, old):
        assert old
    assert resumed(run).trials == 9 and resumed(run, seed=8).settings.seed == 8


def test_what_is_said_counts_where_it_is_what_is_usual_too(tmp_path: Path) -> None:
    run = begun(tmp_path, **BEGUN)
    said: dict[str, Any] = {"verify": True, "confirm": 3}
    wish = resumed(run, **said)
    assert {name: getattr(wish.options, name) for name in said} == said
    assert "confirm" not in wish.command and "no-verify" not in wish.command
    assert "--no-verify" in resumed(run).command and "--confirm 2" in resumed(run).command


def test_a_run_of_an_earlier_version_goes_on_as_it_did(tmp_path: Path) -> None:
    run = begun(tmp_path, trials=5)
    record = json.loads((run / "run.json").read_text())
    del record["options"]
    (run / "run.json").write_text(json.dumps(record))
    assert resumed(run).trials == 3 and resumed(run).options.verify, "the bench file's number"


@pytest.mark.parametrize("more", [{"sampler": "nonsense"}, {"seed": -1}])
def test_settings_that_no_study_can_have_are_refused_first(tmp_path: Path, more: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        begun(tmp_path, **more)
    assert not (tmp_path / "runs").exists(), "an unfinished run would be left that nobody can go on with"
