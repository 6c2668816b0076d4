"""The faults of a bench file for its vehicle: by node, and the driver's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench.load import Bench
from tunefree_hil.bus.dbc.check_vehicle import one_error
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.message_map import COMMAND
from tunefree_hil.config.fault_check import COUNTER_KINDS, CRC_KINDS, DRIVER, FAULT_KINDS, FRAME_KINDS
from tunefree_hil.config.find import nearest
from tunefree_hil.config.schema import FaultSpec
from tunefree_hil.nodes.faults import ScriptedFault
from tunefree_hil.plant.types import REST_FRAC, Driver

ECU, CONTROLLER = "ecu", "controller"
HANDS = {  # a fault's channel -> field of Driver; a lever is moved for any value
    "throttle": "throttle_frac",
    "brake": "brake_frac",
    "steer": "steer_torque_nm",
    "gear": "gear_override",
}


def faults_of(bench: Bench, role: str, script: Sequence[FaultSpec] | None = None) -> tuple[ScriptedFault, ...]:
    """The faults that a node ('ecu' or 'controller') injects: in its messages and in itself.

    script: these instead of the bench file's.

    Raises one InputError that lists every fault that the vehicle's messages cannot have, of both nodes.
    """
    faults = bench.spec.faults if script is None else script
    problems = [problem for i, fault in enumerate(faults) for problem in _problems(bench, i, fault)]
    if problems:
        raise one_error(problems)
    return tuple(
        ScriptedFault(
            index=i,
            code=FAULT_KINDS.index(fault.kind),
            kind=fault.kind,
            from_tick=fault.from_tick,
            to_tick=fault.to_tick,
            value=int(fault.value) if fault.kind in FRAME_KINDS else 0,
            seed=fault.seed,
            message=bench.codec.by_name.get(fault.message),
        )
        for i, fault in enumerate(faults)
        if sender_of(bench.codec, fault) == role
    )


def sender_of(codec: Codec, fault: FaultSpec) -> str:
    """The node that injects a fault: the sender of the message; the ECU for the driver."""
    if fault.kind in FRAME_KINDS:
        return CONTROLLER if codec.by_name[fault.message].kind == COMMAND else ECU
    return ECU if fault.kind == DRIVER else fault.channel


def _problems(bench: Bench, i: int, fault: FaultSpec) -> list[InputError]:
    if fault.kind not in FRAME_KINDS:
        return []

    def problem(key: str, message: str, hint: str, code: str) -> list[InputError]:
        return [InputError(message, code=code, file=bench.file, key=f"faults[{i}].{key}", hint=hint)]

    name = fault.message
    message = bench.codec.by_name.get(name)
    if message is None:
        hint = nearest(name, bench.codec.by_name)
        return problem("message", f"{bench.vehicle.name} has no message {name!r}", hint, "unknown_message")
    if fault.kind in CRC_KINDS and message.e2e is None:
        having = [one.name for one in bench.codec.by_name.values() if one.e2e is not None]
        hint = f"of this vehicle {', '.join(sorted(having)) or 'no message'} has one"
        return problem("kind", f"{fault.kind}: {name} has no CRC", hint, "no_crc")
    if fault.kind in COUNTER_KINDS and not message.counter:
        having = [one.name for one in bench.codec.by_name.values() if one.counter]
        hint = f"of this vehicle {', '.join(sorted(having)) or 'no message'} has one"
        return problem("kind", f"{fault.kind}: {name} has no counter", hint, "no_counter")
    if fault.kind in COUNTER_KINDS:
        most = message.signals[message.counter].mask
        if fault.value > most or (fault.kind == "counter_offset" and fault.value % message.counter_modulus == 0):
            hint = f"{name} counts to {message.counter_modulus - 1}"
            return problem("value", f"{fault.value:g} is no {fault.kind.replace('_', ' ')}", hint, "fault_value")
    return []


def driver_script(faults: Sequence[FaultSpec], rest_frac: float = REST_FRAC) -> Callable[[int], Driver]:
    """The driver by tick; rest_frac: duty of a released pedal."""
    hands = [fault for fault in faults if fault.kind == DRIVER]

    @lru_cache(maxsize=4)
    def by_active(active: tuple[int, ...]) -> Driver:
        driver = Driver(rest_frac, rest_frac)
        for i in active:
            channel = hands[i].channel
            driver = driver._replace(**{HANDS[channel]: 1.0 if channel == "gear" else hands[i].value})
        return driver

    def driver(tick: int) -> Driver:
        return by_active(tuple(i for i, fault in enumerate(hands) if fault.from_tick <= tick < fault.to_tick))

    return driver
