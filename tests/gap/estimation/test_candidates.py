"""Candidate effects: none for parts that a car does not have."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from tests.gap.made_answer import VEHICLE, late_drive, made_model
from tunefree_hil.base.contracts import Port
from tunefree_hil.config.schema import ActuatorSpec
from tunefree_hil.gap.estimation.candidates import build_candidates
from tunefree_hil.gap.measured.chain import build_measured_drive
from tunefree_hil.gap.model.graph import NO_PEDAL, EffectGraph, load_catalogue
from tunefree_hil.gap.result_text import reason_text
from tunefree_hil.gap.selection.reasons import Criterion, RejectionStage
from tunefree_hil.learn.drives.drive import CHASSIS_FIRST_YAW_RATES

OPENED = build_measured_drive(late_drive(20.0), VEHICLE)
GYRO = ("yaw_rate_bias", "yaw_rate_filter", "yaw_rate_scale")


def asked(derived: Any) -> tuple[set[str], dict[str, Any]]:
    graph = EffectGraph(made_model(), VEHICLE, 0.01)
    some, cannot = build_candidates(graph, graph.model, VEHICLE, [OPENED, OPENED._replace(derived_ticks=derived)])
    return {one.name for one in some}, cannot


@pytest.mark.slow
def test_a_gyro_that_no_drive_has_gives_no_candidates() -> None:
    names, cannot = asked({})
    assert set(GYRO) <= names and not cannot, "one of the drives has a gyro"
    graph = EffectGraph(made_model(), VEHICLE, 0.01)
    by_wheels = OPENED._replace(derived_ticks={CHASSIS_FIRST_YAW_RATES[0]: 1})
    some, cannot = build_candidates(graph, graph.model, VEHICLE, [by_wheels, by_wheels])
    assert set(cannot) == set(GYRO) and not set(GYRO) & {one.name for one in some}
    for name, reason in cannot.items():
        assert (reason.criterion, reason.name, reason.stage) == (Criterion.NO_SENSOR, name, RejectionStage.UNTESTABLE)
        assert reason_text(reason) == "no gyro: the yaw rate of the chassis is computed from its wheel speeds"
    mixed, _ = asked({CHASSIS_FIRST_YAW_RATES[0]: 1})
    assert set(GYRO) <= mixed


@pytest.mark.slow
def test_a_car_driven_by_acceleration_requests_has_no_pedal_effects() -> None:
    made = made_model()
    model = replace(made, actuators={"accel": ActuatorSpec(lag_s=0.3), "steer": made.actuators["steer"]})
    graph = EffectGraph(model, VEHICLE, 0.01)
    deaf = {
        name for name, one in load_catalogue().items() if one.port in (Port.THROTTLE_A, Port.THROTTLE_OUT, Port.BRAKE_A)
    }
    assert deaf and graph.unsupported == dict.fromkeys(deaf, NO_PEDAL) and not deaf & set(graph.supported)
    _, cannot = build_candidates(graph, model, VEHICLE)
    assert set(cannot) == deaf
    assert {(reason.criterion, reason_text(reason)) for reason in cannot.values()} == {
        (Criterion.UNSUPPORTED, NO_PEDAL)
    }
