"""Commands and outputs of a by-wire channel on one time base, tick by tick.

A report that carries the output and an echo of the command needs no transport correction: the echo is the command that
the actuator had in the tick at whose end the output stands, as in `plant/actuation/actuators.py`. Between two such
reports the command on the bus is used, shifted so that it agrees with the echo. Without an echo the command on the bus
is delayed as on the bench ([timing]: one tick each way, and one for the step itself).

The output may stop short of its command. That is neither a wrong gain nor a lag, so before the channel is identified
commands are clipped at the one that reaches the stop. The stop itself is an effect that `gap` identifies.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tunefree_hil.learn.drives.drive import Array, Drive, DrivePart
from tunefree_hil.learn.drives.runs import find_runs
from tunefree_hil.learn.drives.smoothing import estimate_quantum, estimate_rate, interpolate_fresh, select_speed
from tunefree_hil.plant.actuation.acceleration_interface import FULL_MPS2

CHANNELS = {
    "throttle": "throttle_frac",
    "brake": "brake_frac",
    "steer": "steer_rad",
    "accel": "accel_mps2",
    "steer_torque": "steer_torque_nm",
}
ECHOES = {
    "throttle": "throttle_command_frac",
    "brake": "brake_command_frac",
    "steer": "steer_command_rad",
    "accel": "accel_command_mps2",
    "steer_torque": "steer_torque_command_nm",
}
BENCH_TICKS = 3  # the delay on the bench: command, step, report
NO_AGES = np.zeros(0)


class SampleCriteria(NamedTuple):
    """Which rows of a channel are compared; every value is an engineering choice."""

    max_echo_delay_s: float = 0.3  # longest time from a command on the bus to its echo
    min_agreeing_share: float = 0.9  # of the changes of the echo, that the command on the bus explains
    max_silence_s: float = 0.2  # longest time between two reports of the output
    warm_up_s: float = 1.0  # at the start of a segment, not compared: the history is unknown
    min_segment_s: float = 3.0  # a shorter segment is left out
    min_age_std_s: float = 5e-4  # of command ages; less is the jitter of the bus
    rate_window_s: float = 0.5  # of the filter that gives the rate of the speed, where that is the output


class StopCriteria(NamedTuple):
    """A stop is one level at which the output rests while commands of several sizes exceed it."""

    min_rest_s: float = 0.3  # of the output at the stop; longer than the lags of such channels
    max_ripple_share: float = 0.01  # of the output's span, by which a resting output moves
    min_excess_share: float = 0.05  # of the span, by which commands exceed the stop, and by which they differ there
    min_total_rest_s: float = 0.5  # beyond min_rest_s, in all
    min_stops: int = 2  # separate rests at the stop
    min_steady_s: float = 0.6  # of a command and its output, for the gain at rest; longer than dead times
    min_steady_rows: int = 20  # with fewer there is no gain at rest
    min_steady_range_share: float = 0.2  # of the span, that the steady commands cover


SAMPLES = SampleCriteria()
STOPS = StopCriteria()


class ActuatorSamples(NamedTuple):
    """One segment of a channel without a gap; arrays of shape (n_rows,)."""

    command: Array  # held during the tick
    output: Array  # at the end of the tick, NaN where none was reported
    is_compared: Array  # rows in which a simulated output is compared with `output`
    dt_s: float
    filter_ticks: int = 0  # length of the rate filter that gave `output`, 0 for none; a simulation passes it too


class ChannelSamples(NamedTuple):
    """All segments of a channel. command_age_std_s: of the command's age at its echo, 0 for commands on the ticks."""

    channel: str
    segments: tuple[ActuatorSamples, ...]
    description: str  # where the commands come from
    command_age_std_s: float = 0.0

    @property
    def n_rows(self) -> int:
        """The number of compared rows."""
        return sum(int(segment.is_compared.sum()) for segment in self.segments)


class ChannelRecord(NamedTuple):
    """Command and output of a channel over a whole drive, as in ActuatorSamples."""

    command: Array
    output: Array
    is_fresh: Array
    filter_ticks: int
    source: str


class ChannelActuation(NamedTuple):
    """What a channel's actuator does in each tick of a drive; arrays of shape (n_rows,)."""

    command: Array
    output: Array  # as recorded, interpolated; NaN where none is reported
    follows_command: Array


def collect_samples(parts: Iterable[DrivePart], channel: str) -> ChannelSamples:
    """Command and output of a channel in `parts`; without segments where the logs do not have both."""
    segments: list[ActuatorSamples] = []
    sources: list[str] = []
    ages: list[Array] = []
    for part in parts:
        record = _read_channel(part.drive, channel)
        if record is None:
            continue
        sources += [record.source] if record.source not in sources else []
        ages += [part.drive.command_ages.get(f"report.{ECHOES[channel]}", NO_AGES)]
        segments += cut_segments(record, _find_segments(part, record), part.drive.dt_s)
    all_ages = np.concatenate([NO_AGES, *ages])
    age_std_s = float(all_ages.std()) if len(all_ages) else 0.0
    if age_std_s > SAMPLES.min_age_std_s:
        mean_ms, std_ms = 1e3 * all_ages.mean(), 1e3 * age_std_s
        sources.append(f"commands come {mean_ms:.1f} ms before it, standard deviation {std_ms:.1f} ms")
    return ChannelSamples(channel, tuple(segments), "; ".join(sources), age_std_s)


def cut_segments(record: ChannelRecord, runs: Iterable[tuple[int, int]], dt_s: float) -> list[ActuatorSamples]:
    """The rows [begin, end) of each run as a segment; those without a compared row are left out."""
    segments = []
    for begin, end in runs:
        command, output = record.command[begin:end], record.output[begin:end]
        is_compared = record.is_fresh[begin:end] & np.isfinite(output)
        is_compared[: round(SAMPLES.warm_up_s / dt_s)] = False
        if is_compared.any():
            segments.append(ActuatorSamples(command, output, is_compared, dt_s, record.filter_ticks))
    return segments


def clip_to_stops(training: ChannelSamples, held_out: ChannelSamples) -> tuple[ChannelSamples, ChannelSamples]:
    """Both with commands clipped at the channel's stops, which are found from all segments together."""
    segments = (*training.segments, *held_out.segments)
    low, high = find_stops(segments)
    if math.isinf(low) and math.isinf(high):
        return training, held_out
    ends = commands_at_outputs(segments, low, high)
    stops = describe_stops(segments, *ends)

    def clip(samples: ChannelSamples) -> ChannelSamples:
        clipped = tuple(clip_commands(segment, *ends) for segment in samples.segments)
        return samples._replace(segments=clipped, description=f"{samples.description}; {stops}")

    return clip(training), clip(held_out)


def _read_channel(drive: Drive, channel: str) -> ChannelRecord | None:
    """A channel over a whole drive; None where the drive lacks the command or the output."""
    name, command = f"report.{CHANNELS[channel]}", _acting_command(drive, channel)
    if command is None:
        return None
    if channel == "accel":
        return _record_from_speed(drive, command)
    output = drive.get(name)
    if output is None:
        return None
    if drive.get(f"report.{ECHOES[channel]}") is None:
        source = f"no echo: commands are delayed by {BENCH_TICKS} ticks, as on the bench"
    else:
        source = "command and output from the same report"
        has_wire = drive.get(f"command.{CHANNELS[channel]}") is not None
        source += ", the command on the bus between two reports" if has_wire else ""
    return ChannelRecord(command, output, drive.fresh[name], 0, source)


def _acting_command(drive: Drive, channel: str) -> Array | None:
    """The command of a channel at the ticks in which it acts; None where the log has neither command nor echo."""
    wire, echo_name = drive.get(f"command.{CHANNELS[channel]}"), f"report.{ECHOES[channel]}"
    echo = drive.get(echo_name)
    if echo is not None:
        return command_from_echo(echo, drive.fresh[echo_name], wire, drive.dt_s)
    return None if wire is None else shift_later(wire, BENCH_TICKS)


def _record_from_speed(drive: Drive, command: Array) -> ChannelRecord | None:
    """With the rate of the car's speed as the output of an acceleration channel."""
    selected = select_speed(drive)
    if selected is None:
        return None
    speed, fresh = selected
    window = max(round(SAMPLES.rate_window_s / drive.dt_s) | 1, 5)
    rate = estimate_rate(speed, fresh, window, drive.dt_s)
    return ChannelRecord(command, rate, fresh, window, "from the motion: the rate of the speed")


def command_from_echo(echo: Array, fresh: Array, wire: Array | None, dt_s: float) -> Array:
    """The command of every tick: the echo in a fresh report, and between two reports the command on the bus.

    The command on the bus is used where it agrees with both echoes. It does not where the by-wire unit ramps or limits
    it, or where the driver presses a pedal; a straight line between the echoes takes its place.

    Args:
        echo, fresh: shape (n_rows,).
        wire: the command on the bus in the tick in which it was sent, shape (n_rows,).
        dt_s: length of a tick.
    """
    ticks = np.flatnonzero(fresh & np.isfinite(echo))
    if len(ticks) < 2 or len(ticks) == ticks[-1] - ticks[0] + 1:
        return echo.copy()
    command = np.where(np.isfinite(echo), np.interp(np.arange(len(echo)), ticks, echo[ticks]), np.nan)
    max_shift = round(SAMPLES.max_echo_delay_s / dt_s)
    shift = None if wire is None else find_wire_shift(echo, wire, ticks, max_shift)
    if wire is None or shift is None:
        return command
    shifted = shift_later(wire, shift)
    agrees = np.abs(shifted[ticks] - echo[ticks]) <= rounding_tolerance(echo[ticks])
    report = np.clip(np.searchsorted(ticks, np.arange(len(echo)), side="right") - 1, 0, len(ticks) - 2)
    is_used = agrees[report] & agrees[report + 1] & np.isfinite(shifted) & np.isfinite(command)
    is_used[ticks] = False
    command[is_used] = shifted[is_used]
    return command


def find_wire_shift(echo: Array, wire: Array, ticks: Array, max_shift: int) -> int | None:
    """The delay in rows at which the command on the bus agrees with the echo before and after each change.

    Of several such delays (every change falls in the same half of a report's period), the one nearest to BENCH_TICKS.

    Args:
        echo, wire: shape (n_rows,).
        ticks: rows of fresh echoes.
        max_shift: the longest delay to try.

    Returns:
        None where no delay makes them agree.
    """
    tolerance = rounding_tolerance(echo[ticks])
    changes = np.flatnonzero(np.abs(np.diff(echo[ticks])) > tolerance)
    changes = changes[ticks[changes] >= max_shift]
    if not len(changes):
        return BENCH_TICKS
    rows = np.concatenate([ticks[changes], ticks[changes + 1]])
    shares = [float(np.mean(np.abs(wire[rows - shift] - echo[rows]) <= tolerance)) for shift in range(max_shift + 1)]
    best = min(range(max_shift + 1), key=lambda shift: (-round(shares[shift], 3), abs(shift - BENCH_TICKS)))
    return best if shares[best] >= SAMPLES.min_agreeing_share else None


def rounding_tolerance(values: Array) -> float:
    """By how much two roundings of one number may differ: one and a half quantisation steps."""
    return 1.5 * estimate_quantum(values) + 1e-9


def shift_later(values: Array, rows: int) -> Array:
    """The same signal `rows` rows later; NaN at its beginning."""
    shifted = np.full_like(values, np.nan)
    shifted[rows:] = values[: len(values) - rows]
    return shifted


def _find_segments(part: DrivePart, record: ChannelRecord) -> list[tuple[int, int]]:
    """Rows [begin, end) of a part in which by-wire control is enabled and the output is reported without a silence."""
    drive = part.drive
    is_good = np.isfinite(record.command) & np.isfinite(record.output) & drive.enabled
    max_age = round(SAMPLES.max_silence_s / drive.dt_s)
    reports, rows = np.flatnonzero(record.is_fresh), np.arange(len(record.is_fresh))
    last = np.searchsorted(reports, rows, side="right") - 1
    age = np.where(last >= 0, rows - reports[np.maximum(last, 0)] if len(reports) else 0, max_age + 1)
    is_good &= age <= max_age
    return find_runs(is_good[part.begin : part.end], round(SAMPLES.min_segment_s / drive.dt_s), part.begin)


def has_channel(drives: Sequence[Drive], channel: str) -> bool:
    """Whether any log has a command of this channel, or its echo."""
    names = (f"command.{CHANNELS[channel]}", f"report.{ECHOES[channel]}")
    return any(drive.get(name) is not None for drive in drives for name in names)


def find_stops(segments: Sequence[ActuatorSamples]) -> tuple[float, float]:
    """(lowest, highest) output that the channel reaches, in its unit; infinite where the samples show no stop."""
    span = _output_span(segments)
    if not span > 0.0:
        return -math.inf, math.inf
    return -_find_upper_stop(segments, -1.0, span), _find_upper_stop(segments, 1.0, span)


def _output_span(segments: Sequence[ActuatorSamples]) -> float:
    outputs = [segment.output[segment.is_compared] for segment in segments]
    return float(np.ptp(np.concatenate(outputs))) if outputs else 0.0


def clip_commands(segment: ActuatorSamples, low: float, high: float) -> ActuatorSamples:
    """The segment with its commands clipped."""
    return segment._replace(command=np.clip(segment.command, low, high))


def commands_at_outputs(segments: Sequence[ActuatorSamples], low: float, high: float) -> tuple[float, float]:
    """The commands (low, high) that reach these outputs, by the channel's gain and offset at rest."""
    gain, offset = _fit_gain_at_rest(segments, low, high)
    return (low - offset) / gain, (high - offset) / gain


def _fit_gain_at_rest(segments: Sequence[ActuatorSamples], low: float, high: float) -> tuple[float, float]:
    """(gain, offset) of outputs that rest between these stops under a constant command; (1, 0) where too few do."""
    span = _output_span(segments)
    steady = list[Array]()
    for segment in segments:
        windows = _compared_windows(segment, STOPS.min_steady_s)
        if windows.length > len(windows.rows):
            continue
        output = sliding_window_view(segment.output[windows.rows], windows.length)
        command = sliding_window_view(segment.command[windows.rows], windows.length)
        output = output[:, -max(windows.length // 3, 2) :]  # at the end of the window, once it has settled
        level, ripple = output.mean(axis=1), STOPS.max_ripple_share * span
        is_steady = (np.ptp(output, axis=1) <= ripple) & (np.ptp(command, axis=1) <= ripple)
        margin = STOPS.min_excess_share * span
        is_steady &= (level > low + margin) & (level < high - margin)
        steady.append(np.stack([command.mean(axis=1)[is_steady], level[is_steady]]))
    commands, outputs = np.concatenate(steady, axis=1) if steady else np.zeros((2, 0))
    if len(commands) < STOPS.min_steady_rows or float(np.ptp(commands)) < STOPS.min_steady_range_share * span:
        return 1.0, 0.0
    gain, offset = (float(coefficient) for coefficient in np.polyfit(commands, outputs, 1))
    return (gain, offset) if gain > 0.0 else (1.0, 0.0)


def describe_stops(segments: Sequence[ActuatorSamples], low: float, high: float) -> str:
    """A text on the commands (low, high) at which the channel stops, '' where it does not."""
    ends = " and ".join(f"{end:.4g}" for end in (low, high) if math.isfinite(end))
    if not ends:
        return ""
    command = np.concatenate([segment.command[segment.is_compared] for segment in segments])
    share = float(np.mean((command < low) | (command > high)))
    return f"it stops at a command of {ends}, which {share:.1%} of its commands exceed"


class _ComparedWindows(NamedTuple):
    """The compared rows, the length of a window in them (more than there are if unknown), their interval in s."""

    rows: Array
    length: int
    interval_s: float


def _compared_windows(segment: ActuatorSamples, window_s: float) -> _ComparedWindows:
    rows = np.flatnonzero(segment.is_compared)
    interval_s = segment.dt_s * float(np.median(np.diff(rows))) if len(rows) > 1 else math.inf
    length = max(round(window_s / interval_s), 2) if math.isfinite(interval_s) else len(rows) + 1
    return _ComparedWindows(rows, length, interval_s)


def _find_upper_stop(segments: Sequence[ActuatorSamples], sign: float, span: float) -> float:
    """The upper stop of `sign` times the output, infinite without one."""
    highest = max(float((sign * segment.output[segment.is_compared]).max()) for segment in segments)
    levels, commands, rest_s, n_stops = list[Array](), list[Array](), 0.0, 0
    ripple, excess = STOPS.max_ripple_share * span, STOPS.min_excess_share * span
    for segment in segments:
        windows = _compared_windows(segment, STOPS.min_rest_s)
        if windows.length > len(windows.rows):
            continue
        output = sliding_window_view(sign * segment.output[windows.rows], windows.length)
        command = sliding_window_view(sign * segment.command[windows.rows], windows.length)
        level, min_command = output.mean(axis=1), command.min(axis=1)
        is_stopped = (np.ptp(output, axis=1) <= ripple) & (level >= highest - ripple)
        is_stopped &= min_command >= level + excess
        levels.append(level[is_stopped])
        commands.append(min_command[is_stopped])
        rest_s += float(is_stopped.sum()) * windows.interval_s
        stopped_rows = np.flatnonzero(is_stopped)
        n_stops += int(np.sum(np.diff(stopped_rows, prepend=-windows.length) >= windows.length))
    if rest_s < STOPS.min_total_rest_s or n_stops < STOPS.min_stops:
        return math.inf
    if float(np.ptp(np.concatenate(commands))) < excess:
        return math.inf
    return float(np.median(np.concatenate(levels)))


def read_actuation(drive: Drive, channel: str, rest: float) -> ChannelActuation:
    """Command and recorded output of a channel over a whole drive, at the ticks in which they act.

    A vehicle without the channel has its command at `rest` throughout.
    """
    name = f"report.{CHANNELS[channel]}"
    reported, missing = drive.get(name), np.full(drive.n_rows, np.nan)
    if reported is None and drive.get(f"command.{CHANNELS[channel]}") is None:
        return ChannelActuation(np.full(drive.n_rows, rest), missing, np.ones(drive.n_rows, dtype=bool))
    output = missing if reported is None else interpolate_fresh(reported, drive.fresh[name])
    command = _acting_command(drive, channel)
    if command is None:
        return ChannelActuation(missing, output, np.zeros(drive.n_rows, dtype=bool))
    acts = drive.enabled
    if drive.get(f"report.{ECHOES[channel]}") is not None:
        acts = acts | ~np.isfinite(output)  # a driver moves the output, while the echo of the command may stay at rest
    return ChannelActuation(command, output, np.isfinite(command) & acts)


def read_accel_command(drive: Drive) -> Array | None:
    """The commanded acceleration at the ticks in which it acts; None for a car whose log shows pedals."""
    has_pedals = any(f"{group}.throttle_frac" in drive.fields for group in ("command", "report"))
    return None if has_pedals else _acting_command(drive, "accel")


def pedals_from_accel_command(accel_command: Array, enabled: Array, rest: float) -> list[ChannelActuation]:
    """Throttle and brake, like those of read_actuation, of a car with commanded acceleration."""
    missing, follows_command = np.full(len(accel_command), np.nan), np.isfinite(accel_command) & enabled
    throttle, brake = np.maximum(accel_command, 0.0), np.maximum(-accel_command, 0.0)
    return [ChannelActuation(rest + pedal / FULL_MPS2, missing, follows_command) for pedal in (throttle, brake)]
