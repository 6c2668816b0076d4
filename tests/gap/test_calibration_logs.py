"""What a model's own logs tell of an effect: nothing if they do not determine it; a limit then lies beyond them."""

from __future__ import annotations

from collections.abc import Generator
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import pytest
from msgspec.structs import replace

from tests.gap.estimation.test_intervals import ALL, DELAY, fitted
from tests.gap.made_answer import VEHICLE, made_model
from tests.gap.selection.test_criteria import spread, weighed
from tunefree_hil.config.schema import EffectSpec
from tunefree_hil.gap import calibration_logs
from tunefree_hil.gap.calibration_logs import known_parameters
from tunefree_hil.gap.estimation.intervals import estimates_across_blocks
from tunefree_hil.gap.estimation.least_squares import FreeParameter
from tunefree_hil.gap.progress import SearchProgress
from tunefree_hil.gap.selection.baseline_misfit import BaselineMisfit
from tunefree_hil.gap.selection.criteria import CandidateScore
from tunefree_hil.gap.selection.rejection import split_known_effects
from tunefree_hil.gap.workers.worker import FitSummary

LIMIT = FreeParameter("steer_rate_limit.rate_radps", 0.1, 20.0, True, float("inf"), -0.35, 1.35)
STEP = weighed(steer_rate_limit=spread(1.0))[0]


def model(free: FreeParameter, curve: float, z: float) -> FitSummary:
    return FitSummary(fitted(free, curve=curve, z=z), {})


@pytest.mark.parametrize("z", [0.2, 0.0])
def test_a_determined_parameter_is_known_as_well_as_the_fit_knows_it_even_at_neutral(z: float) -> None:
    summary = model(DELAY, 400.0, z)
    assert known_parameters("steer_dead_time", summary, ALL) == estimates_across_blocks(summary.fit, ALL)


def test_an_undetermined_parameter_is_not_known() -> None:
    assert known_parameters("steer_dead_time", model(DELAY, 0.0, 0.2), ALL) == {}


@pytest.mark.parametrize(("z", "is_new"), [(0.35, True), (0.75, False)])
def test_a_limit_below_all_that_the_own_logs_reached_is_new(z: float, is_new: bool) -> None:
    beyond = model(LIMIT, 0.0, 0.75)
    (limit,) = known_parameters("steer_rate_limit", beyond, ALL).items()
    assert limit == ("steer_rate_limit.rate_radps", (pytest.approx(LIMIT.value_from_u(0.75)), 0.0))
    effects = {"steer_rate_limit": {"rate_radps": limit[1]}}
    baseline = BaselineMisfit({STEP.target: 0.5}, effects, frozenset({STEP.target}))
    new, reasons = split_known_effects([STEP], fitted(LIMIT, z=z), baseline, ALL)
    assert bool(new) == is_new and bool(reasons) != is_new


class FakeProblem(NamedTuple):
    """An open problem without processes."""

    recalibrated: Any = None
    blocks: Any = None
    candidates: tuple[Any, ...] = (SimpleNamespace(name="tyre_relaxation"), SimpleNamespace(name="grade"))
    broken_targets: frozenset[str] | None = None


@pytest.mark.parametrize(
    ("target", "evidence", "has_effect", "is_found"),
    [
        ("yaw_rate", 900.0, False, True),
        ("yaw_rate", 50.0, False, False),
        ("rate_of_speed", 900.0, False, False),
        ("yaw_rate", 900.0, True, False),
    ],
)
def test_tyre_effects_are_found_with_plain_evidence_in_a_target_that_is_not_broken(
    target: str, evidence: float, has_effect: bool, is_found: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rate of speed is missed whatever the tyres are: an effect that explains a part of that is not found."""
    free = FreeParameter("tyre_relaxation.length_m", 0.05, 2.0, True, 0.0, -0.35, 1.35)
    score = weighed(tyre_relaxation=spread(1.0))[0]
    score = score._replace(model=model(free, 1e4, free.u_from_value(0.3)), evidence=evidence)

    def assess_model(*_: Any) -> tuple[Any, list[Any]]:
        return None, [SimpleNamespace(signal="rate_of_speed", is_broken=True)]

    def fit_and_score(context: Any, names: list[str], *_: Any) -> list[CandidateScore]:
        return [score._replace(is_unbroken=target not in context.problem.broken_targets)] if names else []

    pool = SimpleNamespace(open=lambda: FakeProblem(), close=lambda: None)
    monkeypatch.setattr(calibration_logs, "WorkerPool", lambda *_, **__: pool)
    monkeypatch.setattr(calibration_logs, "ProblemSpec", lambda *_: None)
    monkeypatch.setattr(calibration_logs, "non_holdout_blocks", lambda _: ALL)
    monkeypatch.setattr(calibration_logs, "assess_model", assess_model)
    monkeypatch.setattr(calibration_logs, "fit_and_score", fit_and_score)
    present = [EffectSpec(name="tyre_relaxation", params={"length_m": 0.3})] if has_effect else []
    car = replace(made_model(), effects=present)
    effects = finish(calibration_logs.find_tyre_effects(calibration_logs.CalibrationLogs(car, VEHICLE, [])))
    assert [effect.name for effect in effects] == (["tyre_relaxation"] if is_found else [])
    assert not is_found or effects[0].params["length_m"] == pytest.approx(0.3)


def finish(search: Generator[SearchProgress, None, list[EffectSpec]]) -> list[EffectSpec]:
    try:
        while True:
            next(search)
    except StopIteration as end:
        return cast(list[EffectSpec], end.value)
