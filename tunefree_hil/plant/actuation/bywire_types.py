"""Records of the by-wire unit: received commands, rules, status bits, watchdog (docs/reference/by_wire.md)."""

from __future__ import annotations

from typing import NamedTuple

from tunefree_hil.base.records import GEAR_DRIVE, Command
from tunefree_hil.plant.types import REST_FRAC, Driver

_CHANNEL_CAUSES = ("counter", "disabled", "timeout", "report_timeout")
CAUSES: dict[str, float] = {"none": 0.0, "other": 1.0} | {
    f"{channel}_{cause}": 2.0 + 4.0 * i + j
    for i, channel in enumerate(("brake", "throttle", "steer"))
    for j, cause in enumerate(_CHANNEL_CAUSES)
}  # causes of the watchdog, by their name in vehicle.toml
BRAKE_COUNTER, THROTTLE_COUNTER, STEER_COUNTER = (CAUSES[f"{name}_counter"] for name in ("brake", "throttle", "steer"))


GEAR_REJECTS: dict[str, float] = {"none": 0.0, "override": 1.0, "vehicle": 2.0}  # why a requested gear is not engaged


class ReceivedChannel(NamedTuple):
    """One channel's command frame of this tick; without a new one (fresh = 0) the other fields are not used.

    enable, clear, ignore, counter_ok are 0 or 1. The counter is not checked in a frame with clear = 1 (DLC 4
    frames). e2e is used at every tick: the code of the message's E2E status (bus/dbc/integrity.py), 0 where it is valid
    or the message is not protected. A rejected frame is not fresh.
    """

    value: float = 0.0
    enable: float = 0.0
    clear: float = 0.0
    ignore: float = 0.0
    counter_ok: float = 1.0
    fresh: float = 0.0
    e2e: float = 0.0


class ReceivedCommand(NamedTuple):
    """All commands received in this tick; gear is GEAR_NONE without a gear frame."""

    throttle: ReceivedChannel = ReceivedChannel()
    brake: ReceivedChannel = ReceivedChannel()
    steer: ReceivedChannel = ReceivedChannel()
    gear: float = 0.0
    gear_clear: float = 0.0


class ByWireInput(NamedTuple):
    """One tick: received commands, driver, and the vehicle's speed and steering output before it."""

    received: ReceivedCommand
    driver: Driver
    speed_mps: float
    steer_rad: float


class ChannelStatus(NamedTuple):
    """Bits of one channel's report, each 0 or 1; e2e is the E2E status of its command message, a code."""

    enabled: float = 0.0
    override: float = 0.0
    driver: float = 0.0
    timeout: float = 0.0
    counter_fault: float = 0.0
    e2e: float = 0.0


class ByWireStatus(NamedTuple):
    """The bits of the reports. watchdog_cause is a code of CAUSES, 0 while nothing is wrong.

    light_input, light_command, light_output: brake light requested by the driver, by the unit, and on. gear_wish: the
    last gear commanded, GEAR_NONE before the first; gear_reject: why it is not engaged, a code of GEAR_REJECTS.
    """

    throttle: ChannelStatus = ChannelStatus()
    brake: ChannelStatus = ChannelStatus()
    steer: ChannelStatus = ChannelStatus()
    gear_override: float = 0.0
    watchdog_braking: float = 0.0
    watchdog_cause: float = 0.0
    light_input: float = 0.0
    light_command: float = 0.0
    light_output: float = 0.0
    gear_wish: float = 0.0
    gear_reject: float = 0.0


class ByWireOutput(NamedTuple):
    """The command to the actuators, and the status bits of the reports."""

    command: Command
    status: ByWireStatus


class ChannelRules(NamedTuple):
    """Limits of one channel; the driver's input is duty, or |torque| in Nm for steering."""

    timeout_ticks: float = 10.0
    driver_level: float = 0.18
    driver_ticks: float = 2.0
    override_level: float = 0.22
    override_ticks: float = 10.0
    low: float = REST_FRAC
    high: float = 1.0


class ByWireParams(NamedTuple):
    """Rules of a unit in ticks; the defaults are for ticks of 10 ms (bench/vehicle.py computes those for others).

    Source: docs/reference/by_wire.md; values that it does not state are marked assumed. Counters are checked where
    check_counter is 1. first_gear: the lever at power-up.
    """

    throttle: ChannelRules = ChannelRules(override_level=0.30, high=0.80)
    brake: ChannelRules = ChannelRules(high=0.50)
    steer: ChannelRules = ChannelRules(driver_level=1.0, override_level=3.0, low=-8.2, high=8.2)  # Nm assumed
    brake_ramp_per_tick: float = 0.2  # 0.4 per 20 ms
    watchdog_brake_frac: float = 0.30  # assumed
    standstill_mps: float = 0.1  # assumed
    check_counter: float = 1.0
    light_on_frac: float = 0.22  # brake duty, with hysteresis (docs/reference/by_wire.md)
    light_off_frac: float = 0.20
    first_gear: float = GEAR_DRIVE
