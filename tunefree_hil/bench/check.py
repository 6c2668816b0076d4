"""Builds the parts of the nodes once before any process starts, so that mistakes are found early."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from tunefree_hil.bench.controller import ControllerFor
from tunefree_hil.bench.load import Bench
from tunefree_hil.bench.vehicle import VehicleFor
from tunefree_hil.config.schema import ScenarioSpec


def require_buildable(
    bench: Bench, model: str, scenarios: Sequence[ScenarioSpec], values: Mapping[str, float], *, realtime: bool = False
) -> None:
    """Raise InputError for a model, effect, fault, controller part or scenario that cannot be built. About 0.1 s.

    An external controller has no MRAC, so the vehicle need not fulfil its needs.
    """
    if bench.spec.controller.command:
        values = {**values, "mrac.enable": 0.0}
    for scenario in scenarios:
        bench.course(scenario)
    VehicleFor(bench, model, realtime=realtime)
    if scenarios:
        changed = replace(bench, scenarios={scenario.name: scenario for scenario in scenarios})
        start = bytes.fromhex(scenarios[0].hash)[:6]
        controller = ControllerFor(changed)
        controller(start, controller.indexed(values))
