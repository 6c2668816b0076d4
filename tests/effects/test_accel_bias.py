"""An accelerometer's bias, along the car only."""

from __future__ import annotations

import pytest

from tests.effects.shared import driven, motions, reports, same

FIELDS = ("accel_mps2",)


def test_only_its_own_fields_change() -> None:
    with_it, without = driven("physics", {"accel_bias": {"bias_mps2": 0.2}}), driven("physics", {})
    assert motions(with_it) == motions(without)
    for seen, plain in zip(reports(with_it), reports(without), strict=True):
        for field, value in plain._asdict().items():
            told = getattr(seen, field)
            if field in FIELDS:
                assert told == pytest.approx(value + 0.2, abs=1e-12)
            else:
                assert same(told, value)
