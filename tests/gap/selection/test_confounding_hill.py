"""An accelerometer's offset that was there when the model was made may have been a hill all along."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from tests.gap.estimation.test_intervals import fitted
from tests.gap.selection.test_criteria import spread, weighed
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.gap.estimation.least_squares import Fit, FreeParameter
from tunefree_hil.gap.selection.baseline_misfit import NO_BASELINE, BaselineMisfit
from tunefree_hil.gap.selection.confounding import ACCEL_BIAS, GRADE, ROLLING_KEY, add_grade_equivalent
from tunefree_hil.gap.selection.criteria import GRADE_CRITERIA

FREE = FreeParameter("accel_bias.bias_mps2", -0.5, 0.5, False, 0.0, -0.35, 1.35)
STEP = weighed(accel_bias=spread(1.0))[0]


def found(bias_mps2: float) -> Fit:
    return fitted(FREE, z=FREE.u_from_value(bias_mps2))


def own(bias_mps2: float) -> BaselineMisfit:
    return NO_BASELINE._replace(explaining={ACCEL_BIAS: {"bias_mps2": (bias_mps2, 0.001)}})


def model(rolling_frac: float) -> ModelSpec:
    nominal = load_model("mkz_nominal")
    return replace(nominal, plant=replace(nominal.plant, params={ROLLING_KEY: rolling_frac}))


@pytest.mark.parametrize(
    ("bias_mps2", "rolling_frac", "rival"),
    [
        (0.118, 0.0235, True),  # it would be an ordinary tyre without the hill
        (0.051, 0.0144, True),  # nobody knows a tyre that well
        (0.226, 0.0107, False),  # less than nothing would be left
        (-0.296, 0.012, False),  # and here far more than any tyre's
        (0.05, 0.0, False),  # a model that has no rolling resistance
    ],
)
def test_a_hill_is_a_rival_where_the_rolling_resistance_may_hold_it(
    bias_mps2: float, rolling_frac: float, rival: bool
) -> None:
    (said,) = add_grade_equivalent([STEP], found(bias_mps2), own(bias_mps2), model(rolling_frac))
    assert (GRADE in said.equivalents) == rival


def test_a_net_may_have_taken_in_any_hill_and_a_plant_of_physics_has_the_ordinary_tyre() -> None:
    bare = replace(model(0.0).plant, params={})
    for kind, bias_mps2, rival in (("lstm", -0.4, True), ("physics", -0.4, False), ("physics", 0.05, True)):
        made = replace(model(0.0), plant=replace(bare, kind=kind))
        (said,) = add_grade_equivalent([STEP], found(bias_mps2), own(bias_mps2), made)
        assert (GRADE in said.equivalents) == rival


def test_an_offset_that_came_after_the_model_is_one() -> None:
    bias = 0.118
    for usual in (NO_BASELINE, own(bias * (1.0 + 1.5 * GRADE_CRITERIA.same_offset_share)), own(-bias)):
        assert add_grade_equivalent([STEP], found(bias), usual, model(0.0235)) == [STEP]
    other = STEP._replace(name="brake_gain")
    assert add_grade_equivalent([other], found(bias), own(bias), model(0.0235)) == [other]
