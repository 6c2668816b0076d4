"""What recalibration may move, and what is said where it had to move far."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_model
from tunefree_hil.gap.null import TAKEN, card_of, doubts_of, taken


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
