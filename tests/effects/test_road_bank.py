"""A road that falls off to the right: the force is gravity's, and an accelerometer feels it."""

from __future__ import annotations

import math

import pytest

from tests.effects.shared import EFFECTS, KINDS, constants, driven
from tests.plant.drives import REST, car, command
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import GEAR_NEUTRAL
from tunefree_hil.base.units import G_MPS2

BANK = 0.05
FALL_MPS2 = G_MPS2 * math.sin(BANK)


@pytest.mark.parametrize("kind", KINDS)
def test_it_moves_the_car_as_a_wind_to_the_right_would(kind: str) -> None:
    """The same motion as m g sin(bank) of wind to the right; specific force is g sin(bank) more to the left."""

    def drive(effect: dict[str, dict[str, float]]) -> list[tuple[float, ...]]:
        outputs = driven(kind, effect, lambda t: command(0.25, REST, 0.3 * t), 1.0, start=Start(speed_mps=15.0))
        return [tuple(out.motion) for out in outputs]

    force_n = -constants(kind).mass_kg * FALL_MPS2
    bank, wind = drive({"road_bank": {"bank_rad": BANK}}), drive({"side_wind": {"force_n": force_n}})
    assert bank[20][1] < drive({})[20][1] - 1e-4, "to the right"
    for on_bank, in_wind in zip(bank[1:], wind[1:], strict=True):
        assert on_bank[:7] == pytest.approx(in_wind[:7], rel=1e-6, abs=1e-9)
        assert on_bank[7] - in_wind[7] == pytest.approx(FALL_MPS2, rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_felt_at_a_stand(kind: str) -> None:
    effect = {"road_bank": {"bank_rad": BANK}}
    last = driven(kind, effect, lambda t: command(gear=GEAR_NEUTRAL), 0.3, start=Start())[-1]
    assert (last.motion.x_m, last.motion.y_m) == (0.0, 0.0)
    assert last.motion.lateral_accel_mps2 == pytest.approx(FALL_MPS2)
    assert last.measurement.report.lateral_accel_mps2 == pytest.approx(FALL_MPS2)


def test_banks_add_up() -> None:
    half = {"bank_rad": 0.5 * BANK}
    assert constants("physics").side_n == 0.0
    twice = car("physics", effects=((EFFECTS["road_bank"], half), (EFFECTS["road_bank"], half)))
    assert twice.block.params.chassis.constants.bank_mps2 == pytest.approx(FALL_MPS2)
