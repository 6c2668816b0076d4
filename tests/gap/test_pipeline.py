"""The whole search on drives whose truth is known: a car with and without something that its model lacks."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from tests.learn.made_drives import CHANNELS, made_drive
from tunefree_hil.base.contracts import Link
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.config.schema import ActuatorSpec, ModelSpec
from tunefree_hil.gap.measured.chain import build_measured_drive
from tunefree_hil.gap.model.graph import load_catalogue
from tunefree_hil.gap.pipeline import Diagnosis, diagnose
from tunefree_hil.gap.result import answer_entries
from tunefree_hil.gap.selection.candidate_reasons import in_order
from tunefree_hil.gap.selection.reasons import RejectionStage, VerdictKind

pytestmark = [pytest.mark.slow, pytest.mark.compiled, pytest.mark.timeout(900)]  # two processes that compile first


def model() -> ModelSpec:
    """A model of the made car as it is without anything hidden."""
    own = {
        channel: ActuatorSpec(dead_time_s=one.dead_time_s, lag_s=one.lag_s, rate_limit=one.rate_limit)
        for channel, one in CHANNELS.items()
    }
    nominal = load_model("mkz_nominal")
    return replace(nominal, actuators=own, plant=replace(nominal.plant, kind="physics", params={}, card=""), effects=[])


def asked(seconds: float, **hidden: Any) -> Diagnosis:
    vehicle = load_vehicle("mkz_bywire")
    search = diagnose(model(), vehicle, [build_measured_drive(made_drive(seconds, seed=5, **hidden), vehicle)])
    while True:
        try:
            next(search)
        except StopIteration as end:
            return end.value


def unnamed_without_a_reason(found: Diagnosis) -> set[str]:
    """Effects of the catalogue that gap.json neither names nor has a reason for."""
    answer = answer_entries(found)
    reasons = {entry["name"] for entry in answer["reasons"]}
    return set(load_catalogue()) - set(found.verdict.names) - reasons


def test_a_car_as_its_model_has_it_misses_nothing() -> None:
    found = asked(110.0)
    assert found.verdict.kind is VerdictKind.NONE_MISSING and not found.effects and found.link is None
    assert not unnamed_without_a_reason(found)


def test_a_steering_that_answers_later_is_named_with_its_value_and_link() -> None:
    late = CHANNELS["steer"]._replace(dead_time_s=CHANNELS["steer"].dead_time_s + 0.07)
    found = asked(110.0, channels={**CHANNELS, "steer": late})
    assert found.verdict.kind is VerdictKind.ONE and found.verdict.names == ("steer_dead_time",)
    (effect,) = found.effects
    delay = effect.params["delay_s"]
    assert effect.name == "steer_dead_time" and delay.value == pytest.approx(0.07, abs=0.005) and delay.unit == "s"
    assert delay.low < delay.value < delay.high
    assert (
        found.link is Link.COMMAND_TO_REPORT
        and found.location is not None
        and found.location.residual.signal == "steer"
    )
    assert not unnamed_without_a_reason(found)
    assert RejectionStage.SCREENING in {reason.stage for reason in found.rejected_candidates}
    assert list(found.rejected_candidates) == list(in_order(found.rejected_candidates))
    assert found.candidates[0].name == "steer_dead_time" and found.excitation["steer_dead_time"].is_sufficient


def test_who_is_not_asked_is_told_before_anybody_waits() -> None:
    with pytest.raises(InputError, match="5 blocks of 5 s"):
        asked(30.0)
