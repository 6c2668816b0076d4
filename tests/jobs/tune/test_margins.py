"""Margins of made-up cars whose margins are known: the search, the data, the words, and what cannot be driven."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace as with_fields

from tests.bench.tiny import write_bench
from tests.jobs.ended import ended
from tunefree_hil.base.errors import InputError, PeerGone
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bench.batch import Driven, Job
from tunefree_hil.config.schema import ControllerSpec, FaultSpec
from tunefree_hil.episode.recording import make_recording
from tunefree_hil.grade.margins import NOMINAL, POINTS, SWEEPS
from tunefree_hil.grade.score import ScenarioGrade
from tunefree_hil.jobs.tune import margins
from tunefree_hil.jobs.tune.candidates import TUNED
from tunefree_hil.jobs.tune.margins import (
    EFFECTS,
    MarginDrives,
    drive_margins,
    find_margins,
    margin_data,
    margin_table,
    margin_text,
    measure_steering,
)

SCENARIOS = ("tiny", "other")
MASS_KG = 2080.0  # of mkz_nominal
STEERING = {"rate_rms_radps": 0.25, "reversals_per_s": 1.5}
Rule = Callable[[Job], tuple[str, int]]


class MadeUp:
    """A batch whose drives come out as a rule says: (outcome, re-plans) of a job."""

    def __init__(self, rule: Rule) -> None:
        self.rule, self.jobs, self.rounds = rule, list[Job](), 0

    def drive(self, jobs: Sequence[Job]) -> list[Driven]:
        self.jobs += jobs
        self.rounds += 1
        return [Driven(self._grade(job), 200, "") for job in jobs]

    def _grade(self, job: Job) -> ScenarioGrade:
        outcome, replans = self.rule(job)
        return ScenarioGrade(job.scenario.name, score_of(job), {}, replans, outcome, 200)


def score_of(job: Job) -> float:
    return job.values["mrac.p"] + len(job.scenario.name)


def delay_s(job: Job) -> float:
    return job.effects.get("steer_dead_time", {}).get("delay_s", 0.0)


def gain(job: Job) -> float:
    return job.effects.get("steer_gain", {}).get("gain_frac", 1.0)


def slow(job: Job) -> tuple[str, int]:
    """The larger mrac.p, the smaller the delay margin: p 0.01 re-plans at 90 ms, 0.02 at 80 ms, ... in 'other' only."""
    limit_s = 0.10 - job.values["mrac.p"]
    return "finished", int(job.scenario.name == "other" and delay_s(job) > limit_s - 1e-9)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return load(write_bench(tmp_path, scenarios=SCENARIOS))


def vectors_of(bench: Bench, **p: float) -> dict[str, dict[str, float]]:
    return {name: parameters_of(bench, {"mrac.p": one}) for name, one in p.items()}


def searched(bench: Bench, rule: Rule, **p: float) -> tuple[MarginDrives, MadeUp, list[Event]]:
    batch = MadeUp(rule)
    job = drive_margins(batch, bench, "mkz_nominal", vectors_of(bench, **p), list(bench.scenarios.values()))
    found, events = ended(job)
    return found, batch, events


def report(found: MarginDrives | str, scores: Mapping[str, float], **more: Any) -> dict[str, Any]:
    over_bus = more.pop("over_bus", found.scores if isinstance(found, MarginDrives) else {})
    return margin_data(found, dict.fromkeys(scores, STEERING), scores, over_bus)


def test_known_margins_are_found_for_every_vector(bench: Bench) -> None:
    found, batch, events = searched(bench, slow, tuned=0.03, manual=0.01)
    assert found.margins["tuned"]["delay"] == (pytest.approx(0.07), False, "other", "re-plan")
    assert found.margins["manual"]["delay"] == (pytest.approx(0.09), False, "other", "re-plan")
    assert found.margins["tuned"]["gain_up"] == (2.0, True, "", "")
    assert found.drives == len(batch.jobs) == len(SCENARIOS) * sum(len(cars) for cars in found.driven.values())
    progress = [event.data for event in events if event.kind == "progress"]
    assert progress[-1]["done"] == progress[-1]["total"] == found.drives
    assert [one["done"] for one in progress] == sorted(one["done"] for one in progress)


def test_nothing_is_driven_twice_and_nothing_behind_a_margin(bench: Bench) -> None:
    _, batch, _ = searched(bench, slow, tuned=0.03, manual=0.01)
    made = [(job.values["mrac.p"], job.scenario.name, repr(job.effects), repr(job.scale)) for job in batch.jobs]
    assert len(set(made)) == len(made)
    assert max(delay_s(job) for job in batch.jobs) == 0.09
    assert batch.rounds <= 1 + max(len(cars) for cars in SWEEPS.values())


def test_a_changed_car_is_asked_for_as_effects_and_scale(bench: Bench) -> None:
    _, batch, _ = searched(bench, slow, tuned=0.03)
    jobs = {(repr(dict(job.effects)), repr(dict(job.scale))) for job in batch.jobs}
    assert ("{}", "{}") in jobs and ("{}", "{'dead_time': 1.4}") in jobs and ("{}", "{'lag': 0.6}") in jobs
    masses = {round(job.effects["payload"]["mass_kg"], 6) for job in batch.jobs if set(job.effects) == {"payload"}}
    assert masses == {round(MASS_KG * one, 6) for one in (-0.1, 0.1, 0.2, 0.3)}
    assert any(
        set(job.effects) == {"payload", "friction"} and set(job.scale) == {"dead_time", "lag"} for job in batch.jobs
    )
    assert {name for job in batch.jobs for name in job.effects} == set(EFFECTS)


def test_the_winner_with_less_is_marked_in_table_and_sentence(bench: Bench) -> None:
    found, _, _ = searched(bench, slow, tuned=0.04, best=0.01)
    data = report(found, {"tuned": 0.1, "best": 0.2})
    assert data["against"] == "best" and [one["what"] for one in data["less"]] == ["delay"]
    assert margin_text(data, TUNED) == "but with less delay margin than best: 60 ms against 90 ms"
    lines = margin_table(data, TUNED)
    assert "60 ms <  " in lines[1] and "< " not in lines[2].replace("<= ", "")
    assert "0.250 rad/s" in lines[1] and "1.50 /s" in lines[1]


def test_the_winner_with_more_is_not(bench: Bench) -> None:
    found, _, _ = searched(bench, slow, tuned=0.01, best=0.04)
    data = report(found, {"tuned": 0.1, "best": 0.2})
    assert data["less"] == [] and margin_text(data, TUNED) == "delay margin 90 ms against 60 ms of best"
    assert not any("<" in line.replace("<=", "") for line in margin_table(data, TUNED))


def test_a_manual_vector_that_replans_as_it_is_gives_its_place_to_the_next(bench: Bench) -> None:
    found, _, _ = searched(bench, slow, tuned=0.04, best=0.1, second=0.05)
    assert found.margins["best"]["delay"].value == 0.0
    assert report(found, {"tuned": 0.1, "best": 0.2, "second": 0.3})["against"] == "second"
    found, _, _ = searched(bench, slow, tuned=0.04, best=0.1)
    data = report(found, {"tuned": 0.1, "best": 0.2})
    assert data["against"] is None and data["less"] == [] and "no manual vector" in margin_text(data, TUNED)


def test_failures_are_counted_inside_and_beyond_and_named(bench: Bench) -> None:
    def heavy(job: Job) -> tuple[str, int]:
        mass_kg = job.effects.get("payload", {}).get("mass_kg", 0.0)
        least = 0.15 if job.values["mrac.p"] > 0.02 else 0.25
        return ("left_lane" if mass_kg > least * MASS_KG and job.scenario.name == "tiny" else "finished"), 0

    found, _, _ = searched(bench, heavy, tuned=0.03, best=0.01)
    data = report(found, {"tuned": 0.1, "best": 0.2})
    tuned, best = data["vectors"]["tuned"], data["vectors"]["best"]
    assert (
        tuned["inside"]["failed"] == 3 and best["inside"]["failed"] == 0
    )  # alone, and twice with slow or quick actuators
    assert tuned["beyond"]["failed"] == best["beyond"]["failed"] == 3
    assert tuned["inside"]["drives"] == len(SCENARIOS) * sum(one["inside"] for one in tuned["points"])
    (alone,) = [one for one in tuned["points"] if one["what"] == "mass +20 %"]
    assert alone["failures"] == {"tiny": "left_lane"} and (alone["failed"], alone["drives"]) == (1, 2)
    words = margin_text(data, TUNED)
    assert words.startswith("but with less robustness within +/-20 % than best: 3 of ") and "0 of" in words
    (where,) = [line for line in margin_table(data, TUNED) if line.startswith("tuned fails in")]
    assert where.startswith("tuned fails in tiny (left_lane) with mass +20 %; mass +30 %; mass +20 %, lag -20 %")
    alike = report(searched(bench, heavy, tuned=0.03, best=0.04)[0], {"tuned": 0.1, "best": 0.2})
    assert alike["less"] == [] and "FAILS 3 of" in margin_text(alike, TUNED)


def test_the_gain_margin_goes_both_ways(bench: Bench) -> None:
    def touchy(job: Job) -> tuple[str, int]:
        return "finished", int(gain(job) > 1.47 or gain(job) < (0.72 if job.values["mrac.p"] > 0.02 else 0.52))

    data = report(searched(bench, touchy, tuned=0.03, best=0.01)[0], {"tuned": 0.1, "best": 0.2})
    tuned = data["vectors"]["tuned"]
    assert (tuned["gain_up"]["value"], tuned["gain_down"]["value"], tuned["delay"]["at_least"]) == (1.5, 0.7, True)
    assert [one["what"] for one in data["less"]] == ["gain_down"]
    assert "less steer gain margin downward than best: 0.70 against 0.50" in margin_text(data, TUNED)
    assert ">= 300 ms" in margin_table(data, TUNED)[1]


def test_the_data_are_what_the_document_says(bench: Bench, repo: Path) -> None:
    """Every key of "margins" stands in docs/reference/margins.md, and JSON can hold it."""
    found, _, _ = searched(bench, slow, tuned=0.03, best=0.01)
    data = json.loads(json.dumps(report(found, {"tuned": 0.1, "best": 0.2}), allow_nan=False))
    text = (repo / "docs" / "reference" / "margins.md").read_text()
    one = data["vectors"]["tuned"]
    keys = {
        *data,
        *data["limits"],
        *one,
        *one["delay"],
        *one["inside"],
        *one["points"][0],
        *one["points"][0]["factors"],
    }
    assert [key for key in sorted(keys) if f"`{key}`" not in text] == []
    assert len(one["points"]) == sum(len(cars) for cars in POINTS.values())
    assert data["same_as_bus"] == {"equal": 4, "of": 4}


def test_a_batch_that_does_not_agree_with_the_bus_is_found_out(bench: Bench) -> None:
    found, _, _ = searched(bench, slow, tuned=0.03, best=0.01)
    over_bus = {name: dict(scores) for name, scores in found.scores.items()}
    over_bus["best"]["tiny"] += 1e-15
    data = report(found, {"tuned": 0.1, "best": 0.2}, over_bus=over_bus)
    assert data["same_as_bus"] == {"equal": 3, "of": 4}


def test_a_drive_that_the_bench_ended_is_no_good_drive(bench: Bench) -> None:
    class Broken(MadeUp):
        def drive(self, jobs: Sequence[Job]) -> list[Driven]:
            return [one._replace(grade=None, error="bywire_fault") if gain(job) > 1.3 else one
                    for job, one in zip(jobs, super().drive(jobs), strict=True)]  # fmt: skip

    batch = Broken(slow)
    found, _ = ended(
        drive_margins(batch, bench, "mkz_nominal", vectors_of(bench, tuned=0.03), list(bench.scenarios.values()))
    )
    assert found.margins["tuned"]["gain_up"] == (1.35, False, "tiny", "bywire_fault")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"controller": ControllerSpec(command=["./pursuit"])}, "only our controller, not ./pursuit"),
        (
            {"faults": [FaultSpec(kind="drop", message="STEERING_CMD", from_tick=1, to_tick=2)]},
            "faults of the bench file (drop)",
        ),
    ],
)
def test_a_bench_that_no_batch_drives_has_no_margins_and_the_reason(
    bench: Bench, change: dict[str, Any], words: str
) -> None:
    other = Bench(
        with_fields(bench.spec, **change), bench.vehicle, bench.codec, bench.weights, bench.scenarios, bench.dt_s
    )
    reason, (warning,) = ended(find_margins(other, "mkz_nominal", vectors_of(other, tuned=0.03), []))
    assert words in reason and warning.kind == "warning" and "mkz_nominal" in warning.message
    data = report(reason, {"tuned": 0.1, "best": 0.2})
    assert data["vectors"]["tuned"]["delay"] is None and data["vectors"]["tuned"]["steering"] == STEERING
    assert margin_text(data, TUNED) == "" and margin_table(data, TUNED)[-1] == f"no margins: {reason}"
    json.dumps(data, allow_nan=False)


def test_what_the_batch_refuses_costs_the_margins_and_not_the_verification(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    for error in (InputError("an override is latched", code="not_in_batch"), PeerGone("batch", "it has ended")):

        class Refusing:
            def __init__(self, *_: Any, refusal: Exception = error, **__: Any) -> None:
                raise refusal

        monkeypatch.setattr(margins, "Batch", Refusing)
        reason, events = ended(find_margins(bench, "mkz_nominal", vectors_of(bench, tuned=0.03), []))
        assert error.code in reason and events[-1].kind == "warning"


def test_a_plant_without_what_is_changed_says_which_group_is_missing(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "plain.py").write_text(
        "from tunefree_hil.plant.reference import PLANT as full\n"
        "PLANT = full._replace(lags=(), dead_times=())\n"
    )  # fmt: skip
    folder = tmp_path / "models" / "own"
    folder.mkdir(parents=True)
    (folder / "model.toml").write_text(
        f'schema = "tunefree.model/1"\nvehicle = "mkz_bywire"\n[plant]\nkind = "{tmp_path}/plain.py:PLANT"\n'
    )
    batch = MadeUp(slow)
    found, _ = ended(drive_margins(batch, bench, "own", vectors_of(bench, tuned=0.03), list(bench.scenarios.values())))
    assert set(found.missing) == {"lag", "dead time", "together"} and not any(job.scale for job in batch.jobs)
    data = report(found, {"tuned": 0.1})
    assert {one["group"] for one in data["vectors"]["tuned"]["points"]} == {"mass", "friction", "steer gain"}
    assert any(line.startswith("lag: not driven") for line in margin_table(data, TUNED))


def test_steering_needs_its_column() -> None:
    ramp = make_recording({"cmd_steer_rad": np.linspace(0.0, 1.0, 101)}, 0.01)
    without = make_recording({"speed_mps": np.ones(101)}, 0.01)
    found = measure_steering([ramp, without])
    assert found is not None and found["rate_rms_radps"] == pytest.approx(1.0)
    assert measure_steering([without]) is None


def test_walks_begin_with_the_car_as_it_is() -> None:
    assert all(cars[0] == NOMINAL for cars in SWEEPS.values())
