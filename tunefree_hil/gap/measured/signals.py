"""A measured signal on every tick: values, ticks with a new value, gaps; and sensors at the end of their range.

A sensor at the end of its range has many equal values there and hardly any next to them. It does not follow the motion,
and would be taken for a scale or a limit of the car. Pedals and steering are not checked: what the end of an actuator's
range does is an effect of the catalogue.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.estimation.noise import estimate_sensor_noise
from tunefree_hil.gap.model.history import shift_earlier
from tunefree_hil.learn.drives.drive import INS_FIRST_SPEEDS, INS_FIRST_YAW_RATES, Drive
from tunefree_hil.learn.drives.runs import covered_rows, find_runs, sample_interval_ticks
from tunefree_hil.learn.drives.smoothing import interpolate_fresh
from tunefree_hil.learn.drives.validity import is_on_demand

Array = np.ndarray


class SignalCriteria(NamedTuple):
    """How signals are read (docs/results/criteria.md)."""

    min_interpolated_ticks: int = 3  # between two values, from which on the straight lines between them matter
    min_ins_coverage: float = 0.5  # of the chassis's rows: an INS that covers less is no second opinion


class SensorLimitCriteria(NamedTuple):
    """When a sensor is at the end of its range (docs/results/criteria.md)."""

    min_run_rows: int = 8  # equal values in a row
    min_runs: int = 2  # such runs at the end of the range
    # rows with the last value, to those with the next values together: noise and rounding give less
    pile_up_ratio: float = 5.0
    neighbour_values: int = 3  # values next to the last one that it is compared to


SIGNAL_CRITERIA, SENSOR_LIMIT_CRITERIA = SignalCriteria(), SensorLimitCriteria()
INS_PREFIX = "ins."
CHECKED_SENSORS = (
    "report.accel_mps2",
    "report.lateral_accel_mps2",
    "report.yaw_rate_radps",
    "ins.accel_mps2",
    "ins.yaw_rate_radps",
)


class Signal(NamedTuple):
    """A measured signal on every tick, straight lines between new values; the INS's is moved by its delay.

    Args:
        values: (ticks,).
        fresh: (ticks,), whether a new value came.
        is_valid: (ticks,), not within a gap.
        received: (ticks,), the values where they came; `values` moved by a fraction of a row are means of two of them,
            with less noise.
        delay_rows: by which `values` are moved, also a fraction.
        interval_rows: from one new value to the next.
    """

    values: Array
    fresh: Array
    is_valid: Array
    received: Array
    delay_rows: float = 0.0
    interval_rows: float = 1.0

    @property
    def noise(self) -> float:
        """Standard deviation of the sensor's white noise, or of the resolution error where that is larger."""
        return estimate_sensor_noise(self.received, np.flatnonzero(self.fresh & self.is_valid))

    def sample_at(self, values: Array, rows: Array) -> Array:
        """Another signal, (ticks,), when this sensor measured what came at `rows`."""
        return np.interp(rows - self.delay_rows, np.arange(len(values)), values)

    def resample(self, values: Array) -> Array:
        """Another signal, (ticks,), on straight lines between this one's new values."""
        if self.interval_rows < SIGNAL_CRITERIA.min_interpolated_ticks:
            return values
        ticks = np.arange(len(values))
        sampled = np.flatnonzero(self.fresh) - self.delay_rows
        return np.interp(ticks, sampled, np.interp(sampled, ticks, values))


def read_signals(drive: Drive, ins_delay_rows: float) -> dict[str, Signal]:
    """All signals of a drive by field name."""
    signals = {name: read_signal(drive, name, ins_delay_rows) for name in drive.fields}
    return {name: signal for name, signal in signals.items() if signal is not None}


def drop_sparse_ins(signals: Mapping[str, Signal], name: str) -> tuple[dict[str, Signal], tuple[str, ...]]:
    """Leave out an INS that covers little of a drive where the chassis measures the same.

    Without its speed all of the INS is left out, but for a yaw rate that the chassis does not measure.

    Args:
        signals: by field name.
        name: of the drive.

    Returns:
        The remaining signals, and what was left out as texts.
    """
    speed, (yaw, chassis_yaw) = INS_FIRST_SPEEDS[0], INS_FIRST_YAW_RATES
    if is_ins_sparse(signals, *INS_FIRST_SPEEDS):
        dropped = {key for key in signals if key.startswith(INS_PREFIX) and (key != yaw or chassis_yaw in signals)}
        share = signals[speed].is_valid.mean()
        text = f"{name}: the INS gives a speed in {share:.0%} of it only, so the INS is left out"
    elif is_ins_sparse(signals, *INS_FIRST_YAW_RATES):
        dropped, share = {yaw}, signals[yaw].is_valid.mean()
        text = f"{name}: the INS gives a yaw rate in {share:.0%} of it only, so that is left out"
    else:
        return dict(signals), ()
    return {key: signal for key, signal in signals.items() if key not in dropped}, (text,)


def is_ins_sparse(signals: Mapping[str, Signal], ins_field: str, chassis_field: str) -> bool:
    """Whether the INS covers much less of a drive than the chassis."""
    if ins_field not in signals or chassis_field not in signals:
        return False
    covered = signals[ins_field].is_valid.sum()
    return bool(covered < SIGNAL_CRITERIA.min_ins_coverage * signals[chassis_field].is_valid.sum())


def read_signal(drive: Drive, name: str, ins_delay_rows: float) -> Signal | None:
    """A field of a drive as a signal; None for one with hardly any values, or that is no report, INS or command."""
    values, fresh = drive.fields[name], drive.fresh[name] & np.isfinite(drive.fields[name])
    if not name.startswith(("report.", INS_PREFIX, "command.")) or fresh.sum() < 2:
        return None
    if name.endswith("heading_rad"):
        values = values.copy()
        values[fresh] = np.unwrap(values[fresh])
    signal = signal_from_values(values, fresh, drive.dt_s)
    if name.startswith(INS_PREFIX) and ins_delay_rows:
        is_valid = shift_earlier(signal.is_valid.astype(float), ins_delay_rows) > 0.999
        moved = shift_earlier(signal.values, ins_delay_rows)
        return signal._replace(values=moved, is_valid=is_valid, delay_rows=ins_delay_rows)
    return signal


def signal_from_values(values: Array, fresh: Array, dt_s: float) -> Signal:
    """A signal from values, (ticks,), of which at least two are fresh."""
    fresh = fresh & np.isfinite(values)
    interpolated = interpolate_fresh(values, fresh)
    is_valid = covered_rows(fresh, dt_s)
    return Signal(interpolated, fresh, is_valid, interpolated, interval_rows=sample_interval_ticks(fresh))


def find_valid_command_rows(signals: Mapping[str, Signal], names: tuple[str, ...], ticks: int) -> Array:
    """(ticks,): where the first of these signals that exists has no gap.

    True everywhere if none exists, or if it is sent on demand: then it pauses for most of a drive, and its last value
    holds.
    """
    for name in names:
        if name in signals:
            is_valid = signals[name].is_valid
            return np.ones(ticks, dtype=bool) if is_on_demand(is_valid) else is_valid
    return np.ones(ticks, dtype=bool)


class SensorLimit(NamedTuple):
    """The end of a sensor's range.

    Args:
        field: of the sensor.
        value: at the end.
        share: of the values that are there.
    """

    field: str
    value: float
    share: float

    @property
    def text(self) -> str:
        """The limit as a sentence."""
        return f"{self.field} is at the end of its range, {self.value:.4g}, in {self.share:.1%} of its values"


def find_sensor_limits(drive: Drive) -> list[SensorLimit]:
    """The ends of all ranges that the sensors of a drive reach."""
    limits = []
    for field in CHECKED_SENSORS:
        values = drive.get(field)
        if values is not None:
            received = values[drive.fresh[field] & np.isfinite(values)]
            limits += [SensorLimit(field, end, share) for end, share in _find_limits(received)]
    return limits


def drop_signals(drive: Drive, limits: list[SensorLimit]) -> Drive:
    """The drive without the sensors that have these limits."""
    dropped = {limit.field for limit in limits}
    return drive._replace(
        fields={name: values for name, values in drive.fields.items() if name not in dropped},
        fresh={name: rows for name, rows in drive.fresh.items() if name not in dropped},
    )


def _find_limits(values: Array) -> list[tuple[float, float]]:
    """(value, share) of each end at which values pile up; zero is left out, which is a standstill."""
    c = SENSOR_LIMIT_CRITERIA
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) < 4 * c.neighbour_values:
        return []
    limits = []
    for end, neighbours in ((0, slice(1, 1 + c.neighbour_values)), (-1, slice(-1 - c.neighbour_values, -1))):
        value = float(levels[end])
        is_piled_up = counts[end] > c.pile_up_ratio * counts[neighbours].sum()
        if value != 0.0 and is_piled_up and len(find_runs(values == value, c.min_run_rows)) >= c.min_runs:
            limits.append((value, float(counts[end]) / len(values)))
    return limits
