"""What a proof says: the gap by signal before, recalibrated, repaired and at its floor, and how much of it was closed.

The floor is what would be missed if nothing were lacking: the sensor's noise, and what the model's calibration missed
of drives that it was not fitted on (its card). Beside it, and never in it, stands of what the repaired model misses the
part that nothing foretells (gap/diagnostics/lack_of_fit.py): by it any repair after which nothing is foretold would have closed all
there was. Intervals draw whole blocks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.gap.diagnostics.residual_tests import FAR, GROSS
from tunefree_hil.gap.measured.chain import Opened
from tunefree_hil.gap.measured.observability import OUTPUTS
from tunefree_hil.gap.model.card import held_out_of
from tunefree_hil.gap.validation.holdout import HEADING, HUGE, POSITION, UNITS, Proof

Array = np.ndarray

DRAWS = 1000
MOST_WORSE = 0.02  # of a signal's error, that a repair may add
LEAST_OPEN = 0.02  # of the floor: less left by recalibration is no gap
MANY = 1000.0  # times worse, as far as it is told
WORST = -10.0  # share: a repair that makes ten times worse what was open, or that comes to no number, is told as that
CLEARLY = 0.8  # of a signal's error: recalibration that leaves no more is worth a calibration
NOT_SUMMED = (
    "report.throttle_frac", "report.brake_frac", "report.steer_rad", "report.yaw_rate_radps", "ins.yaw_rate_radps"
)  # fmt: skip
BY_CARD = {  # what a calibration's card says of free runs on held-out windows, by signal
    "report.speed_mps": ("speed_mps",), "ins.speed_mps": ("speed_mps",), "report.yaw_rate_radps": ("yaw_rate_radps",),
    "ins.yaw_rate_radps": ("yaw_rate_radps",), "report.lateral_accel_mps2": ("lateral_accel_mps2",),
    HEADING: ("heading_rad",), POSITION: ("x_m", "y_m"),
}  # fmt: skip

_SPEED, _YAW = ("rate_of_speed",), ("yaw_rate",)
HANGS_ON = {  # by signal: targets whose residual tells what could still be explained of it
    "report.throttle_frac": ("throttle",), "report.brake_frac": ("brake",), "report.steer_rad": ("steer",),
    "report.speed_mps": (*_SPEED, "wheel_vs_ins"), "ins.speed_mps": _SPEED,
    "report.yaw_rate_radps": ("steer", *_YAW, "yaw_vs_ins"), "ins.yaw_rate_radps": ("steer", *_YAW),
    "report.accel_mps2": (*_SPEED, "accel_vs_dvdt"),
    "report.lateral_accel_mps2": ("steer", *_YAW, "lateral_beyond_turning", "lateral_accel"),
    HEADING: ("steer", *_YAW), POSITION: ("steer", *_YAW, *_SPEED),
}  # fmt: skip


class Gap(NamedTuple):
    """A signal: RMS by variant (None where there is none), and the floor. unforetold: of what is missed after the
    repair the part that nothing foretells (None where that was not looked at).
    """

    before: float
    recalibrated: float | None
    after: float | None
    floor: float
    unit: str
    unforetold: float | None = None


def floors_of(proof: Proof, model: ModelSpec) -> dict[str, float]:
    """By signal: the sensor's noise, and what the model's own calibration missed of drives that it did not see."""
    held_out, found = held_out_of(model), {}
    by_report = {f"report.{OUTPUTS[name]}": rms for name, (rms, _) in held_out.actuators.items() if name in OUTPUTS}
    for signal in proof.counts:
        missed = [held_out.motion[key] for key in BY_CARD.get(signal, ()) if key in held_out.motion]
        if signal in by_report:
            missed = [by_report[signal]]
        found[signal] = math.sqrt(proof.noise[signal] ** 2 + sum(one * one for one in missed))
    return found


def unforetold(foretold: Mapping[str, float]) -> dict[str, float]:
    """By signal, of what the repaired model misses the part (of the RMS) that nothing foretells. foretold: shares of
    squares by target (gap/measured/targets.py); of several targets that a signal hangs on, the one that is foretold best. A
    signal of which no target was looked at is left out.
    """
    best = {
        signal: max((foretold[name] for name in targets if name in foretold), default=None)
        for signal, targets in HANGS_ON.items()
    }
    return {signal: math.sqrt(1.0 - one) for signal, one in best.items() if one is not None}


def gaps_of(proof: Proof, floors: Mapping[str, float], left: Mapping[str, float]) -> dict[str, Gap]:
    """By signal, what was missed. left: of `unforetold`. The floor is never above what any variant reaches."""
    found = {}
    for signal in proof.counts:
        rms = {name: proof.rms(name, signal) for name in proof.squares}
        after = rms.get("after")
        rest = None if after is None or signal not in left else left[signal] * after
        floor = min(floors[signal], *rms.values())
        found[signal] = Gap(rms["before"], rms.get("recalibrated"), after, floor, UNITS[signal], rest)
    return found


def explained_frac(
    proof: Proof, floors: Mapping[str, float], left: Mapping[str, float] | None = None, seed: int = 1
) -> dict[str, float] | None:
    """(recalibrated - after) / (recalibrated - floor), with a 95 % interval; None where recalibration leaves nothing,
    never below WORST.
    left (of `unforetold`): what nothing foretells is taken for floor too, so that it is of what could be explained.

    Of the signals that are measured and not summed up over time, in units of their floors: the root mean square of each
    block, its mean over blocks, so that one in which every model is far off does not decide alone, and over the signals
    the root mean square. A floor is what many drives miss on average: it is no floor of a single block, of which chance
    makes some worse and others better, and so it is held against that mean.
    """
    signals = [name for name in proof.counts if name not in (HEADING, POSITION) and floors[name] > 0.0]
    if not signals or not proof.blocks:
        return None
    was, now = (_by_block(proof, name, signals, floors) for name in ("recalibrated", "after"))
    share = np.array([(left or {}).get(name, 0.0) for name in signals])
    rows = np.random.default_rng(seed).integers(0, proof.blocks, (DRAWS, proof.blocks))
    every, open_ = _share(was, now, share)
    every = max(every, WORST)
    low, high = np.quantile([_share(was[:, some], now[:, some], share)[0] for some in rows], [0.025, 0.975])
    if open_ <= LEAST_OPEN and every > -LEAST_OPEN:
        return None
    return {"value": every, "low": max(float(low), WORST), "high": max(float(high), WORST)}


def _share(was: Array, now: Array, share: Array) -> tuple[float, float]:
    """(of what is open above the floor the part that is closed, what is open, in floors); of a repair that only spoils,
    of what was there. was, now: [signals, blocks]; share [signals]: of what is missed, what counts as floor too.
    """
    before, after = was.mean(axis=1), now.mean(axis=1)
    reached = np.minimum(before, after)
    least = np.minimum(reached, np.maximum(1.0, share * reached))
    whole, left, floor = (float(np.sqrt((one**2).mean())) for one in (before, after, least))
    open_ = whole - floor
    return (whole - left) / (open_ if open_ > LEAST_OPEN else max(whole, LEAST_OPEN)), open_


def _by_block(proof: Proof, variant: str, signals: Sequence[str], floors: Mapping[str, float]) -> Array:
    """[signals, blocks]: RMS in units of the floors; where a signal was not measured, its mean of the other blocks."""
    rows = []
    for one in signals:
        counts = proof.counts[one]
        rms = np.sqrt(proof.squares[variant][one] / np.maximum(counts, 1.0)) / floors[one]
        seen = counts > 0.0
        rows.append(np.where(seen, rms, rms[seen].mean() if seen.any() else 0.0))
    return np.stack(rows)


def worse_signals(proof: Proof, floors: Mapping[str, float], seed: int = 1) -> dict[str, float]:
    """Signals that the repair makes worse than the model was, beyond MOST_WORSE, its noise and chance: by how much."""
    chance, found = np.random.default_rng(seed), {}
    draws = chance.integers(0, max(proof.blocks, 1), (DRAWS, max(proof.blocks, 1)))
    for signal, counts in proof.counts.items():
        before, after = proof.squares["before"][signal], proof.squares["after"][signal]
        was, now = proof.rms("before", signal), proof.rms("after", signal)
        if ((after >= HUGE) & (before < HUGE)).any():  # it comes to no number there: no chance does that
            found[signal] = MANY
            continue
        if now <= (1.0 + MOST_WORSE) * was or now <= floors[signal] or not counts.sum():
            continue
        more = (after - (1.0 + MOST_WORSE) ** 2 * before)[draws].sum(axis=1)
        if float(np.quantile(more, 0.025)) > 0.0:
            found[signal] = min(now / was - 1.0, MANY) if was > 0.0 else MANY
    return found


def grown(proof: Proof, floors: Mapping[str, float]) -> dict[str, float]:
    """Signals that are worse by more than MOST_WORSE and their noise, be it by chance: by how much."""
    rms = {one: (proof.rms("before", one), proof.rms("after", one)) for one in proof.counts}
    return {
        one: min(now / was - 1.0, MANY) if was > 0.0 else MANY
        for one, (was, now) in rms.items()
        if now > (1.0 + MOST_WORSE) * was and now > floors[one]
    }


def gross(gaps: Mapping[str, Gap], sizes: Mapping[str, float]) -> dict[str, float]:
    """Signals of which so much is missed, even with recalibration, that no car that anybody has calibrated does it
    (gap/diagnostics/residual_tests.py), far above their floors: by how much of the signal, at most MANY. sizes: deviation of each signal
    over whole drives; what has none there is not looked at.
    """
    found = {}
    for name, size in sizes.items():
        one = gaps.get(name)
        if one is None or size <= 0.0:
            continue
        least = one.before if one.recalibrated is None else min(one.before, one.recalibrated)
        if least > GROSS * size and least**2 > FAR * one.floor**2:
            found[name] = min(least / size, MANY)
    return found


def sizes_of(drives: Sequence[Opened]) -> dict[str, float]:
    """Deviation over all drives of what a free run does not sum up over time, and was measured: what actuators report,
    and yaw rates.
    """
    said: dict[str, list[Array]] = {}
    for opened in drives:
        for name in NOT_SUMMED:
            if opened.has(name) and name not in opened.derived:
                one = opened.signals[name]
                said.setdefault(name, []).append(one.values[one.fresh & one.there & opened.moving])
    return {name: float(np.std(whole)) for name, some in said.items() if len(whole := np.concatenate(some))}


def better_by_recalibration(gaps: Mapping[str, Gap]) -> dict[str, tuple[float, float]]:
    """Signals that recalibration alone takes CLEARLY nearer to the measurement: RMS before and after it."""
    return {
        name: (one.before, one.recalibrated)
        for name, one in gaps.items()
        if one.recalibrated is not None
        and one.recalibrated < CLEARLY * one.before
        and one.before**2 - one.recalibrated**2 > one.floor**2
    }
