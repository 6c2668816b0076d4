"""With which options a commission goes on, and what is done again. The stages are stand-ins here."""

from __future__ import annotations

import json
from collections.abc import Generator
from pathlib import Path
from typing import cast

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.made_chain import Chain, asked, chain, judged, record
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.commission.commission import commission
from tunefree_hil.jobs.commission.plan import NAMES
from tunefree_hil.jobs.options.records import CommissionOptions

__all__ = ["asked", "chain"]  # fixtures


def test_a_stage_again_sets_aside_what_was_built_on_it(chain: Chain, asked: CommissionOptions) -> None:
    chain.run(asked)
    assert asked.out is not None
    chain.called = []
    chain.run(asked._replace(only="learn"))
    assert chain.called == ["learn"]
    for name in ("model-1", "map-1", "tune-1", "report-1.md", "model", "collect", "physics", "report.md"):
        assert (asked.out / name).exists(), name
    assert set(record(asked)["stages"]) == {"calibrate", "collect", "learn"}
    assert "Not finished: map, tune, verify" in (asked.out / "report.md").read_text()
    chain.run(asked)
    assert chain.called == ["learn", "map", "tune", "verify"]


def test_from_a_stage_on_all_is_done_again(chain: Chain, asked: CommissionOptions) -> None:
    chain.run(asked)
    chain.called = []
    assert chain.run(asked._replace(start_at="map"))["exit"] == 0
    assert chain.called == ["map", "tune", "verify"]


def test_a_stage_again_that_was_cut_off_goes_on_with_what_it_has(chain: Chain, asked: CommissionOptions) -> None:
    chain.run(asked)
    assert asked.out is not None
    chain.dies, again = "learn", asked._replace(only="learn")
    with pytest.raises(KeyboardInterrupt):
        chain.run(again)
    (asked.out / "model.part").write_text("half trained")
    chain.dies = ""
    chain.run(again)
    assert (asked.out / "model.part").is_file() and not (asked.out / "model-2").exists()
    chain.run(asked._replace(only="learn", kind="lstm"))
    assert (asked.out / "model-1.part").is_file() and (asked.out / "model-2").exists()


@pytest.mark.parametrize(("option", "words"), [("only", "--only"), ("start_at", "--from")])
def test_a_stage_cannot_come_before_the_one_it_stands_on(
    option: str, words: str, chain: Chain, asked: CommissionOptions
) -> None:
    with pytest.raises(InputError) as caught:
        chain.run(asked._replace(**{option: "learn"}))
    assert caught.value.key == words and "collect" in caught.value.message and chain.called == []


def test_other_options_are_another_commission(chain: Chain, asked: CommissionOptions) -> None:
    chain.run(asked)
    for option, value, stage in (("trials", 7, "tune"), ("kind", "lstm", "learn"), ("quota_s", 3.0, "collect")):
        with pytest.raises(InputError) as caught:
            chain.run(asked._replace(**{option: value}))
        assert caught.value.key == option and repr(value) in caught.value.message
        assert f"--from {stage}" in caught.value.hint and "--out" in caught.value.hint


def test_options_of_a_stage_that_is_done_again_may_be_others(chain: Chain, asked: CommissionOptions) -> None:
    chain.run(asked)
    other = asked._replace(kind="lstm", minutes=3.0)
    chain.called, chain.results["learn"] = [], {"sentence": "learned", **judged(2.0, kind="lstm")}
    assert chain.run(other._replace(start_at="learn"))["exit"] == 0
    assert chain.called == list(NAMES[2:]) and record(asked)["identity"]["kind"] == "lstm"
    with pytest.raises(InputError):  # too late for these
        chain.run(other._replace(start_at="tune", kind="hybrid"))
    chain.called = []
    assert chain.run(other._replace(only="tune", trials=9))["exit"] == 0 and chain.called == ["tune"]


def test_options_of_a_stage_that_was_not_reached_may_still_change(chain: Chain, asked: CommissionOptions) -> None:
    chain.dies = "learn"
    with pytest.raises(KeyboardInterrupt):
        chain.run(asked)
    chain.dies = ""
    with pytest.raises(InputError, match="kind"):  # learn has begun
        chain.run(asked._replace(kind="lstm"))
    assert chain.run(asked._replace(trials=7))["exit"] == 0


@pytest.mark.parametrize(
    ("old", "new", "file", "key", "stage"),
    [
        ("slower = 1.0", "slower = 1.2", "b.toml", "tuning_hash", "tune"),
        ("noise_seed = 3", "noise_seed = 4", "scenarios/tiny.toml", "tuning_hash", "tune"),
        ("noise_seed = 3", "noise_seed = 4", "scenarios/other.toml", "verify_hash", "verify"),
    ],
)
def test_a_bench_file_that_says_something_else_is_not_done_before(
    old: str, new: str, file: str, key: str, stage: str, chain: Chain, asked: CommissionOptions, tmp_path: Path
) -> None:
    bench = write_bench(tmp_path, scenarios=("tiny", "other"))
    bench.write_text(bench.read_text().replace('\nscenarios = ["tiny", "other"]', '\nscenarios = ["tiny"]')
                     .replace('\nverify_scenarios = ["tiny", "other"]', '\nverify_scenarios = ["other"]'))  # fmt: skip
    asked = asked._replace(bench=bench)
    chain.run(asked)
    changed = tmp_path / file
    changed.write_text(changed.read_text().replace(old, new))
    chain.called = []
    with pytest.raises(InputError, match="which have changed") as caught:
        chain.run(asked)
    assert caught.value.key == key and f"--from {stage}" in caught.value.hint and chain.called == []
    assert chain.run(asked._replace(start_at=stage))["exit"] == 0 and chain.called[0] == stage


def test_a_commission_of_an_earlier_version_goes_on_and_is_watched_from_then_on(
    chain: Chain, asked: CommissionOptions
) -> None:
    chain.run(asked)
    assert asked.out is not None
    data = record(asked)
    for key in ("tuning_hash", "verify_hash"):
        del data["identity"][key]
    (asked.out / "commission.json").write_text(json.dumps(data))
    chain.called = []
    assert chain.run(asked)["exit"] == 0 and chain.called == []
    assert record(asked)["identity"]["tuning_hash"]


def test_a_vehicle_folder_that_has_changed_is_another_commission(chain: Chain, asked: CommissionOptions) -> None:
    chain.run(asked)
    assert asked.out is not None
    file = asked.out / "commission.json"
    file.write_text(file.read_text().replace(record(asked)["identity"]["vehicle_hash"], "0" * 64))
    with pytest.raises(InputError, match="files of the vehicle"):
        chain.run(asked)


def test_two_commissions_in_one_folder(chain: Chain, asked: CommissionOptions) -> None:
    first = cast(Generator[Event, None, None], commission(asked))
    next(first)
    with pytest.raises(InputError, match="another process works on it"):
        chain.run(asked)
    first.close()
    assert chain.run(asked)["exit"] == 0


def test_a_folder_of_something_else_is_not_touched(chain: Chain, asked: CommissionOptions) -> None:
    assert asked.out is not None
    asked.out.mkdir()
    (asked.out / "thing.txt").write_text("mine")
    with pytest.raises(InputError, match="has no commission"):
        chain.run(asked)
    assert [path.name for path in asked.out.iterdir()] == ["thing.txt"]
