"""`auto` chooses by the task alone, is resolved before the study is made, and says what it chose."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.bench.tiny import write_bench
from tunefree_hil.jobs.options.records import TuneOptions
from tunefree_hil.jobs.tune.folder import open_run_folder
from tunefree_hil.jobs.tune.options import TunePlan, make_tune_plan
from tunefree_hil.tune.sampling.automatic_choice import (
    ChoiceReason,
    SearchTask,
    choose_sampler,
    describe_choice,
)
from tunefree_hil.tune.sampling.records import BY_NAME

TASKS = st.builds(
    SearchTask,
    trials=st.integers(1, 2000),
    parameters=st.integers(1, 40),
    objectives=st.integers(1, 3),
    is_batch=st.booleans(),
    has_requirements=st.booleans(),
)


@given(TASKS)
def test_the_choice_can_do_the_task(task: SearchTask) -> None:
    choice = choose_sampler(task)
    record = BY_NAME[choice.sampler]
    assert not record.module
    assert task.objectives == 1 or record.objectives
    text = describe_choice(choice, task)
    assert choice.sampler in text and "auto" in text


@pytest.mark.parametrize(
    ("task", "sampler", "reason"),
    [
        (SearchTask(40, 11), "trust_region", ChoiceReason.FEW_TRIALS),
        (SearchTask(400, 11), "trust_region", ChoiceReason.FEW_TRIALS),
        (SearchTask(199, 11, is_batch=True, has_requirements=True), "trust_region", ChoiceReason.FEW_TRIALS),
        (SearchTask(200, 11, has_requirements=True), "trust_region", ChoiceReason.FEW_TRIALS),
        (SearchTask(200, 11, is_batch=True, has_requirements=True), "tpe_cma", ChoiceReason.MANY_TRIALS),
        (SearchTask(800, 11), "tpe_cma", ChoiceReason.MANY_TRIALS),
        (SearchTask(800, 2), "tpe_independent", ChoiceReason.FEW_PARAMETERS),
        (SearchTask(100, 11, objectives=2), "tpe_independent", ChoiceReason.SEVERAL_OBJECTIVES),
        (SearchTask(1000, 11, objectives=2), "nsga", ChoiceReason.SEVERAL_OBJECTIVES),
    ],
)
def test_the_rule(task: SearchTask, sampler: str, reason: ChoiceReason) -> None:
    assert choose_sampler(task) == (sampler, reason)


def plan(folder: Path, **more: Any) -> TunePlan:
    return make_tune_plan(TuneOptions(write_bench(folder), out=folder / "runs", sampler="auto", **more))


def test_a_run_has_the_chosen_sampler_and_the_reason(tmp_path: Path) -> None:
    resolved = plan(tmp_path, trials=10)
    assert resolved.settings.sampler == "trust_region" and "trust_region" in resolved.sampler_text
    with open_run_folder(resolved) as (run, _):
        record = json.loads((run.path / "run.json").read_text())
    assert record["settings"]["sampler"] == record["options"]["sampler"] == "trust_region"
    assert record["sampler_choice"] == {"sampler": "trust_region", "reason": "few_trials"}


def test_a_resumed_run_keeps_the_sampler_whatever_auto_would_choose_now(tmp_path: Path) -> None:
    with open_run_folder(plan(tmp_path, trials=10)) as (run, _):
        pass
    assert plan(tmp_path, trials=800).settings.sampler != "trust_region"
    for trials in (None, 800):
        resumed = make_tune_plan(TuneOptions(resume=run.path, trials=trials))
        assert resumed.settings.sampler == "trust_region" and resumed.sampler_choice is None
    record = json.loads((run.path / "run.json").read_text())
    del record["options"]  # a run of an earlier version
    (run.path / "run.json").write_text(json.dumps(record))
    assert make_tune_plan(TuneOptions(resume=run.path, trials=800)).settings.sampler == "trust_region"
