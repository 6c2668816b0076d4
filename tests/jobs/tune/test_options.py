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


def test_a_study_that_was_begun_without_requirements_goes_on_without(tmp_path: Path) -> None:
    run = begun(tmp_path, trials=5)
    assert resumed(run).settings.requirements["replans"] == 0.0
    record = json.loads((run / "run.json").read_text())
    del record["settings"]["requirements"]
    (run / "run.json").write_text(json.dumps(record))
    wish = resumed(run)
    assert wish.settings.requirements == {} and wish.settings.as_data() == record["settings"]


def test_the_limits_of_the_bench_file_are_settings_of_the_study(tmp_path: Path) -> None:
    bench = write_bench(tmp_path, more="[require]\nlateral_error_peak_m = 0.3\nreplans = inf\n")
    limits = make_tune_plan(TuneOptions(bench)).settings.requirements
    assert limits["lateral_error_peak_m"] == 0.3 and "replans" not in limits and "steer_oscillation_rad" in limits


@pytest.mark.parametrize(
    ("more", "tune", "wide"),
    [
        ("", "", False),
        ("[require]\n", "", True),
        ("[require]\n", 'box = "paper"\n', False),
        ("", 'box = "default"\n', True),
    ],
)
def test_the_wider_box_needs_requirements_or_a_word(tmp_path: Path, more: str, tune: str, wide: bool) -> None:
    file = write_bench(tmp_path, more=more)
    file.write_text(file.read_text() + tune)
    (low, *_) = [axis.low for axis in make_tune_plan(TuneOptions(file)).settings.space.axes if axis.name == "mrac.p"]
    assert (low < 1e-5) is wide


def test_a_search_begins_with_one_manual_set_or_with_all(tmp_path: Path) -> None:
    file = write_bench(tmp_path)
    one = make_tune_plan(TuneOptions(file)).settings
    assert not one.starts and "starts" not in one.as_data()
    file.write_text(file.read_text() + 'starts = "manual"\n')
    every = make_tune_plan(TuneOptions(file)).settings
    assert every.first == one.first and len(every.starts) >= 1 and every.first not in every.starts
    assert every.as_data()["starts"] == [dict(start) for start in every.starts]


def test_an_ensemble_is_driven_in_the_batch_alone(tmp_path: Path) -> None:
    file = write_bench(tmp_path, more="[ensemble]\n")
    with pytest.raises(InputError) as caught:
        make_tune_plan(TuneOptions(file))
    assert caught.value.key == "ensemble" and "--backend batch" in caught.value.hint
    assert make_tune_plan(TuneOptions(file, backend="batch")).bench.spec.ensemble is not None
