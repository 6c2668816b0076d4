"""Every effect on both vehicles' folders: neutral it changes no bit of what their frames say, typical it does."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import pytest

from tests.effects.shared import EFFECTS, same
from tests.house import ROOT
from tests.other_vehicle import BENCH
from tunefree_hil.base.contracts import prior_of
from tunefree_hil.base.records import Disturbance
from tunefree_hil.bench import Bench, load
from tunefree_hil.bench.simulator import with_effects
from tunefree_hil.bench.vehicle import VehicleFor
from tunefree_hil.config.schema import EffectSpec
from tunefree_hil.plant.actuation.bywire import ReceivedChannel, ReceivedCommand
from tunefree_hil.plant.ecu import ReportedState, UnitInput

BENCHES = {"first": ROOT / "bench_configs" / "mkz_complete.toml", "other": BENCH}
TICKS = 160


@cache
def bench_of(which: str) -> Bench:
    return load(BENCHES[which])


def typical(bench: Bench, name: str) -> dict[str, float]:
    """Values of the vehicle's own size."""
    limits, nominal = bench.vehicle.limits, bench.vehicle.nominal
    sizes = {"steer_rad": limits.steer_rad, "mass_kg": nominal.mass_kg, "wheelbase_m": nominal.wheelbase_m}
    known = {key: float(value) for key, value in sizes.items() if value is not None}
    return {key: prior_of(EFFECTS[name], key, known).typical for key in EFFECTS[name].neutral}


def said(which: str, name: str, params: dict[str, float]) -> list[ReportedState]:
    """What the frames say of rough driving from the first scenario's start; no effect where the name is ''."""
    bench = bench_of(which)
    rest, limits = bench.vehicle.nominal.rest_pedal_frac, bench.vehicle.limits
    bench = with_effects(bench, [EffectSpec(name=name, params=params)] if name else [])
    scenario = bench.scenarios[bench.spec.scenarios[0]]
    car = VehicleFor(bench, bench.spec.model)(bytes.fromhex(scenario.hash)[:6], 1)
    body: Any = car.body
    chassis = body.block.params.chassis
    fast = chassis._replace(start=chassis.start._replace(speed_mps=9.0))
    body = body._replace(block=body.block._replace(params=body.block.params._replace(chassis=fast)))
    params_of, state, now = car.unit.start(body, bench.dt_s)
    found = [now]
    for k in range(TICKS):
        throttle, brake = (limits.throttle_frac, rest) if k < 90 else (rest, rest + 0.15)
        steer = ReceivedChannel(0.8 * limits.steer_rad * math.sin(0.04 * k), 1.0, fresh=1.0)
        heard = ReceivedCommand(steer._replace(value=throttle), steer._replace(value=brake), steer)
        state, now = car.unit.step(params_of, state, UnitInput(heard, car.driver(k), Disturbance()), bench.dt_s)
        found.append(now)
    return found


@cache
def without(which: str) -> list[ReportedState]:
    return said(which, "", {})


@pytest.mark.parametrize("which", BENCHES)
@pytest.mark.parametrize("name", EFFECTS)
def test_neutral_is_nothing_and_typical_is_something(which: str, name: str) -> None:
    assert same(said(which, name, {}), without(which))
    assert not same(said(which, name, typical(bench_of(which), name)), without(which))
    assert without(which)[-1].measurement.report.speed_mps > 1.0, "the car drives"
