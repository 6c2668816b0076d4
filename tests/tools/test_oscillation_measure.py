"""The independent check of the oscillation metric finds a regular swing, and neither noise nor steps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tools.measures._swing_check import CHECKED, alternation, strongest_swing
from tools.measures.oscillation import random_sets
from tunefree_hil.control.parameters import SETS, BoxChoice, tunable_in_box

DT_S = 0.01
WHEEL = next(row for row in CHECKED if row.column == "out_steer_rad")
T = np.arange(3000) * DT_S


def columns(wheel: Any, curvature: Any = 0.0) -> dict[str, Any]:
    return {
        "out_steer_rad": wheel,
        "ref_speed_mps": np.full(len(wheel), 18.0),
        "ref_curvature_1pm": np.broadcast_to(np.asarray(curvature, dtype=float), len(wheel)),
    }


@pytest.mark.parametrize("frequency_hz", [0.7, 1.4, 3.0])
def test_a_regular_swing_is_found(frequency_hz: float) -> None:
    swing = strongest_swing(columns(0.25 * np.sin(2.0 * math.pi * frequency_hz * T)), WHEEL, DT_S)
    assert swing.ratio == pytest.approx(0.5 / WHEEL.limit, rel=0.1)
    assert swing.frequency_hz == pytest.approx(frequency_hz, abs=0.1)


def test_noise_steps_and_what_the_reference_does_are_none() -> None:
    chance = np.random.default_rng(1)
    assert strongest_swing(columns(chance.normal(0.0, 0.01, 3000)), WHEEL, DT_S).ratio < 0.5
    assert strongest_swing(columns(np.where(T > 10.0, 0.5, 0.0)), WHEEL, DT_S).ratio < 0.5
    pulse = np.interp(T, [0.0, 10.0, 10.3, 12.0, 12.3], [0.0, 0.0, 0.5, 0.5, 0.0])
    assert strongest_swing(columns(pulse), WHEEL, DT_S).ratio < 0.5
    slow = np.sin(2.0 * math.pi * 0.35 * T)
    assert strongest_swing(columns(slow), WHEEL, DT_S).ratio == 0.0, "below the band"
    slalom = np.sin(2.0 * math.pi * 0.8 * T)
    assert strongest_swing(columns(0.5 * slalom, 0.01 * slalom), WHEEL, DT_S).ratio < 0.5


def test_pedals_in_turn_are_counted() -> None:
    throttle_on = np.floor(T) % 2.0 == 0.0
    pedals = {
        "cmd_throttle_frac": np.where(throttle_on, 0.45, 0.15),
        "cmd_brake_frac": np.where(throttle_on, 0.15, 0.45),
    }
    swing = alternation({**pedals, "ref_accel_mps2": np.zeros(3000)}, 0.15, DT_S)
    assert swing.ratio == pytest.approx(2.0, rel=0.15), "once a second, limit 0.5"
    asked = np.where(throttle_on, 1.0, -1.0)
    assert alternation({**pedals, "ref_accel_mps2": asked}, 0.15, DT_S).ratio == 0.0


def test_sets_depend_on_the_seed_and_lie_in_the_box() -> None:
    first, again, other = (list(random_sets(4, seed)) for seed in ("a", "a", "b"))
    assert first == again and first != other
    for number, values in enumerate(first):
        box = BoxChoice.PAPER if number % 2 else BoxChoice.DEFAULT
        for name in SETS["complete"]:
            tunable = tunable_in_box(name, box)
            assert tunable.low * (1.0 - 1e-6) <= values[name] <= tunable.high * (1.0 + 1e-6)


def test_a_transient_is_none_and_two_cycles_are_enough_in_a_drive_that_ends_early() -> None:
    since = np.maximum(T - 5.0, 0.0)
    dying = np.where(T > 5.0, 0.35 * np.exp(-0.25 * 2.0 * math.pi * since) * np.cos(2.0 * math.pi * since), 0.0)
    assert strongest_swing(columns(dying), WHEEL, DT_S).ratio < 1.0
    early = np.where(T > 0.5, 0.5 * np.sin(2.0 * math.pi * 0.8 * (T - 0.5)), 0.0)[:350]
    assert strongest_swing(columns(early), WHEEL, DT_S).ratio > 5.0


def test_the_start_is_not_counted_but_where_a_drive_ends_early() -> None:
    swing = np.where(T < 2.8, 0.5 * np.sin(2.0 * math.pi * 1.2 * T), 0.0)
    assert strongest_swing(columns(swing), WHEEL, DT_S).ratio < 1.0
    assert strongest_swing(columns(swing[:400]), WHEEL, DT_S).ratio > 5.0
