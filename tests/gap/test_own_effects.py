"""A model's own [[effects]] in the graph: what a repair has written is to the search what it was as a candidate."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from tests.learn.made_drives import made_drive
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.config.schema import EffectSpec
from tunefree_hil.gap.measured.chain import MeasuredDrive, build_measured_drive
from tunefree_hil.gap.model.graph import EffectGraph

pytestmark = pytest.mark.slow  # the plant step by step


@cache
def drive() -> MeasuredDrive:
    return build_measured_drive(made_drive(4.0), load_vehicle("mkz_bywire"))


def graph(*own: EffectSpec) -> EffectGraph:
    model = load_model("mkz_nominal")
    plant = replace(model.plant, kind="physics", params={}, card="")
    return EffectGraph(replace(model, plant=plant, effects=list(own)), load_vehicle("mkz_bywire"), drive().dt_s)


@pytest.mark.parametrize(
    ("name", "parameter", "value"),
    [
        ("report_latency", "delay_s", 0.06),
        ("ins_latency", "delay_s", 0.08),
        ("steer_report_offset", "offset_rad", 0.02),
        ("speed_scale", "scale_frac", 0.97),
        ("steer_dead_time", "delay_s", 0.1),
    ],
)
def test_an_effect_of_the_models_own_is_what_it_was_as_a_candidate(name: str, parameter: str, value: float) -> None:
    x = drive().inputs
    own = graph(EffectSpec(name=name, params={parameter: value})).simulate(x, {})
    tried = graph().simulate(x, {f"{name}.{parameter}": value})
    assert not np.array_equal(tried, graph().simulate(x, {}))
    assert own == pytest.approx(tried, rel=1e-9, abs=1e-12)


def test_the_same_effect_again_is_beyond_the_models_own() -> None:
    x = drive().inputs
    once = graph(EffectSpec(name="report_latency", params={"delay_s": 0.04}))
    twice = graph().simulate(x, {"report_latency.delay_s": 0.08})
    assert once.simulate(x, {"report_latency.delay_s": 0.04}) == pytest.approx(twice, rel=1e-6, abs=1e-6)
