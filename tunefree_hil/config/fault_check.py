"""Checks the [[faults]] tables of a bench file by themselves; against the vehicle: bench/faults.py.

The kinds that disturb CRC and counter have CANoe's names: value, freeze, random, offset.
"""

from __future__ import annotations

from collections.abc import Sequence

from tunefree_hil.config.find import nearest
from tunefree_hil.config.problem import ConfigProblem, Problems
from tunefree_hil.config.schema import FaultSpec

DRIVER, PEER = "driver_override", "peer_stop"
CRC_KINDS = ("crc_value", "crc_freeze", "crc_random", "crc_offset")
COUNTER_KINDS = ("counter_value", "counter_freeze", "counter_random", "counter_offset")
FRAME_KINDS = ("drop", "delay", "duplicate", "corrupt", *CRC_KINDS, *COUNTER_KINDS, "stale", "burst")  # of one message
FAULT_KINDS = (DRIVER, PEER, *FRAME_KINDS)  # a FAULT frame's code is the place here, from 0 on
HANDS = ("throttle", "brake", "steer", "gear")  # channels of a driver
PEERS = ("ecu", "controller")
MOST_FRAMES, MOST_FAULTS, MOST_SEED = 200, 255, 65535  # one byte of DONE counts the frames, one of FAULT the faults
# What `value` means, lowest and highest; a kind that is not here has none.
VALUES = {
    "delay": ("ticks", 1, 10_000),
    "corrupt": ("bits to flip", 1, 512),
    "crc_value": ("the CRC", 0, 255),
    "crc_offset": ("what is added to the CRC", 1, 255),
    "counter_value": ("the counter", 0, 65535),
    "counter_offset": ("what is added to the counter", 1, 65535),
    "burst": ("extra copies", 1, MOST_FRAMES),
}


def check_faults(faults: Sequence[FaultSpec]) -> Problems:
    """Every problem, by key."""
    if len(faults) > MOST_FAULTS:
        yield ConfigProblem("faults", f"there are {len(faults)}", f"give {MOST_FAULTS} at most")
    for i, fault in enumerate(faults):
        key = f"faults[{i}]"
        if not 0 <= fault.from_tick < fault.to_tick:
            yield ConfigProblem(
                key, f"from_tick {fault.from_tick}, to_tick {fault.to_tick}", "0 <= from_tick < to_tick"
            )
        if not 0 <= fault.seed <= MOST_SEED:
            yield ConfigProblem(f"{key}.seed", f"{fault.seed} does not fit", f"give 0 to {MOST_SEED}")
        if fault.kind not in FAULT_KINDS:
            yield ConfigProblem(f"{key}.kind", f"no fault kind {fault.kind!r}", f"there is {', '.join(FAULT_KINDS)}")
        else:
            yield from _place(key, fault)
            yield from _value(key, fault)


def _place(key: str, fault: FaultSpec) -> Problems:
    if fault.kind in FRAME_KINDS:
        if not fault.message:
            yield ConfigProblem(f"{key}.message", f"{fault.kind} needs it", "name a message of the vehicle's DBC")
        if fault.channel not in ("", "vehicle"):
            yield ConfigProblem(f"{key}.channel", f"{fault.channel!r} has no messages", 'leave it out, or "vehicle"')
        return
    known = HANDS if fault.kind == DRIVER else PEERS
    if fault.channel not in known:
        subject = "a driver has no" if fault.kind == DRIVER else "no peer"
        yield ConfigProblem(f"{key}.channel", f"{subject} {fault.channel!r}", nearest(fault.channel, known))
    if fault.message:
        yield ConfigProblem(f"{key}.message", f"{fault.kind} is of no message", "remove the key")


def _value(key: str, fault: FaultSpec) -> Problems:
    if fault.kind == DRIVER:
        return
    if fault.kind not in VALUES:
        if fault.value != 0.0:
            yield ConfigProblem(f"{key}.value", f"{fault.kind} has no value", "remove the key")
        return
    meaning, low, high = VALUES[fault.kind]
    if not low <= fault.value <= high or fault.value != int(fault.value):
        yield ConfigProblem(
            f"{key}.value", f"{fault.value:g} is not {meaning}", f"give a whole number from {low} to {high}"
        )
