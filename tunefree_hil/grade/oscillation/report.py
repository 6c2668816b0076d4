"""What is said of a drive's oscillations: criteria, findings, and their text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum
from typing import Any, NamedTuple


class OscillationSignal(Enum):
    """What oscillates; the value names it in JSON."""

    STEER_COMMAND = "steer_command"
    STEER_MEASURED = "steer_measured"
    ACCEL = "accel"
    THROTTLE = "throttle"
    BRAKE = "brake"
    SPEED = "speed"
    PEDAL_ALTERNATION = "pedal_alternation"


class DrivePlace(Enum):
    """Where a drive is by its reference; the value names it in JSON."""

    AT_REST = "at_rest"
    STRAIGHT = "straight"
    IN_TURN = "in_turn"


class OscillationCriteria(NamedTuple):
    """Limits of a sustained swing, peak to peak in 0.5 to 5 Hz, and what sustains.

    Sensor noise and quantisation on the reference car sustain at most 0.9 deg of wheel, 0.1 m/s2, 1 % duty, 0.02 m/s.
    """

    steer_rad: float = 0.052  # wheel from steer_speed_mps up: 3 deg (issue 44); calm manual sets sustain 1-2.5 deg
    steer_speed_mps: float = 13.0  # below it the wheel for the same lateral acceleration, 0.2 m/s2: as 1 / speed^2
    max_steer_rad: float = 0.26  # wheel at low speed and at rest: 15 deg, which hands see and tyres feel
    accel_mps2: float = 0.5  # longitudinal (issue 44); ISO 2631-1: below 0.9 at 1-2 Hz not uncomfortable
    pedal_frac: float = 0.1  # duty of throttle or brake (issue 44)
    speed_mps: float = 0.15  # 0.5 m/s2 at 0.5 Hz; at higher frequencies the acceleration's limit is reached first
    explained_share: float = 0.05  # of what the reference explains there, added to a limit: it is not explained better
    switches_per_s: float = 0.5  # throttle to brake or back, beyond the reference's own: one every 2 s
    half_cycles: int = 6  # in a row that reach the amplitude: three cycles, over which damping 0.1 leaves 1/5
    max_half_cycle_s: float = 1.15  # 0.5 Hz and 15 %: a wheel that runs to its stops swings unevenly
    start_s: float = 3.0  # a start beside the plan decays in it; what shakes goes on
    early_end_s: float = 8.0  # a shorter drive left its lane: early_half_cycles are enough, all that some of them show
    early_half_cycles: int = 4  # two cycles
    motion_share: float = 0.3  # of the amplitude by which the signal itself turns there, before the high-pass
    run_share: float = 0.5  # of the amplitude: half cycles of that size before and after belong to it
    switches: int = 6  # in a row whose rate counts
    active_frac: float = 0.02  # duty above rest from which a pedal acts; quantisation and dead bands are below
    asked_accel_mps2: float = 0.1  # the reference asks for throttle above it, for brake below its negative
    asked_margin_s: float = 1.0  # before and after the switches in which a change of the reference's sign explains one
    rest_speed_mps: float = 0.3  # mean reference speed below which the place is at rest
    turn_accel_mps2: float = 0.5  # mean lateral acceleration of the reference above which it is a turn


CRITERIA = OscillationCriteria()


class OscillationFinding(NamedTuple):
    """The worst oscillation of a signal, also below its limit. amplitude and limit: peak to peak, in `unit`.

    limit: at the speed of that part of the drive.
    """

    signal: OscillationSignal
    amplitude: float
    limit: float
    unit: str
    frequency_hz: float
    from_s: float
    to_s: float
    place: DrivePlace
    speed_mps: float  # mean of the reference

    @property
    def ratio(self) -> float:
        """Amplitude / limit: a constraint is met up to 1."""
        return self.amplitude / self.limit


class OscillationReport(NamedTuple):
    """One finding of each signal that a drive contains and that swings at all."""

    findings: tuple[OscillationFinding, ...] = ()

    @property
    def worst(self) -> OscillationFinding | None:
        """The finding with the largest ratio; None where nothing swings."""
        return max(self.findings, key=lambda finding: finding.ratio, default=None)

    @property
    def worst_ratio(self) -> float:
        """The largest amplitude / limit, 0 where nothing swings."""
        return 0.0 if self.worst is None else self.worst.ratio

    @property
    def is_oscillating(self) -> bool:
        """Whether a signal is beyond its limit."""
        return self.worst_ratio > 1.0

    def ratio_of(self, *signals: OscillationSignal) -> float:
        """The largest amplitude / limit of these signals, 0 where none of them swings."""
        return max((finding.ratio for finding in self.findings if finding.signal in signals), default=0.0)


# rows of the table of metrics (grade/table.py): their signals
METRIC_SIGNALS = {
    "oscillation_steer": (OscillationSignal.STEER_COMMAND, OscillationSignal.STEER_MEASURED),
    "oscillation_accel": (OscillationSignal.ACCEL,),
    "oscillation_throttle": (OscillationSignal.THROTTLE,),
    "oscillation_brake": (OscillationSignal.BRAKE,),
    "oscillation_speed": (OscillationSignal.SPEED,),
    "pedal_alternation": (OscillationSignal.PEDAL_ALTERNATION,),
}


def oscillation_text(finding: OscillationFinding) -> str:
    """As in 'steering wheel swings 58 deg at 1.7 Hz from 3.2 to 14.0 s, straight, at 18 m/s'."""
    when = f"from {finding.from_s:.1f} to {finding.to_s:.1f} s"
    where = _PLACE_TEXT[finding.place]
    if finding.place is not DrivePlace.AT_REST:
        where += f", at {finding.speed_mps:.0f} m/s"
    if finding.signal is OscillationSignal.PEDAL_ALTERNATION:
        return f"throttle and brake alternate {finding.amplitude:.1f} times a second {when}, {where}"
    name, factor, unit = _SIGNAL_TEXT[finding.signal]
    amplitude = factor * finding.amplitude
    number = f"{amplitude:.0f}" if amplitude >= 10.0 else f"{amplitude:.2g}"
    return f"{name} swings {number} {unit} at {finding.frequency_hz:.1f} Hz {when}, {where}"


_PLACE_TEXT = {DrivePlace.AT_REST: "at rest", DrivePlace.STRAIGHT: "straight", DrivePlace.IN_TURN: "in a turn"}
_SIGNAL_TEXT = {
    OscillationSignal.STEER_COMMAND: ("steering wheel command", math.degrees(1.0), "deg"),
    OscillationSignal.STEER_MEASURED: ("steering wheel", math.degrees(1.0), "deg"),
    OscillationSignal.ACCEL: ("acceleration", 1.0, "m/s2"),
    OscillationSignal.THROTTLE: ("throttle", 100.0, "% duty"),
    OscillationSignal.BRAKE: ("brake", 100.0, "% duty"),
    OscillationSignal.SPEED: ("speed", 1.0, "m/s"),
}


def findings_as_data(report: OscillationReport) -> list[dict[str, Any]]:
    """Plain data of a report for JSON: one entry a finding."""
    return [finding_as_data(finding) for finding in report.findings]


def finding_as_data(finding: OscillationFinding) -> dict[str, Any]:
    """Plain data of a finding for JSON."""
    return {**finding._asdict(), "signal": finding.signal.value, "place": finding.place.value, "ratio": finding.ratio}


def finding_from_data(data: Mapping[str, Any]) -> OscillationFinding:
    """The inverse of `finding_as_data`."""
    fields = {name: data[name] for name in OscillationFinding._fields}
    return OscillationFinding(
        **{**fields, "signal": OscillationSignal(data["signal"]), "place": DrivePlace(data["place"])}
    )
