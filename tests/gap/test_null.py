"""What recalibration may move, and what is said where it had to move far."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from msgspec.structs import replace

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.gap.graph import Graph
from tunefree_hil.gap.null import CONSTANTS, MOST_DOUBT, TAKEN, card_of, doubts_of, nuisances, taken


def test_what_recalibration_had_to_move_far_is_told_the_farthest_first() -> None:
    keys, z = ("brake_gain.gain_frac", "grade.grade_rad", "plant.drive_force_n"), (TAKEN + 0.1, -0.4, -3.0)
    assert taken(keys, z) == (
        "recalibration moves plant.drive_force_n by -3.0 standard deviations",
        f"recalibration moves brake_gain.gain_frac by {TAKEN + 0.1:+.1f} standard deviations",
    )


def test_what_stays_near_is_not_told() -> None:
    assert taken(("a",), (TAKEN,)) == () and taken((), ()) == ()


@pytest.mark.parametrize("text", ["no json", "[1, 2]", '{"constants": 3}'])
def test_a_card_that_is_none_is_an_input_error_whoever_reads_it(tmp_path: Path, text: str) -> None:
    model = load_model("mkz_nominal")
    model = replace(model, folder=str(tmp_path), plant=replace(model.plant, card="card.json"))
    assert card_of(model) == {} and doubts_of(model) == {}, "none there"
    (tmp_path / "card.json").write_text(text)
    with pytest.raises(InputError) as refused:
        doubts_of(model)
    assert refused.value.code == "bad_card" and "card.json" in str(refused.value.file)


def test_what_a_calibration_left_open_may_be_recalibrated_but_no_licence_comes_of_it(tmp_path: Path) -> None:
    model, vehicle = load_model("mkz_nominal"), load_vehicle("mkz_bywire")
    model = replace(model, folder=str(tmp_path), plant=replace(model.plant, card="card.json"))
    ends = {"brake_force_n_per_frac": 0.04, "yaw_inertia_kgm2": 2.0, "drive_force_n": 0.5}  # logarithms, 95 %
    said = {name: {"low": math.exp(-by), "high": math.exp(by)} for name, by in ends.items()}
    (tmp_path / "card.json").write_text(json.dumps({"constants": said}))
    found = {one.key: one.sigma for one in nuisances(Graph(model, vehicle, 0.01), model, doubts_of(model))}
    assert 0.04 / 1.96 < found["brake_gain.gain_frac"] < 2.0 * 0.04 / 1.96
    assert found["plant.yaw_inertia_kgm2"] == MOST_DOUBT
    assert found["plant.drive_force_n"] == CONSTANTS["drive_force_n"], "it is known together with the knee"
