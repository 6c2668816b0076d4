"""A steering offset that a calibration had put down for a banked road goes once the bank is named: it is no name."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from tests.gap.estimation.test_intervals import ALL, fitted
from tests.gap.selection.test_criteria import spread, weighed
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import EffectSpec, ModelSpec
from tunefree_hil.gap.estimation.least_squares import FreeParameter
from tunefree_hil.gap.result_text import reason_text
from tunefree_hil.gap.selection.criteria import CandidateScore
from tunefree_hil.gap.selection.rejection import drop_absorbed_effects

OFFSET = FreeParameter("steer_offset.offset_rad", -0.05, 0.05, False, 0.0, -0.35, 1.35)
BANK, BACK = (weighed(**{name: spread(1.0)})[0] for name in ("road_bank", "steer_offset"))
ALONE = weighed(road_bank=spread(1.0), steer_offset=spread(8.0))  # the offset is no name by itself
WORDS = ("steer_offset of the model goes: its calibration had put it in for road_bank",)


def model(offset_rad: float, **provenance: str) -> ModelSpec:
    one = EffectSpec(name="steer_offset", params={"offset_rad": offset_rad}, provenance=dict(provenance))
    return replace(load_model("mkz_nominal"), effects=[one])


def asked(
    made: ModelSpec,
    offset_rad: float,
    steps: tuple[CandidateScore, ...] = (BANK, BACK),
    first: list[CandidateScore] = ALONE,
) -> tuple[list[str], tuple[str, ...]]:
    found = fitted(OFFSET, curve=1e4, z=OFFSET.u_from_value(offset_rad))
    stay, words = drop_absorbed_effects(steps, first, found, made, ALL)
    return [one.name for one in stay], tuple(reason_text(reason) for reason in words)


@pytest.mark.parametrize("back", [-0.01, -0.0104, -0.0096])
def test_what_the_calibration_put_down_to_the_wrong_cause_is_no_name(back: float) -> None:
    assert asked(model(0.01), back) == (["road_bank"], WORDS)


@pytest.mark.parametrize("offset_rad", [0.01, -0.02, -0.005, -0.0075])
def test_an_offset_that_does_not_leave_nothing_is_a_name(offset_rad: float) -> None:
    assert asked(model(0.01), offset_rad) == (["road_bank", "steer_offset"], ())


def test_a_model_without_it_an_offset_that_shows_alone_and_one_that_gap_named_are_kept() -> None:
    both = ["road_bank", "steer_offset"]
    assert asked(load_model("mkz_nominal"), -0.01) == (both, ())
    assert asked(model(0.01, log="sha256:1"), -0.01) == (both, ()), "that was evidence"
    assert asked(model(0.01, by="recalibration"), -0.01) == (["road_bank"], WORDS)
    seen = weighed(road_bank=spread(1.0), steer_offset=spread(1.2))
    assert asked(model(0.01), -0.01, first=seen) == (both, ()), "it went, whoever else came"
    assert asked(model(0.01), -0.01, steps=(BACK,)) == (["steer_offset"], ()), "beside nobody"
    doubtful = BACK._replace(equivalents=("side_wind",))
    assert asked(model(0.01), -0.01, steps=(BANK, doubtful)) == (both, ())


def test_what_is_hardly_there_is_not_called_gone() -> None:
    """Less than the logs can tell: any value would leave nothing of it."""
    found = fitted(OFFSET, differ=3.0, curve=2.0, z=OFFSET.u_from_value(-0.001))
    stay, words = drop_absorbed_effects((BANK, BACK), ALONE, found, model(0.001), np.asarray(ALL))
    assert len(stay) == 2 and words == ()


def test_the_grip_that_own_logs_put_beside_a_model_is_nothing_that_its_folder_has() -> None:
    """repair.moved"""
    grip = FreeParameter("friction.friction_frac", 0.3, 1.5, True, 1.0, -0.2, 1.2)
    road = weighed(friction=spread(1.0))[0]
    alone = weighed(road_bank=spread(1.0), friction=spread(8.0))
    found = fitted(grip, curve=1e4, z=grip.u_from_value(1.0 / 1.2))
    for by, stays in (({"by": "recalibration"}, True), ({"by": "own logs"}, False)):
        one = EffectSpec(name="friction", params={"friction_frac": 1.2}, provenance=by)
        has = replace(load_model("mkz_nominal"), effects=[one])
        stay, words = drop_absorbed_effects((BANK, road), alone, found, has, ALL)
        assert ("friction" in [one.name for one in stay]) is stays and (words == ()) is stays
