"""What a car forgets need not be driven again: lags are forgotten, play, friction and heat are not."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from tests.gap.made_answer import LATE_S, VEHICLE, late_drive, made_model
from tunefree_hil.base.contracts import make_effect
from tunefree_hil.config.schema import EffectSpec, ModelSpec
from tunefree_hil.gap.measured.blocks import SELECTION
from tunefree_hil.gap.measured.chain import MeasuredDrive, build_measured_drive
from tunefree_hil.gap.model.graph import load_catalogue
from tunefree_hil.gap.validation.block_runs import BlockErrors, Variant, run_blocks
from tunefree_hil.gap.validation.free_run import WARM_UP_S, assemble_car, forgets_disturbance, rows_to_simulate

DT_S = 0.01


@cache
def opened() -> MeasuredDrive:
    return build_measured_drive(late_drive(), VEHICLE)


@pytest.mark.parametrize(("name", "params", "forgets"), [
    ("steer_lag", {"tau_s": 0.2}, True), ("steer_lag", {"tau_s": 2.0}, False),
    ("steer_dead_time", {"delay_s": 0.3}, True), ("steer_dead_time", {"delay_s": 4.0}, False),
    ("steer_backlash", {"width_rad": 0.05}, False),
    ("report_latency", {"delay_s": 0.1}, True), ("yaw_rate_filter", {"tau_s": 3.0}, False), ("grade", {}, True),
    ("ins_latency", {"delay_s": 0.1}, True), ("speed_scale", {"scale_frac": 1.01}, True),
])  # fmt: skip
def test_what_is_driven_to_either_side_says_the_same_after_a_while_or_not(
    name: str, params: dict[str, float], forgets: bool
) -> None:
    effect = load_catalogue()[name]
    assert forgets_disturbance(make_effect(effect, params), effect.port, 0.0, DT_S) is forgets


def test_rows_are_needed_before_what_is_free_and_no_earlier() -> None:
    held = np.ones(2000, dtype=bool)
    held[900:1000] = held[1900:] = False
    rows, warm = rows_to_simulate(held, DT_S), round(WARM_UP_S / DT_S)
    wanted = np.zeros(2000, dtype=bool)
    wanted[900 - warm : 1000] = wanted[1900 - warm :] = True
    assert np.array_equal(rows, wanted)
    assert (
        not rows_to_simulate(np.ones(50, dtype=bool), DT_S).any()
        and rows_to_simulate(np.zeros(50, dtype=bool), DT_S).all()
    )


def with_effect(name: str, **params: float) -> ModelSpec:
    return replace(made_model(), effects=[EffectSpec(name=name, params=params)])


def test_a_car_that_keeps_something_is_known() -> None:
    kinds = {
        "nothing": made_model(), "late": with_effect("steer_dead_time", delay_s=LATE_S),
        "hot": with_effect("brake_fade", **{next(iter(load_catalogue()["brake_fade"].neutral)): 0.1}),
        "loose": with_effect("steer_backlash", **dict.fromkeys(load_catalogue()["steer_backlash"].neutral, 0.05)),
    }  # fmt: skip
    found = {name: assemble_car(model, VEHICLE, opened()).has_short_memory for name, model in kinds.items()}
    assert found == {"nothing": True, "late": True, "hot": False, "loose": False}


@pytest.mark.slow
@pytest.mark.parametrize("model", [made_model(), with_effect("steer_lag", tau_s=0.2)])
def test_brief_runs_say_of_the_blocks_what_whole_ones_say(model: ModelSpec) -> None:
    def run(*, brief: bool) -> BlockErrors:
        return run_blocks({"": Variant(model)}, VEHICLE, [opened()], role=SELECTION, skip_forgotten=brief)

    whole, brief = run(brief=False), run(brief=True)
    assert whole.n_blocks == brief.n_blocks > 0
    for signal, squares in whole.squared_errors[""].items():
        assert brief.squared_errors[""][signal] == pytest.approx(squares, rel=2e-3, abs=1e-9), signal
