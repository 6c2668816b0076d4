"""Builds once, before any process starts, what the nodes will build: who started it is told of a mistake."""

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
    """Raise InputError for a model, effect, fault, controller part or scenario that cannot be had. About 0.1 s.

    Somebody else's controller has no MRAC of ours: what that lacks of the vehicle is then no mistake.
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
