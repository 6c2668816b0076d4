"""The chain of a commission: order, stops, going on, its page. The stages themselves are stand-ins here."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from tests.jobs.made_chain import Chain, asked, chain, judged, record
from tunefree_hil.base.errors import InputError
from tunefree_hil.jobs.commission.commission import commission
from tunefree_hil.jobs.commission.plan import NAMES
from tunefree_hil.jobs.commission.report import TITLES
from tunefree_hil.jobs.options.records import CommissionOptions

__all__ = ["asked", "chain"]  # fixtures


def test_all_stages_in_order_and_a_page(chain: Chain, asked: CommissionOptions) -> None:
    data = chain.run(asked)
    assert chain.called == list(NAMES) and data["exit"] == 0
    page = Path(data["report"]).read_text()
    assert "0.3 -> 0.2" in page and "| as_shipped | 0.300 |" in page and "--bench bench_configs/mkz_steer.toml" in page
    assert set(record(asked)["spent_s"]) == set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_cut_off_in_any_stage_it_goes_on_with_that_one(chain: Chain, asked: CommissionOptions, name: str) -> None:
    chain.dies = name
    with pytest.raises(KeyboardInterrupt):
        chain.run(asked)
    chain.dies, chain.called = "", []
    assert chain.run(asked)["exit"] == 0
    assert chain.called == list(NAMES[NAMES.index(name) :])


def test_too_little_coverage_stops_before_calibration_and_the_same_command_tries_again(
    chain: Chain, asked: CommissionOptions
) -> None:
    chain.results["collect"] |= {"cells_full": 5, "missing": ["reverse"]}
    data = chain.run(asked)
    assert (data["exit"], data["stage"], chain.called) == (1, "collect", ["collect"])
    assert "5 of 10" in data["reason"] and "reverse" in data["reason"]
    assert record(asked)["stages"] == {}
    page = Path(data["report"]).read_text()
    assert "Stopped after collect" in page and "| 50% (5 of 10) |" in page
    chain.results["collect"]["cells_full"] = 10
    assert chain.run(asked)["exit"] == 0
    assert "stopped" not in record(asked) and "Stopped" not in Path(data["report"]).read_text()


@pytest.mark.parametrize(
    ("stage", "bad", "said", "wider"),
    [
        ("learn", judged(40.0), "error of the plant is 40.0 m", {"most_error_m": 50.0}),
        ("tune", {"outside": {"share": 0.5, "by": {"speed_mps": 0.4}}}, "speed_mps 40%", {"most_outside": 0.6}),
    ],
)
def test_a_stage_that_is_not_good_enough_is_not_done_over_but_judged_anew(
    stage: str, bad: dict[str, Any], said: str, wider: dict[str, Any], chain: Chain, asked: CommissionOptions
) -> None:
    chain.results[stage] |= bad
    before = list(NAMES[: NAMES.index(stage) + 1])
    for calls in (before, []):
        chain.called = []
        data = chain.run(asked)
        assert (data["exit"], data["stage"], chain.called) == (1, stage, calls)
        assert said in data["reason"] and said in Path(data["report"]).read_text()
    assert data["next"][0].endswith(f"--from {stage}")
    assert chain.run(asked._replace(**wider))["exit"] == 0
    assert chain.called == list(NAMES[NAMES.index(stage) + 1 :])


def test_a_stage_that_cannot_do_its_work_says_so_in_record_and_page_and_is_tried_again(
    chain: Chain, asked: CommissionOptions
) -> None:
    chain.refuses = "map"
    with pytest.raises(InputError, match="too little straight driving"):
        chain.run(asked)
    assert asked.out is not None and record(asked)["stopped"]["stage"] == "map"
    assert "Stopped after map: too little straight driving" in (asked.out / "report.md").read_text()
    chain.refuses, chain.called = "", []
    assert chain.run(asked)["exit"] == 0 and chain.called == ["map", "tune", "verify"]
    assert "stopped" not in record(asked)


def test_a_winner_that_does_not_hold_is_the_exit_status(chain: Chain, asked: CommissionOptions) -> None:
    chain.results["verify"] |= {"holds": False, "verdict": "NO GAIN"}
    data = chain.run(asked)
    assert data["exit"] == 1 and data["sentence"].startswith("NO GAIN: 6 of 6 stages")


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"kind": "gru"}, "--kind"),
        ({"only": "tuning"}, "--only"),
        ({"start_at": "tuning"}, "--from"),
        ({"only": "tune", "start_at": "tune"}, "--from"),
        ({"backend": "gpu"}, "--backend"),
        ({"minutes": float("nan")}, "--minutes"),
        ({"least_covered": 1.5}, "--least-covered"),
        ({"most_error_m": -1.0}, "--most-error-m"),
        ({"most_outside": float("inf")}, "--most-outside"),
    ],
)
def test_what_no_stage_could_use_is_said_before_the_first(
    options: dict[str, Any], key: str, chain: Chain, asked: CommissionOptions
) -> None:
    with pytest.raises(InputError) as caught:
        chain.run(asked._replace(**options))
    assert caught.value.key == key and caught.value.hint
    assert chain.called == [] and asked.out is not None and not asked.out.exists()


def test_set_area_and_a_missing_torch_are_said_before_the_first_stage(
    asked: CommissionOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match="unknown set 'all'"):
        next(iter(commission(asked._replace(set_name="all"))))
    with pytest.raises(InputError, match="100 m is too small"):
        next(iter(commission(asked._replace(area_m=100.0))))
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError, match="needs torch") as caught:
        next(iter(commission(asked)))
    assert "pip install '.[learn]'" in caught.value.hint and asked.out is not None and not asked.out.exists()


def test_times_sessions_and_warnings_stand_in_the_page_in_the_order_of_the_stages(
    chain: Chain, asked: CommissionOptions
) -> None:
    chain.dies = "map"
    with pytest.raises(KeyboardInterrupt):
        chain.run(asked)
    chain.dies = ""
    page = Path(chain.run(asked)["report"]).read_text()
    rows = [line for line in page.splitlines() if line.endswith("| done |")]
    assert [row.split(" | ")[0].strip("| ") for row in rows] == list(TITLES.values())
    assert [row.split(" | ")[2] for row in rows] == ["1", "1", "1", "2", "1", "1"]
    assert page.count("- map is doubtful") == 1 and "at most 15 m | 2.00 m over 100 starts" in page


def test_pictures_are_linked_where_they_lie_also_after_the_folder_was_moved(
    chain: Chain, asked: CommissionOptions
) -> None:
    assert asked.out is not None
    picture = asked.out / "map" / "map.png"
    chain.results["map"]["figures"] = [str(picture), str(asked.out / "map" / "lost.png"), "notes.txt"]
    with pytest.raises(InputError):
        chain.run(asked._replace(only="map"))
    chain.run(asked)
    picture.write_bytes(b"")
    assert "(map/map.png)" in Path(chain.run(asked)["report"]).read_text()
    moved = asked.out.rename(asked.out.with_name("moved"))
    page = Path(chain.run(asked._replace(out=moved))["report"]).read_text()
    assert page.count("![") == 1 and "![map](map/map.png)" in page
