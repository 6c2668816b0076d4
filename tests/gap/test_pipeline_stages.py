"""`--until locate` refuses what `name` refuses, in the same words."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.gap.made_answer import VEHICLE, made_model
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GEAR_DRIVE
from tunefree_hil.gap.measured.chain import MeasuredDrive
from tunefree_hil.gap.pipeline import diagnose, locate

DT_S = 0.01


def drive(seconds: float, moving_s: float) -> MeasuredDrive:
    """What is looked at before anything is searched: a car that stands, but for its first seconds."""
    ticks = round(seconds / DT_S)
    speed = np.where(np.arange(ticks) * DT_S < moving_s, 8.0, 0.0)
    inputs = SimpleNamespace(speed_mps=speed, gear=np.full(ticks, GEAR_DRIVE), uses_ins_speed=False)
    opened = SimpleNamespace(ticks=ticks, dt_s=DT_S, inputs=inputs, is_moving=speed > 0.1, size_scale=1.0, signals={})
    return cast(MeasuredDrive, opened)


def refusal(search: Callable[..., Any], one: MeasuredDrive) -> InputError:
    with pytest.raises(InputError) as caught:
        next(search(made_model(), VEHICLE, [one]))
    return caught.value


@pytest.mark.parametrize(("seconds", "moving_s", "code"), [(40.0, 40.0, "too_short"), (120.0, 50.0, "standing")])
def test_a_short_log_and_a_standing_car_are_refused_as_by_name(seconds: float, moving_s: float, code: str) -> None:
    first, second = (refusal(search, drive(seconds, moving_s)) for search in (locate, diagnose))
    assert first.code == code
    assert (first.message, first.hint, first.key) == (second.message, second.hint, second.key)
