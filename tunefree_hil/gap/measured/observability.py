"""What logs cannot show, in words: by link of the chain, and by channel of the by-wire car.

A channel is idle where hardly any of its commands acted in any of the logs: by-wire was not enabled, or a person drove
over it. What it reported is known, so the motion can be judged; what its actuator makes of a command cannot. A channel
is unknown where the vehicle has it and a log says neither what was commanded nor what it did: what follows from it
cannot be judged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tunefree_hil.base.contracts import Effect, Link, Port, links_of
from tunefree_hil.gap.model.effect_chain import PORTS_A, PORTS_B, PORTS_OUT
from tunefree_hil.gap.model.graph import CHANNELS
from tunefree_hil.learn.actuators.samples import ECHOES

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec
    from tunefree_hil.gap.measured.chain import Opened
    from tunefree_hil.learn.drives.drive import Drive

OUTPUTS = {"throttle": "throttle_frac", "brake": "brake_frac", "steer": "steer_rad"}
ASKED_FOR = ("command.accel_mps2", f"report.{ECHOES['accel']}")  # commands that stand for both pedals
LEAST_ACTED_S = 4.0  # of a channel's commands: less is nothing that an actuator could be judged by
NOTHING_ACTED = "no command acted in these logs: by-wire was not enabled, or a person drove over it"


def idle_channels(drives: Sequence[Opened]) -> frozenset[str]:
    """Of all drives together."""
    return frozenset(name for name in CHANNELS if sum(one.acted_s.get(name, 0.0) for one in drives) < LEAST_ACTED_S)


def unknown_channels(drive: Drive, vehicle: VehicleSpec) -> frozenset[str]:
    """Those that a vehicle has and a drive says nothing of. One that nobody reports, whose commands may be sent on
    demand, is at rest where others are commanded and it is not.
    """
    commanded = any(name.startswith("command.") for name in drive.fields)
    lacking = {name for name in CHANNELS if not _says(drive, name)}
    silent = {name for name in lacking if _commands(vehicle, name) and not commanded}
    return frozenset(silent | {name for name in lacking if _reports(vehicle, name)})


def _reports(vehicle: VehicleSpec, channel: str) -> bool:
    return bool({OUTPUTS[channel], ECHOES[channel]} & set(vehicle.report))


def _commands(vehicle: VehicleSpec, channel: str) -> bool:
    return OUTPUTS[channel] in vehicle.command


def _says(drive: Drive, channel: str) -> bool:
    own = [f"command.{OUTPUTS[channel]}", f"report.{OUTPUTS[channel]}", f"report.{ECHOES[channel]}"]
    return any(drive.get(name) is not None for name in (*own, *(ASKED_FOR if channel != "steer" else ())))


def lost_of(signals: Mapping[str, Any], by_ins: bool) -> dict[Link, str]:
    """Links of which a log lacks a signal. signals: by field; by_ins: whether the speed is the INS's."""
    lost: dict[Link, str] = {}
    reported = [name for name in CHANNELS if f"report.{OUTPUTS[name]}" in signals]
    mute = [name for name in CHANNELS if f"report.{ECHOES[name]}" not in signals]
    if not reported:
        lost[Link.COMMAND_TO_REPORT] = "no actuator output is reported: the chain goes from commands to motion"
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
    lost = {link: drives[0].lost[link] for link in shared}
    reported = {name for name in CHANNELS if any(one.has(f"report.{OUTPUTS[name]}") for one in drives)}
    if reported and reported <= idle_channels(drives):
        lost[Link.COMMAND_TO_REPORT] = NOTHING_ACTED
    return lost


def silent_ports(drives: Sequence[Opened]) -> dict[Port, str]:
    """Ports of which none of the drives tells anything."""
    idle, unknown = idle_channels(drives), drives[0].unknown.intersection(*(one.unknown for one in drives))
    found: dict[Port, str] = {}
    for i, name in enumerate(CHANNELS):
        if name in idle:
            found |= dict.fromkeys((PORTS_A[i], PORTS_OUT[i]), f"no command of the {name} acted in these logs")
        if name in unknown:
            words = f"neither commands nor reports say what the {name} did"
            found |= dict.fromkeys((PORTS_A[i], PORTS_OUT[i], PORTS_B[i]), words)
    return found


def untold(effects: Mapping[str, Effect], lost: Mapping[Link, str], silent: Mapping[Port, str]) -> dict[str, str]:
    """Effects that logs cannot tell, with the reason: their own link, or what they act on, cannot be seen."""
    reasons = {name: lost.get(links_of(one)[0]) or silent.get(one.port) for name, one in effects.items()}
    return {name: words for name, words in reasons.items() if words}
