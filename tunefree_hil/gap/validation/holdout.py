"""The proof: free runs of the whole car over blocks that no fit and no choice has seen, looked at once.

The same free runs over the blocks that choose say which of what recalibration moved pays (gap/validation/update_selection.py). A block is at
least 8 s, less where the logs are short (gap/measured/blocks.py); before it the car is told the measured motion, in it nothing
but the recorded commands. Errors are root mean squares by signal; what they say is in gap/validation/gap_closed.py.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.config.schema import EffectSpec, ModelSpec, VehicleSpec
from tunefree_hil.gap.measured.blocks import PROOF
from tunefree_hil.gap.measured.chain import Opened, is_driven
from tunefree_hil.gap.measured.holdout_assignment import dealt
from tunefree_hil.gap.measured.observability import OUTPUTS
from tunefree_hil.gap.measured.targets import STEERING
from tunefree_hil.gap.validation.free_run import car_of, pose_of, run_over
from tunefree_hil.learn.evaluation.motion import wrapped

Array = np.ndarray

POSITION, HEADING = "position_m", "ins.heading_rad"
MOST = 1e12  # no signal of a car is that: a run that says more, or no number, has come to nothing
HUGE = 1e30  # squares of such a run in a block: more than any other's, and a number all the same
UNITS = {
    "report.throttle_frac": "1", "report.brake_frac": "1", "report.steer_rad": "rad", "report.speed_mps": "m/s",
    "report.yaw_rate_radps": "rad/s", "report.accel_mps2": "m/s2", "report.lateral_accel_mps2": "m/s2",
    "ins.speed_mps": "m/s", "ins.yaw_rate_radps": "rad/s", HEADING: "rad", POSITION: "m",
}  # fmt: skip
ALONG = ("report.speed_mps", "report.accel_mps2", "ins.speed_mps")  # they hardly ask how the car was steered


class Variant(NamedTuple):
    """A car to be run: a model, and effects of the day behind its own."""

    model: ModelSpec
    day: tuple[EffectSpec, ...] = ()


class Proof(NamedTuple):
    """squares: by variant and signal, of errors summed over each block [b]; counts: by signal [b]; noise: of sensors,
    root mean square over the rows that count, as the errors are.

    traces: of all blocks, that in which the variants differ most first, for pictures.
    """

    squares: Mapping[str, Mapping[str, Array]]
    counts: Mapping[str, Array]
    noise: Mapping[str, float]
    traces: tuple[Traces, ...]

    @property
    def blocks(self) -> int:
        """How many."""
        return max((len(one) for one in self.counts.values()), default=0)

    def rms(self, variant: str, signal: str) -> float:
        """Of a signal over all blocks."""
        return math.sqrt(float(self.squares[variant][signal].sum()) / max(float(self.counts[signal].sum()), 1.0))


class Traces(NamedTuple):
    """One block: time since its beginning, the commands, measured and simulated by variant and signal."""

    time_s: Array
    measured: Mapping[str, Array]
    simulated: Mapping[str, Mapping[str, Array]]


def prove(
    variants: Mapping[str, Variant], vehicle: VehicleSpec, drives: Sequence[Opened], *, role: int = PROOF,
    whole: bool = False, brief: bool = False,
) -> Proof:  # fmt: skip
    """Run all variants over the blocks of a role (gap/measured/blocks.py; whole: over all, of a recording that nothing was
    fitted on). brief: what lies far from these is not driven, by cars that forget it (gap/validation/free_run.py).
    """
    blocks = dealt(drives)
    squares: dict[str, dict[str, list[float]]] = {name: {} for name in variants}
    counts: dict[str, list[float]] = {}
    noise: dict[str, float] = {}
    traces: list[Traces] = []
    signals = [name for name in UNITS if any(_has(one, name) for one in drives)]
    for number, opened in enumerate(drives):
        mine = [
            (int(blocks.begins[b]), int(blocks.ends[b]))
            for b in np.flatnonzero((blocks.drives == number) & (whole | (blocks.roles == role)))
            if is_driven(opened, slice(blocks.begins[b], blocks.ends[b]))
        ]
        if not mine:
            continue
        said = {name: _run(one, vehicle, opened, mine, brief=brief) for name, one in variants.items()}
        for signal in signals:
            good, loud = _measured(opened, signal), _noise(opened, signal)
            for begin, end in mine:
                rows = begin + np.flatnonzero(good[begin:end])
                counts.setdefault(signal, []).append(float(len(rows)))
                noise[signal] = noise.get(signal, 0.0) + len(rows) * loud * loud
                for name in variants:
                    missed = _missed(signal, said[name], opened, rows, begin)
                    squares[name].setdefault(signal, []).append(_square(missed))
        traces += [_trace(opened, said, one) for one in mine]
    return Proof(
        {name: {signal: np.array(one) for signal, one in some.items()} for name, some in squares.items()},
        {signal: np.array(one) for signal, one in counts.items()},
        {signal: math.sqrt(one / max(sum(counts[signal]), 1.0)) for signal, one in noise.items()},
        tuple(sorted(traces, key=_liveliness, reverse=True)),
    )


def _run(
    variant: Variant, vehicle: VehicleSpec, opened: Opened, blocks: Sequence[tuple[int, int]], *, brief: bool
) -> dict[str, Array]:
    """What a variant says, on its own in the blocks."""
    held = np.ones(opened.ticks, dtype=bool)
    for begin, end in blocks:
        held[begin:end] = False
    said = run_over(car_of(variant.model, vehicle, opened, variant.day), opened, held, brief=brief)
    return {name: np.where(np.abs(values) < MOST, values, np.nan) for name, values in said.items()}


def _square(missed: Array) -> float:
    """Sum of squares; of a run that came to no number HUGE, so that it is the worst of all wherever it is compared."""
    square = float(missed @ missed)
    return square if math.isfinite(square) else HUGE


def _has(opened: Opened, signal: str) -> bool:
    """Whether a signal was measured, and a free run can come to it by what is known of pedals and steering."""
    hidden = opened.unknown - STEERING if signal in ALONG else opened.unknown
    if hidden and not signal.endswith(tuple(OUTPUTS.values())):
        return False
    return opened.has("ins.x_m", "ins.y_m") if signal == POSITION else opened.has(signal)


def _measured(opened: Opened, signal: str) -> Array:
    """Rows in which a signal was measured, none of one that this recording does not have."""
    if not _has(opened, signal):
        return np.zeros(opened.ticks, dtype=bool)
    one = opened.signals["ins.x_m" if signal == POSITION else signal]
    return one.fresh & one.there


def _noise(opened: Opened, signal: str) -> float:
    """Standard deviation of a sensor's noise; what counts from where a block begins has the noise of that place too."""
    if not _has(opened, signal):
        return 0.0
    one = opened.signals["ins.x_m" if signal == POSITION else signal]
    return one.noise * {HEADING: math.sqrt(2.0), POSITION: 2.0}.get(signal, 1.0)


def _missed(signal: str, said: Mapping[str, Array], opened: Opened, rows: Array, begin: int) -> Array:
    """Errors at some rows of a block. Heading and position count from where the block begins."""
    if not len(rows):
        return np.zeros(0)
    if signal == POSITION:
        x, y, _ = pose_of(opened)
        east, north = said["ins.x_m"][rows] - x[rows], said["ins.y_m"][rows] - y[rows]
        return np.hypot(east - (said["ins.x_m"][begin] - x[begin]), north - (said["ins.y_m"][begin] - y[begin]))
    one = opened.signals[signal]
    missed = one.as_told(said[signal], rows) - one.told[rows]
    return wrapped(missed - (said[signal][begin] - one.values[begin])) if signal == HEADING else missed


def _trace(opened: Opened, said: Mapping[str, Mapping[str, Array]], block: tuple[int, int]) -> Traces:
    cut = slice(*block)
    names = [name for name in UNITS if name in opened.signals and _has(opened, name)]
    return Traces(
        np.arange(block[1] - block[0]) * opened.dt_s,
        {name: opened.signals[name].values[cut] for name in names},
        {variant: {name: one[name][cut] for name in names} for variant, one in said.items()},
    )


def _liveliness(one: Traces) -> float:
    """How far apart the first variant and the last are there."""
    variants = list(one.simulated)
    first, last = one.simulated[variants[0]], one.simulated[variants[-1]]
    spread = {name: max(float(np.std(values)), 1e-9) for name, values in one.measured.items() if name != HEADING}
    apart = {name: np.nan_to_num(first[name] - last[name], nan=MOST) for name in spread}
    return sum(float(np.mean(apart[name] ** 2)) / size**2 for name, size in spread.items())
