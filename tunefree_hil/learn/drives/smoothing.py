"""Signals of a drive made smooth, their rates, their noise and the step of their wire."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from tunefree_hil.config.schema import NominalSpec
from tunefree_hil.learn.drives.drive import CHASSIS_FIRST_SPEEDS, INS_FIRST_SPEEDS, Drive, Part, first_told
from tunefree_hil.plant.measurement.sensors import NOISY

Array = np.ndarray

NOISE_WINDOW, NOISE_ORDER = 9, 3  # fresh values and degree of the polynomial that the noise is taken against
LEAST_VALUES = 200


def between_fresh(values: Array, fresh: Array) -> Array:
    """The signal on every tick: straight lines between fresh values, held at both ends; NaN where none is finite."""
    ticks = np.flatnonzero(fresh & np.isfinite(values))
    if not len(ticks):
        return np.full(len(values), np.nan)
    return np.interp(np.arange(len(values)), ticks, values[ticks])


def first_between_fresh(drive: Drive, names: Sequence[str], late: int) -> Array | None:
    """The first of these fields that says anything, on every tick; the INS's `late` rows earlier. None: none does."""
    name = first_told(drive, names)
    if name is None:
        return None
    even = between_fresh(drive.fields[name], drive.fresh[name])
    return earlier(even, late) if name.startswith("ins.") else even


def earlier(values: Array, rows: int) -> Array:
    """The same signal `rows` rows earlier; NaN at its end."""
    return np.concatenate([values[rows:], np.full(rows, np.nan)]) if rows else values


def smooth(values: Array, window: int, order: int = 2) -> Array:
    """Savitzky-Golay; a signal that is shorter than the window is given back as it is."""
    return np.asarray(savgol_filter(values, window, order)) if len(values) >= window else values.copy()


def rate_of(values: Array, fresh: Array, window: int, dt_s: float) -> Array:
    """Rate of a signal by Savitzky-Golay over `window` ticks, degree 2; what went before the first value is NaN."""
    even = between_fresh(values, fresh)
    if len(even) < window or not np.isfinite(even).all():
        return np.full(len(values), np.nan)
    rate = np.asarray(savgol_filter(even, window, 2, deriv=1, delta=dt_s))
    first = int(np.argmax(np.isfinite(values)))
    rate[:first] = np.nan
    return rate


def speed_of(drive: Drive) -> tuple[Array, Array] | None:
    """(speed, where it is fresh): the INS's, else the chassis's; None where neither says one."""
    name = first_told(drive, INS_FIRST_SPEEDS)
    return None if name is None else (drive.fields[name], drive.fresh[name])


def mean_noise(misses: Array, fresh: Array, rows: int) -> float:
    """Standard deviation of a mean over `rows` ticks of what an accelerometer says beyond the rate of speed.

    From how much neighbouring fresh values differ: a car that shakes, seen ten times a second, tells no slope. inf
    where there are too few.
    """
    some = misses[fresh & np.isfinite(misses)]
    if len(some) < 10:
        return float("inf")
    each = float(np.sqrt(0.5 * np.mean(np.diff(some) ** 2)))
    return each / float(np.sqrt(max(rows * np.mean(fresh), 1.0)))


def yaw_by_wheels(drive: Drive, nominal: NominalSpec) -> tuple[Array, Array] | None:
    """(yaw rate, where it is fresh) of a car without a gyro: how much faster the right rear wheel rolls than the left.

    None without wheels, or where the folder does not say the track and the rolling radius. Wheels that are not quite
    alike turn a straight line into a curve; a fit sees that as a steering wheel that is not centred.
    """
    left, right = drive.get("report.wheel_rl_radps"), drive.get("report.wheel_rr_radps")
    if left is None or right is None or not (nominal.track_m and nominal.wheel_radius_m):
        return None
    fresh = drive.fresh["report.wheel_rl_radps"] & drive.fresh["report.wheel_rr_radps"]
    return (right - left) * nominal.wheel_radius_m / nominal.track_m, fresh


def quantum_of(values: Array) -> float:
    """The step of the wire: the smallest difference between two values that occur, 0 where there are no two."""
    some = np.unique(values[np.isfinite(values)])
    if len(some) < 2:
        return 0.0
    steps = np.diff(some)
    whole = steps[steps > 1e-9 * max(1.0, float(np.abs(some).max()))]
    return float(whole.min()) if len(whole) else 0.0


def noise_of(values: Array, quantum: float = 0.0) -> float:
    """Standard deviation of white noise on fresh values: what a local cubic leaves, the wire's rounding taken off.

    The middle 90 % of what it leaves are taken, so that the corners of steps do not count as noise.
    """
    values = values[np.isfinite(values)]
    if len(values) < NOISE_WINDOW:
        return 0.0
    middle = savgol_coeffs(NOISE_WINDOW, NOISE_ORDER)[NOISE_WINDOW // 2]
    left = values - savgol_filter(values, NOISE_WINDOW, NOISE_ORDER)
    low, high = np.quantile(left, [0.05, 0.95])
    spread = (high - low) / (2.0 * 1.6449)  # of a normal distribution; not 0 for one that is rounded coarsely
    variance = spread * spread / (1.0 - middle) - quantum * quantum / 12.0
    return float(np.sqrt(max(variance, 0.0)))


def noise_table_of(parts: Iterable[Part]) -> dict[str, float]:
    """Noise by record field as [noise] of model.toml has it; fields without enough fresh values are left out."""
    parts = list(parts)
    found: dict[str, float] = {}
    for name in NOISY:
        pieces = [fresh_values(part, name) for part in parts]
        pieces = [piece for piece in pieces if len(piece) >= LEAST_VALUES]
        if not pieces:
            continue
        pieces = [np.unwrap(piece) if name.endswith("heading_rad") else piece for piece in pieces]
        quantum = min((one for one in map(quantum_of, pieces) if one > 0.0), default=0.0)
        sizes = np.array([len(piece) for piece in pieces], dtype=float)
        noises = np.array([noise_of(piece, quantum) for piece in pieces])
        found[name] = float(np.sqrt(np.average(noises * noises, weights=sizes)))
    return found


def fresh_values(part: Part, name: str) -> Array:
    """The fresh, finite values of a field in a part."""
    values = part.drive.get(name)
    if values is None:
        return np.zeros(0)
    rows = slice(part.begin, part.end)
    some = values[rows][part.drive.fresh[name][rows]]
    return some[np.isfinite(some)]


def valid_region(parts: Iterable[Part], rest_frac: float) -> dict[str, tuple[float, float]]:
    """[valid] of model.toml: what the parts cover, but for a thousandth at either end; sources as episode/columns.py's.

    pedals: minus the brake's duty where it is pressed, else the throttle's, as in calibration.npz.
    """
    parts = list(parts)
    names = {
        "speed_mps": CHASSIS_FIRST_SPEEDS,
        "accel_mps2": ("report.accel_mps2", "ins.accel_mps2"),
        "lateral_accel_mps2": ("report.lateral_accel_mps2",),
        "steer_rad": ("report.steer_rad",),
    }
    found: dict[str, tuple[float, float]] = {}
    for key, sources in names.items():
        for source in sources:
            some = np.concatenate([smooth(fresh_values(part, source), 21) for part in parts] or [np.zeros(0)])
            if len(some) >= LEAST_VALUES:
                found[key] = _ends(some)
                break
    pedals = np.concatenate([_pedals(part, rest_frac) for part in parts] or [np.zeros(0)])
    if len(pedals) >= LEAST_VALUES:
        found["pedals"] = _ends(pedals)
    return {key: ends for key, ends in found.items() if ends[0] < ends[1]}


def _pedals(part: Part, rest_frac: float) -> Array:
    rows = slice(part.begin, part.end)
    throttle, brake = part.drive.get("report.throttle_frac"), part.drive.get("report.brake_frac")
    if throttle is None or brake is None:
        return np.zeros(0)
    pressed = brake[rows] - rest_frac > np.maximum(throttle[rows] - rest_frac, 0.01)
    some = np.where(pressed, -brake[rows], throttle[rows])
    return some[np.isfinite(some)]


def _ends(some: Array) -> tuple[float, float]:
    low, high = np.quantile(some, [0.001, 0.999])
    return float(low), float(high)
