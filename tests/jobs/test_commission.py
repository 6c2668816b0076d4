"""The chain of a commission: order, stops, going on, stages again. The stages themselves are stand-ins here."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests import other_vehicle
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs import commission as module
from tunefree_hil.jobs.commission import NAMES, STAGES, Stage, commission
from tunefree_hil.jobs.commission_plan import Asked, Plan, make_plan
from tunefree_hil.jobs.commission_stages import covered_enough, error_of, free_run_good_enough, inside_enough

RESULTS: dict[str, dict[str, Any]] = {
    "collect": {"cells_full": 9, "cells_wanted": 10, "sentence": "9 of 10"},
    "tune": {"sentence": "found", "outside": {"share": 0.02}},
    "verify": {"sentence": "0.3 -> 0.2", "holds": True, "scores": {"tuned": 0.2, "as_shipped": 0.3}},
}


class Chain:
    """Stages that write what they were called for. `results`: what each comes to; `dies`: at which one is killed."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.called: list[str] = []
        self.results = {name: dict(RESULTS.get(name, {"sentence": name})) for name in NAMES}
        self.dies = ""
        stages = tuple(Stage(one.name, self._stage(one.name), one.require, one.words) for one in STAGES)
        monkeypatch.setattr(module, "STAGES", stages)

    def _stage(self, name: str) -> Any:
        def run(plan: Plan) -> Iterator[Event]:
            self.called.append(name)
            yield Event("progress", "at work", {"done": 1, "total": 2})
            if self.dies == name:
                raise KeyboardInterrupt
            (plan.folder / name).mkdir(exist_ok=True)
            yield Event("result", "", self.results[name])

        return run

    def run(self, asked: Asked) -> dict[str, Any]:
        """The data of the result."""
        return list(commission(asked))[-1].data


@pytest.fixture
def chain(monkeypatch: pytest.MonkeyPatch) -> Chain:
    return Chain(monkeypatch)


@pytest.fixture
def asked(tmp_path: Path) -> Asked:
    return Asked("mkz_bywire", Path("bench_configs/mkz_steer.toml"), tmp_path / "c")


def record(asked: Asked) -> dict[str, Any]:
    assert asked.out is not None
    return json.loads((asked.out / "commission.json").read_text())


def test_all_stages_in_order_and_a_page(chain: Chain, asked: Asked) -> None:
    data = chain.run(asked)
    assert chain.called == list(NAMES) and data["exit"] == 0
    page = Path(data["report"]).read_text()
    assert "0.3 -> 0.2" in page and "| as_shipped | 0.300 |" in page and "--bench bench_configs/mkz_steer.toml" in page
    assert set(record(asked)["spent_s"]) == set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_cut_off_in_any_stage_it_goes_on_with_that_one(chain: Chain, asked: Asked, name: str) -> None:
    chain.dies = name
    with pytest.raises(KeyboardInterrupt):
        chain.run(asked)
    chain.dies, chain.called = "", []
    assert chain.run(asked)["exit"] == 0
    assert chain.called == list(NAMES[NAMES.index(name) :])


def test_too_little_coverage_stops_before_calibration_and_says_why(chain: Chain, asked: Asked) -> None:
    chain.results["collect"] |= {"cells_full": 5, "missing": ["reverse"]}
    data = chain.run(asked)
    assert (data["exit"], data["stage"], chain.called) == (1, "collect", ["collect"])
    assert "5 of 10" in data["reason"] and "reverse" in data["reason"]
    assert record(asked)["stages"] == {}
    chain.results["collect"]["cells_full"] = 10
    assert chain.run(asked)["exit"] == 0


def test_a_winner_that_does_not_hold_is_the_exit_status(chain: Chain, asked: Asked) -> None:
    chain.results["verify"]["holds"] = False
    assert chain.run(asked)["exit"] == 1


def test_a_stage_again_sets_aside_what_was_built_on_it(chain: Chain, asked: Asked) -> None:
    chain.run(asked)
    assert asked.out is not None
    (asked.out / "model").mkdir()
    chain.called = []
    chain.run(asked._replace(only="learn"))
    assert chain.called == ["learn"]
    assert (asked.out / "model-1").is_dir() and (asked.out / "tune-1").is_dir()
    assert list(record(asked)["stages"]) == ["calibrate", "collect", "learn"]
    chain.run(asked)
    assert chain.called == ["learn", "map", "tune", "verify"]


def test_a_stage_cannot_come_before_the_one_it_stands_on(chain: Chain, asked: Asked) -> None:
    with pytest.raises(InputError) as caught:
        chain.run(asked._replace(only="learn"))
    assert caught.value.key == "--only" and "collect" in caught.value.message


def test_other_options_are_another_commission(chain: Chain, asked: Asked) -> None:
    chain.run(asked)
    with pytest.raises(InputError) as caught:
        chain.run(asked._replace(trials=7))
    assert caught.value.key == "trials" and "--out" in caught.value.hint


def test_the_bench_that_is_tuned_stands_on_what_was_learned(asked: Asked) -> None:
    plan = make_plan(asked)
    plan.folder.mkdir()
    text = plan.write_bench().read_text()
    assert str(plan.model.resolve()) in text and str((plan.map / "calibration.npz").resolve()) in text
    assert 'verify_model = "mkz_reference"' in text and "left_turn" in text


def test_a_bench_of_another_vehicle_is_refused(asked: Asked) -> None:
    with pytest.raises(InputError) as caught:
        make_plan(asked._replace(bench=other_vehicle.BENCH))
    assert caught.value.key == "vehicle"


def judged(mean_m: float) -> dict[str, Any]:
    """What `learn` says of a plant that is so far off after 10 s."""
    return {"kind": "hybrid", "free_run": {"hybrid": {"level": {"10": {"position_m": {"mean": mean_m}}}}}}


def test_limits(asked: Asked) -> None:
    plan = make_plan(asked)
    assert covered_enough({"cells_full": 8, "cells_wanted": 10}, plan) == ""
    good = judged(2.0)
    assert error_of(good) == 2.0 and free_run_good_enough(good, plan) == ""
    bad = judged(40.0)
    assert "40.0 m" in free_run_good_enough(bad, plan)
    assert error_of({"kind": "hybrid", "free_run": {}}) is None
    assert inside_enough({"outside": {"share": 0.5}}, plan) and not inside_enough({}, plan)
