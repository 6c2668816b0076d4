"""A road that falls off to the right: the force is gravity's, and an accelerometer feels it."""

from __future__ import annotations

import math

import pytest

from tests.effects.shared import EFFECTS, KINDS, START, constants, driven, motions
from tests.plant.drives import REST, car, command
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import GEAR_NEUTRAL, Disturbance, Motion
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


@pytest.mark.parametrize("kind", KINDS)
def test_a_bank_of_the_road_is_the_same_bit_for_bit(kind: str) -> None:
    """And adds up with the effect's."""

    def drive(effect_rad: float, road_rad: float) -> list[Motion]:
        effect = {"road_bank": {"bank_rad": effect_rad}}
        road = Disturbance(bank_rad=road_rad)
        return motions(driven(kind, effect, lambda t: command(0.25, REST, 0.3 * t), 1.0, start=START, road=road))

    assert drive(0.0, BANK) == drive(BANK, 0.0) != drive(0.0, 0.0)
    assert drive(0.25 * BANK, 0.75 * BANK)[-1] == pytest.approx(drive(BANK, 0.0)[-1], rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_banked_road_pulls_to_the_low_side_by_g_sin_bank(kind: str) -> None:
    road = Disturbance(bank_rad=BANK)
    outputs = driven(kind, {}, lambda t: command(0.2, REST), 0.5, start=Start(speed_mps=20.0), road=road)
    first, last = outputs[1].motion, outputs[-1].motion
    assert last.y_m < -0.005 and last.x_m > 9.0
    assert first.side_speed_mps == pytest.approx(-FALL_MPS2 * 0.01, rel=0.15), "before the tyres hold"
    assert abs(first.lateral_accel_mps2) < 0.15 * FALL_MPS2, "in free fall to the side nothing is felt"


def test_banks_add_up() -> None:
    half = {"bank_rad": 0.5 * BANK}
    twice = car("physics", effects=((EFFECTS["road_bank"], half), (EFFECTS["road_bank"], half)))
    assert twice.block.params.chassis.constants.bank_rad == BANK
