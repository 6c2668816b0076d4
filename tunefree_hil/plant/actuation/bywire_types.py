"""Words of the by-wire unit: what it hears, its rules, its status bits, its watchdog (docs/reference/by_wire.md)."""

from __future__ import annotations

from typing import NamedTuple

from tunefree_hil.base.records import GEAR_DRIVE, Command
from tunefree_hil.plant.types import REST_FRAC, Driver

_CHANNEL_CAUSES = ("counter", "disabled", "timeout", "report_timeout")
CAUSES: dict[str, float] = {"none": 0.0, "other": 1.0} | {
    f"{channel}_{cause}": 2.0 + 4.0 * i + j
    for i, channel in enumerate(("brake", "throttle", "steer"))
    for j, cause in enumerate(_CHANNEL_CAUSES)
}  # the watchdog's causes, by the name that vehicle.toml gives them
BRAKE_COUNTER, THROTTLE_COUNTER, STEER_COUNTER = (CAUSES[f"{name}_counter"] for name in ("brake", "throttle", "steer"))


GEAR_REJECTS: dict[str, float] = {"none": 0.0, "override": 1.0, "vehicle": 2.0}  # why a wished gear is not taken


class HeardChannel(NamedTuple):
    """One channel's command frame of this tick; without a new one (fresh = 0) nothing else here counts.

    enable, clear, ignore, counter_ok are 0 or 1. A frame with clear = 1 is not held to the counter (DLC 4 frames).
    e2e counts at every tick: the code of the message's E2E status (bus/dbc/integrity.py), 0 where all is well or
    nothing is protected. A frame that is not believed is not fresh.
    """

    value: float = 0.0
    enable: float = 0.0
    clear: float = 0.0
    ignore: float = 0.0
    counter_ok: float = 1.0
    fresh: float = 0.0
    e2e: float = 0.0


class Heard(NamedTuple):
    """All that came in this tick; gear is GEAR_NONE without a gear frame."""

    throttle: HeardChannel = HeardChannel()
    brake: HeardChannel = HeardChannel()
    steer: HeardChannel = HeardChannel()
    gear: float = 0.0
    gear_clear: float = 0.0


class ByWireInput(NamedTuple):
    """One tick: what was heard, the person in the seat, and the vehicle's speed and steering output before it."""

    heard: Heard
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

    light_input, light_command, light_output: brake light asked for by the foot, by the unit, and on. gear_wish: the
    last gear commanded, GEAR_NONE before the first; gear_reject, a code of GEAR_REJECTS, says why it is not in.
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
    """What the actuators are told now, and what the reports say of it."""

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
    """Rules of a unit in ticks; the defaults are for ticks of 10 ms (bench/vehicle.py works them out for others).

    Source: docs/reference/by_wire.md; what it does not state is marked assumed. The unit heeds counters when
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
