"""Is the oscillation metric right? Random gain sets on both vehicles, judged again by a check that works otherwise.

The check knows no turning points and no model of the drive: in windows of a few seconds it looks for a narrow peak of
the power density (Welch) which the reference has not, regular crossings of the autocorrelation (Thornhill), and an
envelope that persists.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Mapping
from random import Random
from typing import Any, NamedTuple

import numpy as np
from scipy import signal as processing

from tools.measures._ledger import ROOT
from tools.measures._summary import rounded
from tools.measures.parity import bench_files
from tunefree_hil.base.course import Course
from tunefree_hil.bench import Bench, load
from tunefree_hil.bench.batch import Batch, Driven, Job
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.control.parameters import BY_NAME, SETS, Parameter, round32, study_values
from tunefree_hil.grade.metrics import samples_from_plan
from tunefree_hil.grade.oscillation.report import CRITERIA, OscillationReport, oscillation_text
from tunefree_hil.grade.score import FINISHED

Array = np.ndarray

VALUE = "drives of random gain sets that the metric judges otherwise than an independent spectral check, percent"
BORDER = 1.5  # ratio to a limit, up or down: such drives are counted apart, too


class CheckCriteria(NamedTuple):
    """Thresholds of the independent check."""

    low_hz: float = 0.5  # band of issue 44
    high_hz: float = 5.0
    windows_s: tuple[float, ...] = (2.0, 3.0, 4.5, 6.0)  # the longest holds three cycles at 0.5 Hz
    min_cycles: float = 2.5  # in a window
    step_s: float = 0.5  # between the beginnings of windows
    margin_s: float = 2.0  # before and after a window in which the reference's spectrum counts, too
    octave: float = 1.3  # a peak reaches from f / octave to f octave ...
    bins: float = (
        1.5  # ... and at least so many lines of the window's spectrum to either side, which Hann spreads it to
    )
    narrow_share: float = 0.5  # least share of the band's power in the peak
    beyond_reference: float = 2.0  # least energy in the peak / the reference's there, at the gain of slow motion
    slow_hz: float = 0.4  # below it the gain from the reference to the signal is taken
    regularity: float = (
        0.8  # least third of mean / standard deviation of the periods; Thornhill takes 1 for long records
    )
    min_crossings: int = 6  # of the autocorrelation in a window: three half periods on either side of lag 0
    low_quantile: float = 0.2  # of the envelope: the amplitude that persists
    steady_share: float = 0.25  # least low quantile / largest of the envelope


CHECK = CheckCriteria()


class CheckedSignal(NamedTuple):
    """Column, the reference column whose spectrum it may follow, and the limit of its peak-to-peak swing."""

    column: str
    reference: str
    limit: float


STEER_COLUMNS = ("cmd_steer_rad", "out_steer_rad")
CHECKED = (
    *(CheckedSignal(column, "ref_curvature_1pm", CRITERIA.steer_rad) for column in STEER_COLUMNS),
    CheckedSignal("accel_mps2", "ref_accel_mps2", CRITERIA.accel_mps2),
    CheckedSignal("cmd_throttle_frac", "ref_accel_mps2", CRITERIA.pedal_frac),
    CheckedSignal("cmd_brake_frac", "ref_accel_mps2", CRITERIA.pedal_frac),
    CheckedSignal("speed_mps", "ref_speed_mps", CRITERIA.speed_mps),
)


class CheckedSwing(NamedTuple):
    """The strongest regular swing: amplitude / limit (0: none), signal, frequency, beginning of its window."""

    ratio: float = 0.0
    column: str = ""
    frequency_hz: float = 0.0
    from_s: float = 0.0


class JudgedDrive(NamedTuple):
    """A drive and both judgements."""

    name: str
    report: OscillationReport
    check: CheckedSwing
    is_plain: bool  # driven to its end without a re-plan

    @property
    def differs(self) -> bool:
        """Whether only one of the two calls it an oscillation."""
        return self.report.is_oscillating != (self.check.ratio > 1.0)

    @property
    def is_clear(self) -> bool:
        """Whether both are far from their limits."""
        return not any(1.0 / BORDER < ratio < BORDER for ratio in (self.report.worst_ratio, self.check.ratio))


def measure(sets: int = 200, seed: str = "", benches: str = "", model: str = "") -> dict[str, Any]:
    """`sets` gain sets of the published box on each vehicle's verify model, over its search and verify scenarios.

    benches: bench files with commas between; '' is one a vehicle.

    seed: any text; '' is the hash of the commit. sets: fewer while developing, with another seed.
    """
    used_seed = seed or _commit()
    drives: list[JudgedDrive] = []
    for path in bench_files(benches):
        bench = load(path)
        drives += _judge_bench(bench, model or bench.spec.verify_model, sets, used_seed)
    plain = [drive for drive in drives if drive.is_plain]
    differing = [drive for drive in drives if drive.differs]
    shaking = sum(drive.report.is_oscillating for drive in drives)
    detail = {
        "seed": used_seed,
        "oscillating_by_metric": shaking,
        "oscillating_by_check": sum(drive.check.ratio > 1.0 for drive in drives),
        "only_metric": sum(drive.report.is_oscillating for drive in differing),
        "only_check": sum(not drive.report.is_oscillating for drive in differing),
        "n_to_the_end_without_replans": len(plain),
        "differ_to_the_end_without_replans": sum(drive.differs for drive in plain),
        "differ_clearly": sum(drive.is_clear for drive in differing),
        "first_that_differ": [_description(drive) for drive in differing[:40]],
    }
    value = 100.0 * len(differing) / max(1, len(drives))
    return {"value": value, "unit": "%", "n": len(drives), "low": None, "high": None, "detail": rounded(detail)}


def random_sets(sets: int, seed: str) -> Iterator[dict[str, float]]:
    """Vectors with all parameters of the complete set drawn from the published box."""
    chance = Random(seed)
    for _ in range(sets):
        yield {**study_values(), **{name: round32(_drawn(BY_NAME[name], chance)) for name in SETS["complete"]}}


def _drawn(row: Parameter, chance: Random) -> float:
    tunable = row.tunable
    if tunable.choices:
        return chance.choice(tunable.choices)
    if tunable.scale == "log":
        return tunable.low * (tunable.high / tunable.low) ** chance.random()
    return chance.uniform(tunable.low, tunable.high)


def _judge_bench(bench: Bench, model: str, sets: int, seed: str) -> Iterator[JudgedDrive]:
    names = list(dict.fromkeys((*bench.spec.scenarios, *bench.spec.verify_scenarios)))
    scenarios: list[ScenarioSpec] = [bench.scenarios[name] for name in names]
    rest_frac = bench.vehicle.nominal.rest_pedal_frac
    with Batch(bench, model) as batch:
        for number, values in enumerate(random_sets(sets, f"{seed} {bench.vehicle.name}")):
            driven = batch.drive([Job(values, scenario) for scenario in scenarios], columns=True)
            for scenario, one in zip(scenarios, driven, strict=True):
                if one.grade is not None and one.recording is not None:
                    yield judge(
                        f"{bench.vehicle.name} set {number} {scenario.name}", one, bench.course(scenario), rest_frac
                    )


def judge(name: str, driven: Driven, course: Course, rest_frac: float) -> JudgedDrive:
    """Both judgements of a drive. The check's reference is the plan by time, which no re-plan and no drive changes."""
    assert driven.grade is not None and driven.recording is not None
    dt_s, rows = driven.recording.dt_s, np.minimum(np.arange(driven.recording.ticks), course.ticks - 1)
    columns = {key: _bridged(column) for key, column in driven.recording.columns.items()}
    for key, plan in samples_from_plan(course)._asdict().items():
        columns |= {} if plan is None else {key: np.asarray(plan)[rows]}
    swings = [strongest_swing(columns, row, dt_s) for row in CHECKED if row.column in columns]
    swings.append(alternation(columns, rest_frac, dt_s))
    is_plain = driven.grade.outcome == FINISHED and driven.grade.replans == 0
    return JudgedDrive(name, driven.grade.oscillation, max(swings), is_plain)


def strongest_swing(columns: Mapping[str, Array], row: CheckedSignal, dt_s: float) -> CheckedSwing:
    """The largest amplitude / limit among the windows in which the signal swings narrowly, regularly and steadily."""
    values, speed = columns[row.column], columns["ref_speed_mps"]
    edges = (CHECK.low_hz * 0.7, CHECK.high_hz * 1.3)
    filtered = processing.sosfiltfilt(processing.butter(3, edges, "bandpass", fs=1.0 / dt_s, output="sos"), values)
    envelope = np.abs(processing.hilbert(filtered))
    scaled = columns[row.reference] * _slow_gain(values, columns[row.reference], dt_s)
    best = CheckedSwing()
    for window_s in CHECK.windows_s:
        length = round(window_s / dt_s)
        for start in range(0, len(values) - length + 1, round(CHECK.step_s / dt_s)):
            rows = slice(start, start + length)
            low, high = np.quantile(envelope[rows], [CHECK.low_quantile, 1.0])
            limit = row.limit
            if row.column in STEER_COLUMNS:
                slower = CRITERIA.steer_speed_mps / max(float(np.mean(np.abs(speed[rows]))), 0.1)
                limit = min(max(limit * slower * slower, limit), CRITERIA.max_steer_rad)
            ratio = 2.0 * float(low) / limit
            if ratio <= best.ratio or low < CHECK.steady_share * high:
                continue
            margin = round(CHECK.margin_s / dt_s)
            around = slice(max(0, start - margin), start + length + margin)
            frequency_hz = _narrow_peak_hz(values[rows], scaled[around], dt_s)
            if frequency_hz > 0.0 and frequency_hz * window_s >= CHECK.min_cycles and _is_regular(filtered[rows]):
                best = CheckedSwing(ratio, row.column, frequency_hz, start * dt_s)
    return best


def _narrow_peak_hz(values: Array, reference: Array, dt_s: float) -> float:
    """Frequency of a narrow peak in the band which the reference's own spectrum has not; 0 where there is none."""
    frequency_hz, power = _density(values, dt_s)
    in_band = (frequency_hz >= CHECK.low_hz) & (frequency_hz <= CHECK.high_hz)
    first = int(np.argmax(power[in_band]))
    if first == 0:  # it comes down from below the band: no peak
        return 0.0
    peak_hz = float(frequency_hz[in_band][first])
    reach_hz = CHECK.bins / (len(values) * dt_s)
    total, near = _energies(frequency_hz, power, peak_hz, reach_hz)
    if near < CHECK.narrow_share * total or total <= 0.0:
        return 0.0
    _, near_reference = _energies(*_density(reference, dt_s), peak_hz, reach_hz)
    energy, energy_reference = near * len(values), near_reference * len(reference)
    return peak_hz if energy >= CHECK.beyond_reference * energy_reference else 0.0


def _slow_gain(values: Array, reference: Array, dt_s: float) -> float:
    """RMS of the slow motion of a signal over that of its reference; 0 for a reference that stands still."""
    slow = processing.butter(3, CHECK.slow_hz, "lowpass", fs=1.0 / dt_s, output="sos")
    spread, spread_reference = (float(np.std(processing.sosfiltfilt(slow, one))) for one in (values, reference))
    return spread / spread_reference if spread_reference > 1e-9 else 0.0


def _density(values: Array, dt_s: float) -> tuple[Array, Array]:
    return processing.welch(values, 1.0 / dt_s, nperseg=len(values), nfft=4 * len(values), detrend="linear")


def _energies(frequency_hz: Array, power: Array, peak_hz: float, reach_hz: float) -> tuple[float, float]:
    """Power of the band, and of its part around a frequency."""
    in_band = (frequency_hz >= CHECK.low_hz / CHECK.octave) & (frequency_hz <= CHECK.high_hz * CHECK.octave)
    low_hz, high_hz = min(peak_hz / CHECK.octave, peak_hz - reach_hz), max(peak_hz * CHECK.octave, peak_hz + reach_hz)
    near = in_band & (frequency_hz >= low_hz) & (frequency_hz <= high_hz)
    bin_hz = float(frequency_hz[1])
    return float(power[in_band].sum()) * bin_hz, float(power[near].sum()) * bin_hz


def _is_regular(filtered: Array) -> bool:
    """Whether the zero crossings of the autocorrelation come at regular intervals (Thornhill, Huang, Zhang 2003)."""
    centred = filtered - filtered.mean()
    full = processing.correlate(centred, centred, method="fft")
    lags = full[len(centred) - 1 : len(centred) - 1 + round(0.7 * len(centred))]
    signs = np.sign(lags)
    crossings = np.flatnonzero(signs[1:] * signs[:-1] < 0.0)
    if len(crossings) < CHECK.min_crossings // 2:
        return False
    before, after = lags[crossings], lags[crossings + 1]
    periods = np.diff(crossings + before / (before - after))
    spread = float(np.std(periods))
    return spread == 0.0 or float(np.mean(periods)) / (3.0 * spread) > CHECK.regularity


def alternation(columns: Mapping[str, Array], rest_frac: float, dt_s: float) -> CheckedSwing:
    """The rate of changes between the pedals in windows of 10 s, without those of the reference, / its limit."""
    up = np.maximum(columns["cmd_throttle_frac"] - rest_frac, 0.0)
    down = np.maximum(columns["cmd_brake_frac"] - rest_frac, 0.0)
    window = round(10.0 / dt_s)
    changes = _changes(up - down, CRITERIA.active_frac) - _changes(columns["ref_accel_mps2"], CRITERIA.asked_accel_mps2)
    sums = np.concatenate([[0.0], np.cumsum(changes)])
    window = min(window, len(changes))
    rates = (sums[window:] - sums[:-window]) / (window * dt_s)
    first = int(np.argmax(rates))
    rate = max(float(rates[first]), 0.0)
    return CheckedSwing(rate / CRITERIA.switches_per_s, "pedals", 0.5 * rate, first * dt_s)


def _changes(values: Array, dead_zone: float) -> Array:
    """1 in the rows where the sign outside of the dead zone is another one than before."""
    sides = np.where(np.abs(values) > dead_zone, np.sign(values), 0.0)
    rows = np.flatnonzero(sides)
    changes = np.zeros(len(values))
    changes[rows[1:][np.diff(sides[rows]) != 0.0]] = 1.0
    return changes


def _bridged(values: Array) -> Array:
    known = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(len(values)), known, values[known])


def _description(drive: JudgedDrive) -> dict[str, Any]:
    worst = drive.report.worst
    metric = {} if worst is None else {"metric": oscillation_text(worst), "metric_ratio": worst.ratio}
    return {"drive": drive.name, **metric, "check": drive.check._asdict()}


def _commit() -> str:
    words = ["git", "rev-parse", "HEAD"]
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
