"""Status of the by-wire unit -> state signals of the vehicle's frames, by the tables of vehicle.toml."""

from __future__ import annotations

import pytest

from tunefree_hil.base.records import GEAR_DRIVE
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.nodes.status_bits import StatusSignals, cause_name, set_bits
from tunefree_hil.plant.actuation.bywire import CAUSES, GEAR_REJECTS, ByWireStatus, ChannelStatus

WELL = ChannelStatus(enabled=1.0)
ALL_WELL = ByWireStatus(WELL, WELL, WELL)


def bits(codec: Codec, status: ByWireStatus) -> dict[str, dict[str, float]]:
    return {message.name: set_bits(message, status) for message in codec.telemetry if message.states}


def active(codec: Codec, status: ByWireStatus) -> set[str]:
    return {f"{name}.{signal}" for name, one in bits(codec, status).items() for signal, value in one.items() if value}


def test_at_power_up_no_bit_is_set(codec: Codec) -> None:
    assert active(codec, ByWireStatus()) == set()


def test_enabled(codec: Codec) -> None:
    assert active(codec, ALL_WELL) == {f"{name}_REPORT.ENABLED" for name in ("BRAKE", "THROTTLE", "STEERING")}
    assert active(codec, ByWireStatus(throttle=WELL)) == {"THROTTLE_REPORT.ENABLED"}


@pytest.mark.parametrize(
    ("field", "signal"), [("override", "OVERRIDE"), ("timeout", "TMOUT"), ("counter_fault", "FLTWDC")]
)
@pytest.mark.parametrize(("channel", "message"), [("brake", "BRAKE"), ("throttle", "THROTTLE"), ("steer", "STEERING")])
def test_a_channel_speaks_in_its_own_report(codec: Codec, channel: str, message: str, field: str, signal: str) -> None:
    status = ByWireStatus()._replace(**{channel: ChannelStatus()._replace(**{field: 1.0})})
    assert active(codec, status) == {f"{message}_REPORT.{signal}"}


def test_the_gear_lever(codec: Codec) -> None:
    assert active(codec, ByWireStatus(gear_override=1.0)) == {"GEAR_REPORT.OVERRIDE"}


@pytest.mark.parametrize("cause", [name for name, code in CAUSES.items() if code > 0.0])
def test_the_source_code_of_the_watchdog(codec: Codec, cause: str) -> None:
    """1 other, then four for each of brake, throttle, steering from 4 on (WDCSRC as the vehicle folder numbers it)."""
    status = ByWireStatus(watchdog_braking=1.0, watchdog_cause=CAUSES[cause])
    said = bits(codec, status)["BRAKE_REPORT"]
    expected = {
        state.active
        for state in codec.by_name["BRAKE_REPORT"].states
        if state.cause == cause and state.signal == "WDCSRC"
    }
    assert said["WDCBRK"] == 1.0
    assert said["WDCSRC"] in expected
    assert cause_name(CAUSES[cause]) == cause


def test_the_codes_of_the_folder_tell_causes_apart(codec: Codec) -> None:
    codes = []
    for cause, code in CAUSES.items():
        if code > CAUSES["other"]:
            status = ByWireStatus(watchdog_braking=1.0, watchdog_cause=code)
            codes.append((cause, bits(codec, status)["BRAKE_REPORT"]["WDCSRC"]))
    assert [code for _, code in codes] == list(range(4, 16))


def test_an_unknown_cause_has_a_name() -> None:
    assert cause_name(99.0) == "unknown"


def test_signals_are_worked_out_when_the_status_changes(codec: Codec) -> None:
    signals = StatusSignals(codec)
    first = signals.of(ALL_WELL)
    assert signals.of(ByWireStatus(WELL, WELL, WELL)) is first
    assert first["BRAKE_REPORT"]["ENABLED"] == 1.0 and first["GYRO"] == {}
    assert signals.of(ByWireStatus())["BRAKE_REPORT"]["ENABLED"] == 0.0


def test_lights_gear_and_the_throttles_own_source_code(codec: Codec) -> None:
    """Lights, CMD and REJECT of the gear report, the watchdog's source in both reports (docs/reference/by_wire.md)."""
    lit = ByWireStatus(light_input=1.0, light_output=1.0)
    assert active(codec, lit) == {"BRAKE_REPORT.BI", "BRAKE_REPORT.BO"}
    assert active(codec, ByWireStatus(light_command=1.0)) == {"BRAKE_REPORT.BC"}
    wished = bits(codec, ByWireStatus(gear_wish=GEAR_DRIVE, gear_reject=GEAR_REJECTS["vehicle"]))["GEAR_REPORT"]
    assert (wished["CMD"], wished["REJECT"]) == (4.0, 5.0)
    tripped = bits(codec, ByWireStatus(watchdog_braking=1.0, watchdog_cause=CAUSES["steer_timeout"]))
    assert tripped["THROTTLE_REPORT"]["WDCSRC"] == tripped["BRAKE_REPORT"]["WDCSRC"] == 14.0
