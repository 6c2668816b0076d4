"""The by-wire unit: enable, override, time-outs, counters, watchdog (docs/reference/by_wire.md).

One Block a vehicle: ByWireInput -> (applied Command, ByWireStatus). Faults (time-out, counter, watchdog) stay until a
power cycle, which is `init`; CLEAR clears a latched override only. Reverse and park are accepted at standstill only.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from tunefree_hil.base.kernel import Block, kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import GEAR_NEUTRAL, GEAR_PARK, GEAR_REVERSE, Command
from tunefree_hil.plant.actuation.bywire_types import (
    BRAKE_COUNTER,
    CAUSES,
    GEAR_REJECTS,
    STEER_COUNTER,
    THROTTLE_COUNTER,
    ByWireInput,
    ByWireOutput,
    ByWireParams,
    ByWireStatus,
    ChannelRules,
    ChannelStatus,
    ReceivedChannel,
    ReceivedCommand,
)

__all__ = [
    "CAUSES",
    "GEAR_REJECTS",
    "ByWireInput",
    "ByWireOutput",
    "ByWireParams",
    "ByWireStatus",
    "ChannelRules",
    "ChannelStatus",
    "ReceivedChannel",
    "ReceivedCommand",
    "bywire",
]

MKZ_RULES = ByWireParams()
OVERRIDDEN, OF_VEHICLE = GEAR_REJECTS["override"], GEAR_REJECTS["vehicle"]


class ChannelState(NamedTuple):
    """State of one channel. dropped: the enable bit was cleared in this tick while the channel was enabled."""

    value: float
    wanted: float
    ignore: float
    enabled: float
    override: float
    timeout: float
    counter_fault: float
    dropped: float
    age_ticks: float
    driver_ticks: float
    override_ticks: float


class ByWireState(NamedTuple):
    """State of the unit between two ticks."""

    throttle: ChannelState
    brake: ChannelState
    steer: ChannelState
    gear: float
    gear_override: float
    cause: float
    gear_wish: float  # last received
    light_input: float
    light_command: float
    light_output: float
    brake_frac: float  # after the ramp
    hold_rad: float  # steering angle while it is not enabled


@kernel
def listen(
    rules: ChannelRules, state: ChannelState, received: ReceivedChannel, driver: float, counting: float
) -> ChannelState:
    """Process one channel's frame (or its absence) and the driver's input; `enabled` is still that of the last tick."""
    value, wanted, ignore, age = state.value, state.wanted, state.ignore, state.age_ticks + 1.0
    override, timeout, counter_fault, dropped = state.override, state.timeout, state.counter_fault, 0.0
    if received.fresh > 0.5:
        if state.enabled > 0.5 and received.enable < 0.5:
            dropped = 1.0
        if received.clear > 0.5:
            override = 0.0
        elif counting > 0.5 and received.counter_ok < 0.5 and (state.enabled > 0.5 or received.enable > 0.5):
            counter_fault = 1.0
        value, wanted, ignore, age = received.value, received.enable, received.ignore, 0.0
    elif state.enabled > 0.5 and age >= rules.timeout_ticks:
        timeout = 1.0
    driver_ticks = state.driver_ticks + 1.0 if driver > rules.driver_level else 0.0
    override_ticks = state.override_ticks + 1.0 if driver > rules.override_level else 0.0
    if state.enabled > 0.5 and ignore < 0.5 and override_ticks >= rules.override_ticks:
        override = 1.0
    return ChannelState(
        value,
        wanted,
        ignore,
        state.enabled,
        override,
        timeout,
        counter_fault,
        dropped,
        age,
        driver_ticks,
        override_ticks,
    )


@kernel
def find_cause(channel: ChannelState, first_code: float, may_not_drop: float) -> float:
    """The watchdog's code for one channel (first_code is its counter's), 0 without a fault."""
    if channel.counter_fault > 0.5:
        return first_code
    if channel.dropped > 0.5 and may_not_drop > 0.5:
        return first_code + 1.0
    if channel.timeout > 0.5:
        return first_code + 2.0
    return 0.0


@kernel
def settle(rules: ChannelRules, state: ChannelState, allowed: float, e2e: float) -> tuple[ChannelState, ChannelStatus]:
    """Decide whether the channel is enabled in this tick; the E2E status of its message is passed on."""
    enabled = 1.0 if allowed > 0.5 and state.wanted > 0.5 and state.age_ticks < rules.timeout_ticks else 0.0
    new_state = ChannelState(
        state.value, state.wanted, state.ignore, enabled, state.override, state.timeout, state.counter_fault,
        0.0, state.age_ticks, state.driver_ticks, state.override_ticks,
    )  # fmt: skip
    driver = 1.0 if state.driver_ticks >= rules.driver_ticks else 0.0
    return new_state, ChannelStatus(enabled, state.override, driver, state.timeout, state.counter_fault, e2e)


@kernel
def shift(params: ByWireParams, gear: float, wish: float, speed_mps: float) -> float:
    """The gear after this tick: park and reverse only at standstill."""
    if wish < 0.5 or wish == gear:
        return gear
    if wish in (GEAR_PARK, GEAR_REVERSE) and speed_mps > params.standstill_mps:
        return gear
    return wish


@kernel
def reject(gear: float, wish: float, gear_override: float) -> float:
    """Why the last requested gear is not engaged; a code of GEAR_REJECTS."""
    if wish < 0.5 or wish == gear:
        return 0.0
    return OVERRIDDEN if gear_override > 0.5 else OF_VEHICLE


@kernel
def light(params: ByWireParams, on: float, duty_frac: float) -> float:
    """The brake light for a duty, with hysteresis."""
    level = params.light_off_frac if on > 0.5 else params.light_on_frac
    return 1.0 if duty_frac > level else 0.0


@kernel
def pedal(rules: ChannelRules, state: ChannelState, driver_frac: float) -> float:
    """The throttle pedal: the larger of command and driver; with IGNORE the command only, disabled the driver only."""
    if state.enabled < 0.5:
        return driver_frac
    wish = clamp(state.value, rules.low, rules.high)
    return driver_frac if state.ignore < 0.5 and driver_frac > wish else wish


@kernel
def brake_pedal(
    params: ByWireParams, state: ByWireState, brake: ChannelState, cause: float, driver_frac: float
) -> float:
    """The requested brake duty within the ramp; without a command or a fault the driver's pedal."""
    if cause > 0.5:
        wish = params.watchdog_brake_frac
    elif brake.enabled > 0.5:
        wish = clamp(brake.value, params.brake.low, params.brake.high)
    else:
        return driver_frac
    ramp = params.brake_ramp_per_tick
    return clamp(wish, state.brake_frac - ramp, state.brake_frac + ramp)


@kernel
def step_bywire(
    params: ByWireParams, state: ByWireState, x: ByWireInput, dt_s: float
) -> tuple[ByWireState, ByWireOutput]:
    """One tick of the unit."""
    received, driver = x.received, x.driver
    hand_nm = abs(driver.steer_torque_nm)
    if driver.steer_hold > 0.5:
        hand_nm = hand_nm + params.steer.override_level + 1.0
    counting = params.check_counter
    throttle = listen(params.throttle, state.throttle, received.throttle, driver.throttle_frac, counting)
    brake = listen(params.brake, state.brake, received.brake, driver.brake_frac, counting)
    steer = listen(params.steer, state.steer, received.steer, hand_nm, counting)
    gear_override = 0.0 if received.gear_clear > 0.5 else state.gear_override
    if driver.gear_override > 0.5:
        gear_override = 1.0
    overridden = throttle.override + brake.override + steer.override + gear_override

    moving = 1.0 if x.speed_mps > params.standstill_mps else 0.0
    if state.gear != GEAR_PARK and state.gear != GEAR_NEUTRAL:
        moving = 1.0
    cause = state.cause
    if cause < 0.5:
        cause = driver.fault_cause
    if cause < 0.5:
        cause = find_cause(brake, BRAKE_COUNTER, moving)
    if cause < 0.5:
        cause = find_cause(throttle, THROTTLE_COUNTER, moving)
    if cause < 0.5:
        cause = find_cause(steer, STEER_COUNTER, moving)

    allowed = 1.0 if overridden < 0.5 and cause < 0.5 else 0.0
    throttle, throttle_status = settle(params.throttle, throttle, allowed, received.throttle.e2e)
    brake, brake_status = settle(params.brake, brake, allowed, received.brake.e2e)
    steer, steer_status = settle(params.steer, steer, allowed, received.steer.e2e)
    gear = shift(params, state.gear, received.gear, x.speed_mps) if gear_override < 0.5 else state.gear

    throttle_frac = pedal(params.throttle, throttle, driver.throttle_frac)
    if cause > 0.5:
        throttle_frac = params.throttle.low
    brake_frac = brake_pedal(params, state, brake, cause, driver.brake_frac)
    hold_rad = state.hold_rad
    if steer.enabled > 0.5:
        hold_rad = clamp(steer.value, params.steer.low, params.steer.high)
    elif state.steer.enabled > 0.5:
        hold_rad = x.steer_rad
    gear_wish = received.gear if received.gear > 0.5 else state.gear_wish
    applied_frac = driver.brake_frac if driver.brake_frac > brake_frac else brake_frac
    asked_frac = brake_frac if brake.enabled > 0.5 or cause > 0.5 else 0.0
    light_input = light(params, state.light_input, driver.brake_frac)
    light_command = light(params, state.light_command, asked_frac)
    light_output = light(params, state.light_output, applied_frac)
    new_state = ByWireState(
        throttle, brake, steer, gear, gear_override, cause, gear_wish, light_input, light_command, light_output,
        brake_frac, hold_rad,
    )  # fmt: skip
    command = Command(throttle_frac, applied_frac, hold_rad, gear, math.nan, math.nan)
    braking = 1.0 if cause > 0.5 else 0.0
    status = ByWireStatus(
        throttle_status, brake_status, steer_status, gear_override, braking, cause,
        light_input, light_command, light_output, gear_wish, reject(gear, gear_wish, gear_override),
    )  # fmt: skip
    return new_state, ByWireOutput(command, status)


def init_bywire(params: ByWireParams, dt_s: float) -> ByWireState:
    """Power-up: nothing received, nothing enabled, no fault, steering straight."""
    never = max(params.throttle.timeout_ticks, params.brake.timeout_ticks, params.steer.timeout_ticks)
    channel = ChannelState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, float(never), 0.0, 0.0)
    return ByWireState(
        channel, channel, channel, params.first_gear, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, params.brake.low, 0.0
    )  # fmt: skip


def bywire(params: ByWireParams = MKZ_RULES) -> Block:
    """The by-wire unit as a Block ByWireInput -> ByWireOutput."""
    return Block(init_bywire, step_bywire, params)
