"""What recalibration may move, and what is said where it had to move far."""

from __future__ import annotations

from tunefree_hil.gap.null import TAKEN, taken


def test_what_recalibration_had_to_move_far_is_told_the_farthest_first() -> None:
    keys, z = ("brake_gain.gain_frac", "grade.grade_rad", "plant.drive_force_n"), (TAKEN + 0.1, -0.4, -3.0)
    assert taken(keys, z) == (
        "recalibration moves plant.drive_force_n by -3.0 standard deviations",
        f"recalibration moves brake_gain.gain_frac by {TAKEN + 0.1:+.1f} standard deviations",
    )


def test_what_stays_near_is_not_told() -> None:
    assert taken(("a",), (TAKEN,)) == () and taken((), ()) == ()
