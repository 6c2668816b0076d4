"""What the by-wire unit only tells: brake lights, the gear that was wished, the E2E status of its commands."""

from __future__ import annotations

from tests.plant.actuation.test_bywire import NOTHING, Bench, said
from tunefree_hil.base.records import GEAR_DRIVE, GEAR_NONE, GEAR_PARK
from tunefree_hil.plant.actuation.bywire import GEAR_REJECTS, ByWireStatus
from tunefree_hil.plant.types import Driver


def lights(status: ByWireStatus) -> tuple[float, float, float]:
    return status.light_input, status.light_command, status.light_output


def test_brake_lights_have_hysteresis() -> None:
    """On above 0.22, off below 0.20 of duty (docs/reference/by_wire.md); the unit's own and the lamp's."""
    bench = Bench()
    seen = [lights(bench.tick(said(brake=duty), n=3).status) for duty in (0.15, 0.21, 0.23, 0.21, 0.19)]
    assert seen == [(0, 0, 0), (0, 0, 0), (0, 1, 1), (0, 1, 1), (0, 0, 0)]


def test_a_foot_lights_the_lamp_too() -> None:
    bench = Bench()
    assert lights(bench.tick(driver=Driver(brake_frac=0.25), n=3).status) == (1.0, 0.0, 1.0)


def test_the_watchdog_lights_the_lamp() -> None:
    bench = Bench()
    bench.tick(n=5)
    assert lights(bench.tick(NOTHING, n=15).status) == (0.0, 1.0, 1.0)


def test_the_wished_gear_is_told_and_why_it_is_not_in() -> None:
    bench = Bench()
    assert bench.tick().status.gear_wish == GEAR_NONE
    status = bench.tick(said(gear=GEAR_DRIVE)).status
    assert (status.gear_wish, status.gear_reject) == (GEAR_DRIVE, GEAR_REJECTS["none"])
    status = bench.tick(said(gear=GEAR_PARK)).status
    assert (status.gear_wish, status.gear_reject) == (GEAR_PARK, GEAR_REJECTS["vehicle"]), "it rolls"
    status = bench.tick(driver=Driver(gear_override=1.0)).status
    assert (status.gear_wish, status.gear_reject) == (GEAR_PARK, GEAR_REJECTS["override"])
    bench.speed_mps = 0.0
    status = bench.tick(said(gear=GEAR_PARK, gear_clear=1.0)).status
    assert (bench.out.command.gear, status.gear_reject) == (GEAR_PARK, GEAR_REJECTS["none"])


def test_the_e2e_status_passes_through_and_changes_nothing_by_itself() -> None:
    bench, other = Bench(), Bench()
    for _ in range(3):
        out, told = bench.tick(said()), other.tick(said(brake_e2e=4.0))
    assert told.status.brake.e2e == 4.0 and out.status.brake.e2e == 0.0
    assert told.status._replace(brake=out.status.brake) == out.status and told.command == out.command
