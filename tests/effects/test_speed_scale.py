"""Speed sensors: speed and wheel speeds by the same factor, and nothing else."""

from __future__ import annotations

import pytest

from tests.effects.shared import driven, motions, reports, same

FIELDS = ("speed_mps", "wheel_fl_radps", "wheel_fr_radps", "wheel_rl_radps", "wheel_rr_radps")


def test_only_its_own_fields_change() -> None:
    with_it, without = driven("physics", {"speed_scale": {"scale_frac": 0.95}}), driven("physics", {})
    assert motions(with_it) == motions(without)
    for seen, plain in zip(reports(with_it), reports(without), strict=True):
        for field, value in plain._asdict().items():
            told = getattr(seen, field)
            if field in FIELDS:
                assert told == pytest.approx(0.95 * value, abs=1e-12)
            else:
                assert same(told, value)
