"""Who is suspected: nobody of whom a car has no such part."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from tests.gap.made_answer import VEHICLE, late_drive, made_model
from tunefree_hil.base.contracts import Port
from tunefree_hil.config.schema import ActuatorSpec
from tunefree_hil.gap.estimation.candidates import NO_GYRO, suspects_of
from tunefree_hil.gap.measured.chain import open_chain
from tunefree_hil.gap.model.graph import UNHEARD, Graph, effects
from tunefree_hil.learn.drives.drive import CHASSIS_FIRST_YAW_RATES

OPENED = open_chain(late_drive(20.0), VEHICLE)
GYRO = ("yaw_rate_bias", "yaw_rate_filter", "yaw_rate_scale")


def asked(derived: Any) -> tuple[set[str], dict[str, str]]:
    graph = Graph(made_model(), VEHICLE, 0.01)
    some, cannot = suspects_of(graph, graph.model, VEHICLE, [OPENED, OPENED._replace(derived=derived)])
    return {one.name for one in some}, cannot


@pytest.mark.slow
def test_a_gyro_that_no_drive_has_is_not_suspected() -> None:
    names, cannot = asked({})
    assert set(GYRO) <= names and not cannot, "one of the drives has a gyro"
    graph = Graph(made_model(), VEHICLE, 0.01)
    by_wheels = OPENED._replace(derived={CHASSIS_FIRST_YAW_RATES[0]: 1})
    some, cannot = suspects_of(graph, graph.model, VEHICLE, [by_wheels, by_wheels])
    assert cannot == dict.fromkeys(GYRO, NO_GYRO) and not set(GYRO) & {one.name for one in some}
    mixed, _ = asked({CHASSIS_FIRST_YAW_RATES[0]: 1})
    assert set(GYRO) <= mixed


@pytest.mark.slow
def test_a_car_that_is_asked_for_an_acceleration_has_no_pedal_before_its_actuators() -> None:
    made = made_model()
    model = replace(made, actuators={"accel": ActuatorSpec(lag_s=0.3), "steer": made.actuators["steer"]})
    graph = Graph(model, VEHICLE, 0.01)
    deaf = {name for name, one in effects().items() if one.port in (Port.THROTTLE_A, Port.THROTTLE_OUT, Port.BRAKE_A)}
    assert deaf and graph.cannot == dict.fromkeys(deaf, UNHEARD) and not deaf & set(graph.can)
