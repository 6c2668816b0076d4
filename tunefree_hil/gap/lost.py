"""What logs cannot show, in words: by link of the chain, and by channel of the by-wire car.

A channel is idle where hardly any of its commands acted: by-wire was not enabled, or a person drove over it. What it
reported is known, so the motion can be judged; what its actuator makes of a command cannot. A channel is unknown where
the vehicle has it and a log says neither what was commanded nor what it did: what follows from it cannot be judged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tunefree_hil.base.contracts import Effect, Link, Port, links_of
from tunefree_hil.gap.graph import CHANNELS
from tunefree_hil.gap.ports import PORTS_A, PORTS_B, PORTS_OUT
from tunefree_hil.learn.pairs import ECHOES

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec
    from tunefree_hil.gap.chain import Opened
    from tunefree_hil.learn.drives import Drive

Array = np.ndarray

OUTPUTS = {"throttle": "throttle_frac", "brake": "brake_frac", "steer": "steer_rad"}
ASKED_FOR = ("command.accel_mps2", f"report.{ECHOES['accel']}")  # commands that stand for both pedals
LEAST_ACTED_S = 4.0  # of a channel's commands: less is nothing that an actuator could be judged by
NOTHING_ACTED = "no command acted in these logs: by-wire was not enabled, or a person drove over it"


def idle_channels(follows: Array, dt_s: float) -> frozenset[str]:
    """Of rows whose commands acted, bool [n, 3]."""
    return frozenset(name for i, name in enumerate(CHANNELS) if dt_s * follows[:, i].sum() < LEAST_ACTED_S)


def unknown_channels(drive: Drive, vehicle: VehicleSpec) -> frozenset[str]:
    """Those that a vehicle has and a drive says nothing of."""
    return frozenset(name for name in CHANNELS if _has(vehicle, name) and not _says(drive, name))


def _has(vehicle: VehicleSpec, channel: str) -> bool:
    return any(OUTPUTS[channel] in group for group in (vehicle.command, vehicle.report))


def _says(drive: Drive, channel: str) -> bool:
    own = [f"command.{OUTPUTS[channel]}", f"report.{OUTPUTS[channel]}", f"report.{ECHOES[channel]}"]
    return any(drive.get(name) is not None for name in (*own, *(ASKED_FOR if channel != "steer" else ())))


def lost_of(signals: Mapping[str, Any], idle: frozenset[str], by_ins: bool) -> dict[Link, str]:
    """Links that a log cannot show. signals: by field; by_ins: whether the speed is the INS's."""
    lost: dict[Link, str] = {}
    reported = [name for name in CHANNELS if f"report.{OUTPUTS[name]}" in signals]
    mute = [name for name in CHANNELS if f"report.{ECHOES[name]}" not in signals]
    if not reported:
        lost[Link.COMMAND_TO_REPORT] = "no actuator output is reported: the chain goes from commands to motion"
    elif idle.issuperset(reported):
        lost[Link.COMMAND_TO_REPORT] = NOTHING_ACTED
    if len(mute) == len(CHANNELS):
        lost[Link.COMMAND_ECHO] = "no command is echoed"
    if not by_ins or "report.speed_mps" not in signals:
        lost[Link.WHEEL_VS_INS] = "speed is said by one side only, chassis or INS"
    if "ins.yaw_rate_radps" not in signals or "report.yaw_rate_radps" not in signals:
        lost[Link.YAW_VS_INS] = "the yaw rate is said by one side only, chassis or INS"
    if "report.accel_mps2" not in signals:
        lost[Link.ACCEL_VS_DVDT] = "no longitudinal acceleration is reported"
    if not by_ins and len(mute) == len(CHANNELS):
        lost[Link.CLOCK] = "there is no second clock: neither an INS nor echoes of commands"
    return lost


def lost_links(drives: Sequence[Opened]) -> dict[Link, str]:
    """Links that none of the drives shows."""
    shared = set(drives[0].lost)
    for one in drives[1:]:
        shared &= set(one.lost)
    return {link: drives[0].lost[link] for link in shared}


def silent_ports(drives: Sequence[Opened]) -> dict[Port, str]:
    """Ports of which none of the drives tells anything."""
    idle, unknown = (_shared(drives, which) for which in (lambda one: one.idle, lambda one: one.unknown))
    found: dict[Port, str] = {}
    for i, name in enumerate(CHANNELS):
        if name in idle:
            found |= dict.fromkeys((PORTS_A[i], PORTS_OUT[i]), f"no command of the {name} acted in these logs")
        if name in unknown:
            words = f"neither commands nor reports say what the {name} did"
            found |= dict.fromkeys((PORTS_A[i], PORTS_OUT[i], PORTS_B[i]), words)
    return found


def _shared(drives: Sequence[Opened], of: Callable[[Opened], frozenset[str]]) -> frozenset[str]:
    return of(drives[0]).intersection(*(of(one) for one in drives[1:]))


def untold(effects: Mapping[str, Effect], lost: Mapping[Link, str], silent: Mapping[Port, str]) -> dict[str, str]:
    """Effects that logs cannot tell, with the reason: their own link, or what they act on, cannot be seen."""
    reasons = {name: lost.get(links_of(one)[0]) or silent.get(one.port) for name, one in effects.items()}
    return {name: words for name, words in reasons.items() if words}
