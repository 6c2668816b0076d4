"""What is compared of a drive, link by link: the same linear functional of the measured and the simulated signals.

Two sensors of the same quantity are compared by their difference, so that the car model's errors cancel out.

Both sides have the same column names and the same smoothing. `travel` is the running sum of the simulated rate of
speed, and the measured speed: its slope over a short window is the acceleration of either.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import convolve1d
from scipy.signal import savgol_coeffs

from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.measured.chain import MeasuredDrive
from tunefree_hil.gap.measured.observability import OUTPUT_FIELDS
from tunefree_hil.gap.measured.signals import Signal
from tunefree_hil.gap.model.graph import CHANNELS, DriveInputs
from tunefree_hil.gap.model.kernels import SIMULATED_FIELDS
from tunefree_hil.learn.drives.smoothing import estimate_quantum

Array = np.ndarray


class TargetCriteria(NamedTuple):
    """Which rows are compared (docs/results/criteria.md)."""

    interval_s: float = 0.05  # between two rows
    output_interval_s: float = 0.02  # between two rows of an actuator's report
    window_s: float = 0.21  # of the smoothing polynomials; delays of a few hundredths of a second remain visible
    min_speed_mps: float = 1.5  # below it a car creeps, sticks or stands, which a single-track model does not describe
    min_rows: int = 200  # of all drives together; of one drive its share of these, but at least min_drive_rows
    min_drive_rows: int = 40  # of one drive, however short it is
    # In tighter turns the front tyres work against each other as far as the linkage does not turn each for its own
    # circle. The speed that this costs, t²/L² C δ⁴ / m, is in no single-track model: 0.016 m/s² here, 0.06 at 0.33 rad.
    max_gentle_rad: float = 0.24
    min_gentle_share: float = 0.5  # of the rows; a car that drives tight turns only is taken as it is
    standstill_share: float = 1e-9  # of a signal's greatest value: a smaller span is rounding of numbers
    flicker_steps: float = 2.0  # resolution steps of the bus: a report with a smaller span stands still


TARGET_CRITERIA = TargetCriteria()
N_OUTPUTS = len(CHANNELS)  # columns of SIMULATED_FIELDS that are outputs


class Target(NamedTuple):
    """One thing that is compared in one drive.

    Args:
        name: of the target.
        link: that it belongs to.
        unit: of `measured`, `quantum`, `size`, `noise`.
        rows: (n_rows,) indices into the drive.
        valid: (n_rows,), whether the row counts.
        measured: (n_rows,).
        dt_s: time between two rows.
        quantum: resolution of the bus, as far as the functional lets it through.
        size: deviation of the signal (of a difference of two sensors, of what both sense), above 0.
        noise: of the sensors, as far as the functional lets it through.
    """

    name: str
    link: Link
    unit: str
    rows: Array
    valid: Array
    measured: Array
    dt_s: float
    quantum: float
    size: float
    noise: float = 0.0


class SignalColumns:
    """The signals of a drive, simulated or measured, by the names of SIMULATED_FIELDS, and `travel`."""

    def __init__(self, columns: dict[str, Array], dt_s: float) -> None:
        self.columns, self.dt_s = columns, dt_s
        self.window = max(round(TARGET_CRITERIA.window_s / dt_s) | 1, 5)

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def mean(self, values: Array) -> Array:
        """The smoothed signal."""
        return convolve1d(values, _smoothing_taps(self.window, 0, self.dt_s), mode="nearest")

    def slope(self, values: Array) -> Array:
        """The rate of the smoothed signal, per s."""
        return convolve1d(values, _smoothing_taps(self.window, 1, self.dt_s), mode="nearest")


Functional = Callable[[SignalColumns], Array]


def _speed_rate(c: SignalColumns) -> Array:
    return c.slope(c["travel"])


def _ins_yaw_rate(c: SignalColumns) -> Array:
    return c.mean(c["ins_yaw_rate_radps"])


def _report_yaw_rate(c: SignalColumns) -> Array:
    return c.mean(c["yaw_rate_radps"])


def _lateral_excess(c: SignalColumns) -> Array:
    """Lateral acceleration less speed times yaw rate: side slip and gravity."""
    return c.mean(c["lateral_accel_mps2"] - c["ins_speed_mps"] * c["ins_yaw_rate_radps"])


def _lateral_accel(c: SignalColumns) -> Array:
    return c.mean(c["lateral_accel_mps2"])


def _wheel_speed_error(c: SignalColumns) -> Array:
    return c.mean(c["speed_mps"] - c["ins_speed_mps"])


def _yaw_rate_error(c: SignalColumns) -> Array:
    return c.mean(c["yaw_rate_radps"] - c["ins_yaw_rate_radps"])


def _accel_error(c: SignalColumns) -> Array:
    return c.mean(c["accel_mps2"]) - c.slope(c["travel"])


MOTION_LINK = Link.REPORT_TO_MOTION
PEDALS, STEERING = frozenset({"throttle", "brake"}), frozenset({"steer"})


class TargetSpec(NamedTuple):
    """A target that a drive may have.

    Args:
        name, link, unit, functional: of the target.
        required: fields that have to be measured.
        superseded_by: fields in whose presence another target is better.
        channels: channels that must not be unknown.
        excludes_tight_turns: whether rows in tight turns do not count, as long as most rows are not in one.
    """

    name: str
    link: Link
    unit: str
    functional: Functional
    required: tuple[str, ...] = ()
    superseded_by: tuple[str, ...] = ()
    channels: frozenset[str] = frozenset()
    excludes_tight_turns: bool = False


TARGET_SPECS = (
    TargetSpec("rate_of_speed", MOTION_LINK, "m/s2", _speed_rate, channels=PEDALS, excludes_tight_turns=True),
    TargetSpec("yaw_rate", MOTION_LINK, "rad/s", _ins_yaw_rate, ("ins.yaw_rate_radps",), channels=STEERING),
    TargetSpec(
        "yaw_rate",
        MOTION_LINK,
        "rad/s",
        _report_yaw_rate,
        ("report.yaw_rate_radps",),
        superseded_by=("ins.yaw_rate_radps",),
        channels=STEERING,
    ),
    TargetSpec(
        "lateral_beyond_turning",
        MOTION_LINK,
        "m/s2",
        _lateral_excess,
        ("report.lateral_accel_mps2", "ins.speed_mps", "ins.yaw_rate_radps"),
        channels=STEERING,
    ),
    TargetSpec(
        "lateral_accel",
        MOTION_LINK,
        "m/s2",
        _lateral_accel,
        ("report.lateral_accel_mps2",),
        superseded_by=("ins.speed_mps", "ins.yaw_rate_radps"),
        channels=STEERING,
    ),
    TargetSpec("wheel_vs_ins", Link.WHEEL_VS_INS, "m/s", _wheel_speed_error, ("report.speed_mps", "ins.speed_mps")),
    TargetSpec(
        "yaw_vs_ins", Link.YAW_VS_INS, "rad/s", _yaw_rate_error, ("report.yaw_rate_radps", "ins.yaw_rate_radps")
    ),
    TargetSpec("accel_vs_dvdt", Link.ACCEL_VS_DVDT, "m/s2", _accel_error, ("report.accel_mps2",)),
)


SENSED_QUANTITIES: dict[str, Callable[[DriveInputs], Array]] = {  # what both sensors of a difference sense
    "wheel_vs_ins": lambda x: x.speed_mps,
    "yaw_vs_ins": lambda x: x.yaw_rate_radps,
    "accel_vs_dvdt": lambda x: x.speed_rate_mps2,
    "lateral_beyond_turning": lambda x: x.speed_mps * x.yaw_rate_radps,
}


class DriveComparison:
    """All targets of a drive, and the residuals of a simulation at them."""

    def __init__(self, drive: MeasuredDrive, share: float = 1.0) -> None:
        """Find the targets that a drive has. share: of the rows of all drives, those of this drive."""
        self.drive = drive
        self._min_rows = max(TARGET_CRITERIA.min_rows * share, TARGET_CRITERIA.min_drive_rows)
        self._functionals: list[Functional] = []
        self.targets: list[Target] = []
        self._latest: tuple[Array, list[Array]] | None = None  # often only the outputs of the next one differ
        columns = build_measured_columns(drive)
        for i, channel in enumerate(CHANNELS):
            self._add_channel(i, channel, columns)
        for spec in TARGET_SPECS:
            is_superseded = spec.superseded_by and drive.has_signals(*spec.superseded_by)
            if drive.has_signals(*spec.required) and not is_superseded and not spec.channels & drive.unknown_channels:
                self._add_target(spec, columns)

    def residuals(self, simulated: Array) -> list[Array]:
        """Simulated minus measured, by target, (n_rows,).

        simulated: (ticks, len(SIMULATED_FIELDS)).
        """
        columns, latest = build_simulated_columns(simulated, self.drive), self._latest
        has_same_motion = latest is not None and np.array_equal(simulated[:, N_OUTPUTS:], latest[0][:, N_OUTPUTS:])
        residuals = []
        for i, (target, functional) in enumerate(zip(self.targets, self._functionals, strict=True)):
            if has_same_motion and latest is not None and target.name not in CHANNELS:
                residuals.append(latest[1][i])
            else:
                residuals.append(functional(columns)[target.rows] - target.measured)
        self._latest = (simulated, residuals)
        return residuals

    def drop_targets(self, names: Collection[str]) -> None:
        """Compare these targets no longer."""
        remaining = [i for i, target in enumerate(self.targets) if target.name not in names]
        self.targets = [self.targets[i] for i in remaining]
        self._functionals, self._latest = [self._functionals[i] for i in remaining], None

    def _add_target(self, spec: TargetSpec, columns: SignalColumns) -> None:
        drive, functional = self.drive, spec.functional
        interval = max(round(TARGET_CRITERIA.interval_s / drive.dt_s), 1)
        rows = np.arange(0, drive.ticks, interval)
        valid = _erode(self._valid_ticks(spec), 2 * columns.window)[rows]
        if valid.sum() < self._min_rows:
            return
        measured = functional(columns)[rows]
        sensed = SENSED_QUANTITIES[spec.name](drive.inputs)[rows] if spec.name in SENSED_QUANTITIES else measured
        size = _signal_deviation(sensed[valid])
        if size > 0.0:
            noise = functional(add_sensor_noise(columns, drive))[rows] - measured
            self.targets.append(
                Target(
                    name=spec.name,
                    link=spec.link,
                    unit=spec.unit,
                    rows=rows,
                    valid=valid,
                    measured=measured,
                    dt_s=interval * drive.dt_s,
                    quantum=0.0,
                    size=size,
                    noise=float(np.std(noise[valid])),
                )
            )
            self._functionals.append(functional)

    def _valid_ticks(self, spec: TargetSpec) -> Array:
        """(ticks,): the car drives, all signals are valid, and it is in no tight turn if these are excluded."""
        drive = self.drive
        valid = drive.is_moving & (drive.inputs.speed_mps > TARGET_CRITERIA.min_speed_mps * drive.size_scale)
        for field in spec.required:
            valid &= drive.signals[field].is_valid
        if not spec.excludes_tight_turns:
            return valid
        gentle = valid & (np.abs(drive.kinematic_steer_rad) < TARGET_CRITERIA.max_gentle_rad)
        return gentle if gentle.sum() > TARGET_CRITERIA.min_gentle_share * valid.sum() else valid

    def _add_channel(self, i: int, channel: str, columns: SignalColumns) -> None:
        drive, field = self.drive, OUTPUT_FIELDS[channel]
        report = drive.signals.get(f"report.{field}")
        if report is None:
            return
        rows = np.flatnonzero(report.fresh)
        fresh_interval = max(float(np.median(np.diff(rows))), 1.0)
        rows = rows[:: max(round(TARGET_CRITERIA.output_interval_s / (drive.dt_s * fresh_interval)), 1)]
        valid = drive.command_active[rows, i] & report.is_valid[rows]
        if valid.sum() < self._min_rows:
            return
        measured = columns[field][rows]
        quantum = estimate_quantum(measured)
        # an output that stands still is compared only if it is commanded to move: the command is the signal then
        size = _signal_deviation(measured[valid], TARGET_CRITERIA.flicker_steps * quantum) or _signal_deviation(
            drive.inputs.commands[rows, i][valid]
        )
        if size > 0.0:
            self.targets.append(
                Target(
                    name=channel,
                    link=Link.COMMAND_TO_REPORT,
                    unit="rad" if channel == "steer" else "1",
                    rows=rows,
                    valid=valid,
                    measured=measured,
                    dt_s=float(np.median(np.diff(rows))) * drive.dt_s,
                    quantum=quantum,
                    size=size,
                )
            )
            self._functionals.append(lambda c: c[field])


def find_sparse_targets(drives: Sequence[DriveComparison]) -> set[str]:
    """Targets of which all drives together have too few rows."""
    rows: dict[str, int] = {}
    for target in (target for drive in drives for target in drive.targets):
        rows[target.name] = rows.get(target.name, 0) + int(target.valid.sum())
    return {name for name, count in rows.items() if count < TARGET_CRITERIA.min_rows}


def _signal_deviation(values: Array, flicker: float = 0.0) -> float:
    """Standard deviation of a signal; 0 for one that stands still."""
    standstill = max(TARGET_CRITERIA.standstill_share * float(np.abs(values).max()), 1e-12, flicker)
    return float(np.std(values)) if np.ptp(values) > standstill else 0.0


def _erode(valid: Array, margin: int) -> Array:
    """Rows at least `margin` away from one that is not valid."""
    kernel = np.ones(2 * margin + 1)
    invalid = np.convolve(~valid, kernel, "same") > 0.5
    invalid[:margin] = invalid[-margin:] = True
    return ~invalid


COLUMN_INDEX = {name: i for i, name in enumerate(SIMULATED_FIELDS)}
FIELD_BY_COLUMN = {
    "speed_mps": "report.speed_mps",
    "yaw_rate_radps": "report.yaw_rate_radps",
    "accel_mps2": "report.accel_mps2",
    "lateral_accel_mps2": "report.lateral_accel_mps2",
    "ins_speed_mps": "ins.speed_mps",
    "ins_yaw_rate_radps": "ins.yaw_rate_radps",
}


@cache
def _smoothing_taps(window: int, derivative: int, dt_s: float) -> Array:
    """Of a parabola fitted to a window; the ends of a drive, where none fits, are not compared."""
    return np.asarray(savgol_coeffs(window, 2, deriv=derivative, delta=dt_s))


@cache
def _slope_weights(window: int) -> Array:
    """(window,): the weights that a parabola's slope gives the rates whose sum it is the slope of."""
    taps = np.cumsum(savgol_coeffs(window, 2, deriv=1, use="dot"))[:-1]
    return -0.5 * np.convolve(taps, [1.0, 1.0])


def build_measured_columns(drive: MeasuredDrive) -> SignalColumns:
    """The measured signals of a drive."""
    columns = {name: drive.signals[field].values for name, field in FIELD_BY_COLUMN.items() if field in drive.signals}
    source = "ins.speed_mps" if drive.inputs.uses_ins_speed else "report.speed_mps"
    columns["travel"] = drive.signals[source].values
    for i, name in enumerate(CHANNELS):
        columns[OUTPUT_FIELDS[name]] = drive.inputs.outputs[:, i]
    return SignalColumns(columns, drive.dt_s)


def add_sensor_noise(columns: SignalColumns, drive: MeasuredDrive) -> SignalColumns:
    """The measured signals with the white noise of each sensor added once more, at its own samples.

    A slow signal is no quieter for lying on straight lines between its samples. The draw is the same each time.
    """
    rng, noisy = np.random.default_rng(1), dict(columns.columns)
    for name, field in FIELD_BY_COLUMN.items():
        if field in drive.signals:
            noisy[name] = columns[name] + _draw_noise(drive.signals[field], rng)
    noisy["travel"] = noisy["ins_speed_mps" if drive.inputs.uses_ins_speed else "speed_mps"]
    return SignalColumns(noisy, drive.dt_s)


def _draw_noise(signal: Signal, rng: np.random.Generator) -> Array:
    """(ticks,): white at the samples, interpolated as the signal is; zero for a signal without valid samples."""
    samples = np.flatnonzero(signal.fresh & signal.is_valid)
    if not len(samples):
        return np.zeros(len(signal.values))
    draws = signal.noise * rng.standard_normal(len(samples))
    return np.interp(np.arange(len(signal.values)), samples - signal.delay_rows, draws)


def build_simulated_columns(simulated: Array, drive: MeasuredDrive) -> SignalColumns:
    """The simulated signals, with the sampling of the measured ones."""
    columns = {name: simulated[:, i] for name, i in COLUMN_INDEX.items()}
    rate = simulated[:, COLUMN_INDEX["ins_accel_mps2" if drive.inputs.uses_ins_speed else "rate_mps2"]]
    columns["travel"] = np.cumsum(rate) * drive.dt_s
    speed = "ins.speed_mps" if drive.inputs.uses_ins_speed else "report.speed_mps"
    for name, field in (*FIELD_BY_COLUMN.items(), ("travel", speed)):
        window = drive.derived_ticks.get(field, 1)
        if window > 1:  # a rate made of a pose is a slope over several values: so is the simulated one
            columns[name] = convolve1d(columns[name], _slope_weights(window), mode="nearest")
        elif field in drive.signals:
            columns[name] = drive.signals[field].resample(columns[name])
    return SignalColumns(columns, drive.dt_s)
