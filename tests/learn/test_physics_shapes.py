"""A car's shape is fitted where its free runs need it, and left alone where they do not."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.made_drives import made_drive, whole
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.learn.physics import PhysicsFit
from tunefree_hil.learn.physics_shapes import PAYS, PLAIN, SHAPES, pays
from tunefree_hil.learn.sheet import constants, fixed_params
from tunefree_hil.learn.windows import windows_of
from tunefree_hil.learn.worker import Worker
from tunefree_hil.plant.data_sheet import DEFAULTS

VEHICLE = load_vehicle("mkz_bywire")


def fitted(truth: dict[str, float]) -> PhysicsFit:
    """A fit of two drives of a car."""
    some = windows_of([whole(made_drive(110.0, seed=seed, params=truth)) for seed in (1, 2)], VEHICLE)
    with Worker() as worker:
        return worker.result("tunefree_hil.learn.physics", "fit", some, fixed_params(VEHICLE), constants(VEHICLE), 0.35)


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        ([1.0, 1.0, 1.0, 1.0], False),
        ([0.8, 0.7, 0.8, 0.9], True),
        ([1.0 - 0.9 * PAYS] * 4, False),
        ([1.6, 0.2, 1.4, 0.4], False),
        ([1.1, 1.2, 1.1, 1.2], False),
    ],
)
def test_what_pays_is_less_by_a_share_and_not_by_chance(after: list[float], expected: bool) -> None:
    assert pays(np.ones(4), np.array(after)) is expected


def test_of_one_stretch_nobody_knows_what_chance_does() -> None:
    assert not pays(np.ones(1), np.zeros(1))


@pytest.mark.slow
def test_a_motor_that_holds_back_is_no_rolling_resistance() -> None:
    """Coasting alone cannot tell them; the last metres before standstill can, where the one fades and the other not."""
    found = fitted({"overrun_force_n": 900.0, "drive_corner": 12.0, "brake_rise_per_frac": 0.8})
    overrun, rolling = found.values["overrun_force_n"], found.values["rolling_frac"]
    assert overrun.known and overrun.low < 900.0 < overrun.high and overrun.high - overrun.low < 900.0
    assert rolling.low < DEFAULTS["rolling_frac"] < rolling.high
    rise, brake = found.values["brake_rise_per_frac"], found.values["brake_force_n_per_frac"]
    assert rise.known and rise.low < 0.8 < rise.high and rise.low > 0.0
    assert brake.low < DEFAULTS["brake_force_n_per_frac"] < brake.high
    assert found.after["speed_mps"] < 0.05


@pytest.mark.slow
def test_a_plain_car_stays_plain() -> None:
    """What explains nothing lends no doubt to the others."""
    found = fitted({})
    for name in SHAPES:
        value = found.values[name]
        assert not value.known and value.value == DEFAULTS[name] and value.why == PLAIN
        assert found.params[name] == DEFAULTS[name]
    drive = found.values["drive_force_n"]
    assert drive.known and drive.high - drive.low < 0.2 * drive.value
