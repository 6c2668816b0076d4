"""What is compared of a drive, link by link: the same linear functional of what was measured and what was simulated.

Differences between two sensors are compared as differences, so that what the car model gets wrong cancels out of the
links between sensors.

The signals of a drive under names that measured and simulated ones share, smoothed and sloped alike.

`travel` is the summed-up rate of speed of the simulation, and the speed of the measurement: its slope over a short
window is the acceleration of either.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import convolve1d
from scipy.signal import savgol_coeffs

from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.measured.chain import Opened
from tunefree_hil.gap.measured.observability import OUTPUTS
from tunefree_hil.gap.measured.signals import Signal
from tunefree_hil.gap.model.graph import CHANNELS, Inputs
from tunefree_hil.gap.model.kernels import SHOWN
from tunefree_hil.learn.drives.smoothing import quantum_of

Array = np.ndarray

EVERY_S = 0.05
ACT_EVERY_S = 0.02
LEAST_MPS = 1.5  # below it creep, stick and standing still are no car that a single track describes
LEAST_ROWS = 200  # of all drives of a question; of one its share of these, but not fewer than FEWEST_ROWS
FEWEST_ROWS = 40
# In tighter turns the front tyres work against each other, as far as the linkage does not turn each as its own circle
# asks. What that scrubs off the speed, t²/L² C δ⁴ / m, no single track has: 0.016 m/s² here, 0.06 at 0.33 rad.
TIGHT_RAD = 0.24
MOSTLY = 0.5  # of the rows must be gentler; a car that does nothing else is taken as it is
STILL = 1e-9  # of a signal's largest value: what moves less is rounding of numbers
FLICKER = 2.0  # steps of the wire: a report that moves no more than that stands
OUT = len(CHANNELS)  # columns of SHOWN that are outputs


class Target(NamedTuple):
    """One thing that is compared. rows [m]: of the drive; valid [m]; measured [m]; dt_s between two rows.

    quantum: what the wire rounds to, as far as the functional lets it through. size: deviation of the signal that it is
    about (of a difference of two sensors, of what both sense), above 0: what never moves is compared with nothing.
    noise: of the sensors that it is made of, as far as the functional lets it through.
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


Functional = Callable[["Columns"], Array]


def _rate(c: Columns) -> Array:
    return c.slope(c["travel"])


def _yaw(c: Columns) -> Array:
    return c.mean(c["ins_yaw_rate_radps"])


def _own_yaw(c: Columns) -> Array:
    return c.mean(c["yaw_rate_radps"])


def _beyond_turning(c: Columns) -> Array:
    """Lateral acceleration less speed times yaw rate: what side slip and gravity leave."""
    return c.mean(c["lateral_accel_mps2"] - c["ins_speed_mps"] * c["ins_yaw_rate_radps"])


def _lateral(c: Columns) -> Array:
    return c.mean(c["lateral_accel_mps2"])


def _wheels(c: Columns) -> Array:
    return c.mean(c["speed_mps"] - c["ins_speed_mps"])


def _turns(c: Columns) -> Array:
    return c.mean(c["yaw_rate_radps"] - c["ins_yaw_rate_radps"])


def _felt(c: Columns) -> Array:
    return c.mean(c["accel_mps2"]) - c.slope(c["travel"])


MOTION = Link.REPORT_TO_MOTION
PEDALS, STEERING = frozenset({"throttle", "brake"}), frozenset({"steer"})


class Planned(NamedTuple):
    """A target to be had. needed: fields that must be measured; better: fields in whose presence another one is better;
    by: channels of which it must be known what they did; gentle: not asked for in tight turns, as long as most of a
    drive is none.
    """

    name: str
    link: Link
    unit: str
    functional: Functional
    needed: tuple[str, ...] = ()
    better: tuple[str, ...] = ()
    by: frozenset[str] = frozenset()
    gentle: bool = False


PLANNED = (
    Planned("rate_of_speed", MOTION, "m/s2", _rate, by=PEDALS, gentle=True),
    Planned("yaw_rate", MOTION, "rad/s", _yaw, ("ins.yaw_rate_radps",), by=STEERING),
    Planned("yaw_rate", MOTION, "rad/s", _own_yaw, ("report.yaw_rate_radps",), ("ins.yaw_rate_radps",), STEERING),
    Planned("lateral_beyond_turning", MOTION, "m/s2", _beyond_turning,
            ("report.lateral_accel_mps2", "ins.speed_mps", "ins.yaw_rate_radps"), by=STEERING),
    Planned("lateral_accel", MOTION, "m/s2", _lateral, ("report.lateral_accel_mps2",),
            ("ins.speed_mps", "ins.yaw_rate_radps"), STEERING),
    Planned("wheel_vs_ins", Link.WHEEL_VS_INS, "m/s", _wheels, ("report.speed_mps", "ins.speed_mps")),
    Planned("yaw_vs_ins", Link.YAW_VS_INS, "rad/s", _turns, ("report.yaw_rate_radps", "ins.yaw_rate_radps")),
    Planned("accel_vs_dvdt", Link.ACCEL_VS_DVDT, "m/s2", _felt, ("report.accel_mps2",)),
)  # fmt: skip


SENSED: dict[str, Callable[[Inputs], Array]] = {  # what both sensors of a difference sense
    "wheel_vs_ins": lambda x: x.speed_mps,
    "yaw_vs_ins": lambda x: x.yaw_rate_radps,
    "accel_vs_dvdt": lambda x: x.rate_mps2,
    "lateral_beyond_turning": lambda x: x.speed_mps * x.yaw_rate_radps,
}


class Compared:
    """All targets of a drive, with the functionals that give them. share: of a question's rows, what the drive has."""

    def __init__(self, opened: Opened, share: float = 1.0) -> None:
        self.opened, self._least = opened, max(LEAST_ROWS * share, FEWEST_ROWS)
        self._functionals: list[Functional] = []
        self.targets: list[Target] = []
        self._before: tuple[Array, list[Array]] | None = None  # the newest: often only the outputs differ from it
        columns = measured_columns(opened)
        for i, channel in enumerate(CHANNELS):
            self._add_channel(i, channel, columns)
        for plan in PLANNED:
            worse = plan.better and opened.has(*plan.better)
            if opened.has(*plan.needed) and not worse and not plan.by & opened.unknown:
                self._add(plan, columns)

    def of(self, shown: Array) -> list[Array]:
        """Simulated minus measured, target by target, at their rows."""
        columns, before = simulated_columns(shown, self.opened), self._before
        same = before is not None and np.array_equal(shown[:, OUT:], before[0][:, OUT:])
        found = []
        for i, (target, functional) in enumerate(zip(self.targets, self._functionals, strict=True)):
            known = same and before is not None and target.name not in CHANNELS
            found.append(before[1][i] if known and before else functional(columns)[target.rows] - target.measured)
        self._before = (shown, found)
        return found

    def leave_out(self, names: Collection[str]) -> None:
        """Compare none of these any more."""
        kept = [i for i, target in enumerate(self.targets) if target.name not in names]
        self.targets = [self.targets[i] for i in kept]
        self._functionals, self._before = [self._functionals[i] for i in kept], None

    def _add(self, plan: Planned, columns: Columns) -> None:
        opened, functional = self.opened, plan.functional
        good = opened.moving & (opened.inputs.speed_mps > LEAST_MPS * opened.pace)
        for field in plan.needed:
            good &= opened.signals[field].there
        if plan.gentle:
            gentle = good & (np.abs(opened.bend) < TIGHT_RAD)
            good = gentle if gentle.sum() > MOSTLY * good.sum() else good
        good = _inside(good, 2 * columns.window)
        rows = np.arange(0, opened.ticks, max(round(EVERY_S / opened.dt_s), 1))
        if good[rows].sum() < self._least:
            return
        measured = functional(columns)[rows]
        sensed = SENSED[plan.name](opened.inputs)[rows] if plan.name in SENSED else measured
        size = _size(sensed[good[rows]])
        if size > 0.0:
            every_s = max(round(EVERY_S / opened.dt_s), 1) * opened.dt_s
            noise = functional(noisier(columns, opened))[rows] - measured
            loud = float(np.std(noise[good[rows]]))
            known = (rows, good[rows], measured, every_s, 0.0, size, loud)
            self.targets.append(Target(plan.name, plan.link, plan.unit, *known))
            self._functionals.append(functional)

    def _add_channel(self, i: int, channel: str, columns: Columns) -> None:
        opened, field = self.opened, OUTPUTS[channel]
        report = opened.signals.get(f"report.{field}")
        if report is None:
            return
        rows = np.flatnonzero(report.fresh)
        rows = rows[:: max(round(ACT_EVERY_S / (opened.dt_s * max(float(np.median(np.diff(rows))), 1.0))), 1)]
        good = opened.follows[rows, i] & report.there[rows]
        if good.sum() < self._least:
            return
        measured = columns[field][rows]
        every_s = float(np.median(np.diff(rows))) * opened.dt_s
        unit = "rad" if channel == "steer" else "1"
        quantum = quantum_of(measured)
        # an output that stands tells nothing, unless it is asked to move: then that is what it is held against
        size = _size(measured[good], FLICKER * quantum) or _size(opened.inputs.commands[rows, i][good])
        if size > 0.0:
            link = Link.COMMAND_TO_REPORT
            self.targets.append(Target(channel, link, unit, rows, good, measured, every_s, quantum, size))
            self._functionals.append(lambda c: c[field])


def too_few(drives: Sequence[Compared]) -> set[str]:
    """Targets of which all drives of a question together have fewer rows than LEAST_ROWS."""
    rows: dict[str, int] = {}
    for target in (target for one in drives for target in one.targets):
        rows[target.name] = rows.get(target.name, 0) + int(target.valid.sum())
    return {name for name, many in rows.items() if many < LEAST_ROWS}


def _size(values: Array, flicker: float = 0.0) -> float:
    """Deviation of a signal; 0 for one that stands."""
    still = max(STILL * float(np.abs(values).max()), 1e-12, flicker)
    return float(np.std(values)) if np.ptp(values) > still else 0.0


def _inside(good: Array, by: int) -> Array:
    """Rows at least `by` away from one that is not good."""
    kernel = np.ones(2 * by + 1)
    bad = np.convolve(~good, kernel, "same") > 0.5
    bad[:by] = bad[-by:] = True
    return ~bad


WINDOW_S = 0.21  # of the polynomials; delays of a few hundredths still show through it
COLUMN = {name: i for i, name in enumerate(SHOWN)}
FIELDS = {
    "speed_mps": "report.speed_mps",
    "yaw_rate_radps": "report.yaw_rate_radps",
    "accel_mps2": "report.accel_mps2",
    "lateral_accel_mps2": "report.lateral_accel_mps2",
    "ins_speed_mps": "ins.speed_mps",
    "ins_yaw_rate_radps": "ins.yaw_rate_radps",
}


@cache
def _taps(window: int, derivative: int, dt_s: float) -> Array:
    """Of a parabola fitted to a window; at the ends of a drive, where none fits, nothing is compared."""
    return np.asarray(savgol_coeffs(window, 2, deriv=derivative, delta=dt_s))


@cache
def _under_slope(window: int) -> Array:
    """The weights [window] that a slope (a parabola's) gives the rates whose sum it is the slope of."""
    taps = np.cumsum(savgol_coeffs(window, 2, deriv=1, use="dot"))[:-1]
    return -0.5 * np.convolve(taps, [1.0, 1.0])


class Columns:
    """The signals of a drive, simulated or measured, by the names of SHOWN; `travel` beside them."""

    def __init__(self, columns: dict[str, Array], dt_s: float) -> None:
        self.columns, self.dt_s = columns, dt_s
        self.window = max(round(WINDOW_S / dt_s) | 1, 5)

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def mean(self, values: Array) -> Array:
        """Smoothed."""
        return convolve1d(values, _taps(self.window, 0, self.dt_s), mode="nearest")

    def slope(self, values: Array) -> Array:
        """Rate per s of the smoothed signal."""
        return convolve1d(values, _taps(self.window, 1, self.dt_s), mode="nearest")


def measured_columns(opened: Opened) -> Columns:
    """What was measured, as far as it was."""
    found = {name: opened.signals[field].values for name, field in FIELDS.items() if field in opened.signals}
    source = "ins.speed_mps" if opened.inputs.by_ins else "report.speed_mps"
    found["travel"] = opened.signals[source].values
    for i, name in enumerate(CHANNELS):
        found[OUTPUTS[name]] = opened.inputs.outputs[:, i]
    return Columns(found, opened.dt_s)


def noisier(columns: Columns, opened: Opened) -> Columns:
    """What was measured with as much white noise again as each sensor has, as often as it speaks: what comes seldom is
    no quieter for lying between two values on a straight line. The draw is the same each time.
    """
    rng, found = np.random.default_rng(1), dict(columns.columns)
    for name, field in FIELDS.items():
        if field in opened.signals:
            found[name] = columns[name] + _noise_like(opened.signals[field], rng)
    found["travel"] = found["ins_speed_mps" if opened.inputs.by_ins else "speed_mps"]
    return Columns(found, opened.dt_s)


def _noise_like(signal: Signal, rng: np.random.Generator) -> Array:
    """[n]: white in what was told, and moved as that was; nothing of a signal that is all gaps."""
    at = np.flatnonzero(signal.fresh & signal.there)
    if not len(at):
        return np.zeros(len(signal.values))
    return np.interp(np.arange(len(signal.values)), at - signal.late, signal.noise * rng.standard_normal(len(at)))


def simulated_columns(shown: Array, opened: Opened) -> Columns:
    """What the graph showed."""
    found = {name: shown[:, i] for name, i in COLUMN.items()}
    rate = shown[:, COLUMN["ins_accel_mps2" if opened.inputs.by_ins else "rate_mps2"]]
    found["travel"] = np.cumsum(rate) * opened.dt_s
    for name, field in (*FIELDS.items(), ("travel", "ins.speed_mps" if opened.inputs.by_ins else "report.speed_mps")):
        window = opened.derived.get(field, 1)
        if window > 1:  # what was made of a pose is a slope over several values: so is what it is held against
            found[name] = convolve1d(found[name], _under_slope(window), mode="nearest")
        elif field in opened.signals:
            found[name] = opened.signals[field].as_seldom(found[name])
    return Columns(found, opened.dt_s)
