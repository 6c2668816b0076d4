"""What logs cannot show: links of the chain, ports, and effects, each with the reason as text.

A channel is idle if hardly any of its commands acted in any of the logs: by-wire was not enabled, or a person drove.
Its reported output is known, so the motion can be judged; its actuator cannot. A channel is unknown if the vehicle has
it and the log holds neither its commands nor its output: what follows from it cannot be judged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tunefree_hil.base.contracts import Effect, Link, Port, links_of
from tunefree_hil.gap.model.effect_chain import PORTS_A, PORTS_B, PORTS_OUT
from tunefree_hil.gap.model.graph import CHANNELS
from tunefree_hil.gap.selection.reasons import Criterion, Reason, RejectionStage
from tunefree_hil.learn.actuators.samples import ECHOES

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec
    from tunefree_hil.gap.measured.chain import MeasuredDrive
    from tunefree_hil.learn.drives.drive import Drive

OUTPUT_FIELDS = {"throttle": "throttle_frac", "brake": "brake_frac", "steer": "steer_rad"}
ACCEL_COMMANDS = ("command.accel_mps2", f"report.{ECHOES['accel']}")  # for both pedals
MIN_ACTIVE_S = 4.0  # of a channel's commands, to judge its actuator (docs/results/criteria.md)
NO_ACTIVE_COMMAND = "no command acted in these logs: by-wire was not enabled, or a person drove"


def find_idle_channels(drives: Sequence[MeasuredDrive]) -> frozenset[str]:
    """The channels that are idle in all drives together."""
    return frozenset(
        name for name in CHANNELS if sum(drive.command_active_s.get(name, 0.0) for drive in drives) < MIN_ACTIVE_S
    )


def find_unknown_channels(drive: Drive, vehicle: VehicleSpec) -> frozenset[str]:
    """The channels that a vehicle has and a drive does not hold.

    A channel that is never reported and whose commands may be sent on demand is at rest, not unknown, where other
    channels are commanded and it is not.
    """
    has_commands = any(name.startswith("command.") for name in drive.fields)
    missing = {name for name in CHANNELS if not _is_recorded(drive, name)}
    uncommanded = {name for name in missing if _is_commanded(vehicle, name) and not has_commands}
    return frozenset(uncommanded | {name for name in missing if _is_reported(vehicle, name)})


def _is_reported(vehicle: VehicleSpec, channel: str) -> bool:
    return bool({OUTPUT_FIELDS[channel], ECHOES[channel]} & set(vehicle.report))


def _is_commanded(vehicle: VehicleSpec, channel: str) -> bool:
    return OUTPUT_FIELDS[channel] in vehicle.command


def _is_recorded(drive: Drive, channel: str) -> bool:
    own = [f"command.{OUTPUT_FIELDS[channel]}", f"report.{OUTPUT_FIELDS[channel]}", f"report.{ECHOES[channel]}"]
    return any(drive.get(name) is not None for name in (*own, *(ACCEL_COMMANDS if channel != "steer" else ())))


def find_missing_links(signals: Mapping[str, Any], uses_ins_speed: bool) -> dict[Link, str]:
    """Links for which a log lacks a signal, with the reason.

    Args:
        signals: by field name.
        uses_ins_speed: whether the speed is the INS's.
    """
    missing: dict[Link, str] = {}
    has_outputs = any(f"report.{OUTPUT_FIELDS[name]}" in signals for name in CHANNELS)
    has_echoes = any(f"report.{ECHOES[name]}" in signals for name in CHANNELS)
    if not has_outputs:
        missing[Link.COMMAND_TO_REPORT] = "no actuator output is reported: the chain goes from commands to motion"
    if not has_echoes:
        missing[Link.COMMAND_ECHO] = "no command is echoed"
    if not uses_ins_speed or "report.speed_mps" not in signals:
        missing[Link.WHEEL_VS_INS] = "only one of chassis and INS gives the speed"
    if "ins.yaw_rate_radps" not in signals or "report.yaw_rate_radps" not in signals:
        missing[Link.YAW_VS_INS] = "only one of chassis and INS gives the yaw rate"
    if "report.accel_mps2" not in signals:
        missing[Link.ACCEL_VS_DVDT] = "no longitudinal acceleration is reported"
    if not uses_ins_speed and not has_echoes:
        missing[Link.CLOCK] = "there is no second clock: neither an INS nor echoes of commands"
    return missing


def find_unobservable_links(drives: Sequence[MeasuredDrive]) -> dict[Link, str]:
    """Links that no drive shows, with the reason."""
    shared = set(drives[0].unobservable_links)
    for drive in drives[1:]:
        shared &= set(drive.unobservable_links)
    links = {link: drives[0].unobservable_links[link] for link in shared}
    reported = {
        name for name in CHANNELS if any(drive.has_signals(f"report.{OUTPUT_FIELDS[name]}") for drive in drives)
    }
    if reported and reported <= find_idle_channels(drives):
        links[Link.COMMAND_TO_REPORT] = NO_ACTIVE_COMMAND
    return links


def find_unobservable_ports(drives: Sequence[MeasuredDrive]) -> dict[Port, str]:
    """Ports that no drive shows, with the reason."""
    idle = find_idle_channels(drives)
    unknown = drives[0].unknown_channels.intersection(*(drive.unknown_channels for drive in drives))
    ports: dict[Port, str] = {}
    for i, name in enumerate(CHANNELS):
        if name in idle:
            ports |= dict.fromkeys((PORTS_A[i], PORTS_OUT[i]), f"no command of the {name} acted in these logs")
        if name in unknown:
            reason = f"the logs hold neither commands nor reports of the {name}"
            ports |= dict.fromkeys((PORTS_A[i], PORTS_OUT[i], PORTS_B[i]), reason)
    return ports


def find_untestable_effects(
    effects: Mapping[str, Effect], unobservable_links: Mapping[Link, str], unobservable_ports: Mapping[Port, str]
) -> dict[str, Reason]:
    """Why effects cannot be seen whose own link or whose port is not in the logs."""
    reasons = {}
    for name, effect in effects.items():
        link, port = links_of(effect)[0], effect.port
        place = link if link in unobservable_links else port
        note = unobservable_links.get(link) or unobservable_ports.get(port)
        if note:
            reasons[name] = Reason(
                Criterion.UNOBSERVABLE, name, key=place.value, stage=RejectionStage.UNTESTABLE, note=note
            )
    return reasons
