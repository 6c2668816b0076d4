"""Free run of a model folder against drives: what its plant says after 1, 3, 10, 30 s on recorded commands alone.

For a second the plant is told the measured motion at every tick, so that its memory fills; then it runs by itself. The
commands go through the model's own actuators. On hills the road's slope is given (learn/evaluation/motion.py says from what). The
kernels are those of ECU and batch; in a worker of learn/compiled_process.py they are compiled.

Free-run errors as tables with intervals: level ground and hills apart, drives drawn again and again, not starts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base import parts
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import buffer, kernel, table
from tunefree_hil.base.records import GEAR_DRIVE, Actuation, Disturbance, Motion
from tunefree_hil.config.schema import ModelSpec, VehicleSpec
from tunefree_hil.learn.data_sheet import rear_behind_m
from tunefree_hil.learn.drives.drive import Array
from tunefree_hil.learn.evaluation.motion import Track, body_change, is_hill, outputs_of, starts_of, wrapped
from tunefree_hil.plant.types import ChassisInput, Plant

WARM_S = 1.0
HORIZONS_S = (1.0, 3.0, 10.0, 30.0)
NEEDED_S = 10.0  # a start without so much good road ahead is none; the longer horizons are taken where there is room
HILL_AHEAD_S = 10.0
EVERY_S = 1.0
SEEN, TAKEN, SHOWN = 7, 4, 5  # numbers of a row in `ride`


class Judged(NamedTuple):
    """Errors of one model, a row a start, a column a horizon; NaN where the drive ends before.

    drives: where each start is from. metres: driven since the start. accel_mps2, yaw_rate_radps: one-step errors, RMS.
    """

    kind: str
    horizons_s: tuple[float, ...]
    drives: tuple[str, ...]
    hill: Array
    position_m: Array
    heading_rad: Array
    speed_mps: Array
    metres: Array
    accel_mps2: float
    yaw_rate_radps: float


class Rig(NamedTuple):
    """A model's chassis, ready to run."""

    kind: str
    block: Any
    ride: Callable[..., int]
    model: ModelSpec
    identity: bool  # the plant takes commands


def plant_of(model: ModelSpec) -> Plant:
    """The plant of a model folder. Raises InputError for a kind that is no chassis to put a measured motion into."""
    kind = model.plant.kind
    plant = parts.load("tunefree_hil.plant", "single_track" if kind == "physics" else kind, "PLANT")
    if plant.observe is None:
        raise InputError(
            f"a plant of kind {kind!r} cannot be told a measured motion",
            code="no_free_run",
            file=f"{model.folder}/model.toml",
            key="plant.kind",
            hint="physics, hybrid, lstm, mlp, rule_based or paper",
        )
    if plant.open is not None:
        return plant.open(Path(model.folder) / (model.plant.file or plant.file))
    return plant


def rig_of(model: ModelSpec) -> Rig:
    """The chassis of a model folder with the model's effects on the body."""
    plant = plant_of(model)
    block = plant.make(model.plant.params, body_change(model))
    return Rig(model.plant.kind, block, make_ride(block.step, plant.observe), model, plant.actuators is not None)


def make_ride(step: Any, observe: Any) -> Callable[..., int]:
    """The loop for a chassis: told the motion in rows 0 to `warm`, on its own from there."""

    @kernel
    def ride(params: Any, state: Any, seen: Any, inputs: Any, warm: int, shown: Any, dt_s: float) -> int:
        """seen: x, y, heading, speed, side speed, yaw rate, rate of speed; inputs: throttle, brake, steer, slope of the
        step to a row; shown: x, y, heading, speed, yaw rate that the plant says of a row. Returns the rows."""
        rows = len(inputs) // TAKEN
        for k in range(1, rows):
            if k - 1 <= warm:
                at = (k - 1) * SEEN
                state = observe(
                    state,
                    Motion(
                        float(seen[at]), float(seen[at + 1]), float(seen[at + 2]), float(seen[at + 3]),
                        float(seen[at + 4]), float(seen[at + 5]), 0.0, 0.0, float(seen[at + 6]), 0.0, 0.0, 0.0, 0.0,
                    ),
                )  # fmt: skip
            at = k * TAKEN
            act = Actuation(float(inputs[at]), float(inputs[at + 1]), float(inputs[at + 2]), GEAR_DRIVE)
            state, motion = step(params, state, ChassisInput(act, Disturbance(float(inputs[at + 3]), 1.0)), dt_s)
            at = k * SHOWN
            shown[at] = motion.x_m
            shown[at + 1] = motion.y_m
            shown[at + 2] = motion.heading_rad
            shown[at + 3] = motion.speed_mps
            shown[at + 4] = motion.yaw_rate_radps
        return rows

    return ride


def ridden(rig: Rig, track: Track, outputs: Array, first: int, warm: int, ahead: int, behind_m: float) -> Array:
    """[warm + ahead + 1, SHOWN] of the rows from `first` on; row 0 is what was measured. outputs: as `outputs_of`."""
    cut = slice(first, first + warm + ahead + 1)
    measured = np.stack([track.x_m, track.y_m, track.heading_rad, track.speed_mps, track.yaw_rate_radps], axis=1)[cut]
    side = behind_m * track.yaw_rate_radps[cut]  # of the centre of mass, the rear axle not slipping
    seen = np.column_stack([measured[:, :4], side, measured[:, 4], track.accel_mps2[cut]])
    inputs = np.column_stack([outputs[cut], track.grade_rad[cut]])
    start = Start(*(float(value) for value in measured[0, :4]))
    params = rig.block.params._replace(start=start)
    shown = buffer(len(measured) * SHOWN)
    state = rig.block.init(params, track.dt_s)
    rig.ride(params, state, table(seen.ravel()), table(inputs.ravel()), warm, shown, track.dt_s)
    found = np.asarray(shown).reshape(-1, SHOWN)
    found[0] = measured[0]
    return found


def judge(
    model: ModelSpec,
    vehicle: VehicleSpec,
    tracks: Sequence[Track],
    *,
    every_s: float = EVERY_S,
    most: int = 0,
    horizons_s: tuple[float, ...] = HORIZONS_S,
    needed_s: float = NEEDED_S,
) -> Judged:
    """The errors of a model over all starts of tracks, `every_s` apart; at most `most` of them, evenly spread (0: all).

    needed_s: good road that a start must have ahead. Raises InputError where there is no start.
    """
    rig = rig_of(model)
    rest = vehicle.nominal.rest_pedal_frac
    behind_m = rear_behind_m(vehicle.nominal)
    some = _starts(tracks, every_s, needed_s, most)
    outputs = {i: outputs_of(tracks[i], model, rest, rig.identity) for i in {i for i, _ in some}}
    errors, one_step = [], []
    for i, row in some:
        track = tracks[i]
        warm, ahead = round(WARM_S / track.dt_s), _room(track, row, max(horizons_s))
        shown = ridden(rig, track, outputs[i], row - warm, warm, ahead, behind_m)
        errors.append(_errors(track, shown[warm:], row, [round(one / track.dt_s) for one in horizons_s]))
        one_step.append(_one_step(track, shown, row - warm, warm))
    found = np.array(errors)  # [starts, 4, horizons]
    missed = np.concatenate(one_step)
    hill = np.array([is_hill(tracks[i], row, round(HILL_AHEAD_S / tracks[i].dt_s)) for i, row in some])
    return Judged(
        rig.kind, tuple(horizons_s), tuple(tracks[i].name for i, _ in some), hill,
        found[:, 0], found[:, 1], found[:, 2], found[:, 3], *np.sqrt((missed**2).mean(axis=0)).tolist(),
    )  # fmt: skip


def _starts(tracks: Sequence[Track], every_s: float, needed_s: float, most: int) -> list[tuple[int, int]]:
    """(track, row) of every start."""
    found = []
    for i, track in enumerate(tracks):
        warm, ahead = round(WARM_S / track.dt_s), round(needed_s / track.dt_s)
        found += [(i, row) for row in starts_of(track, warm, ahead, max(round(every_s / track.dt_s), 1))]
    if not found:
        raise InputError(
            f"no drive has {WARM_S + needed_s:g} s without a gap, in drive gear and moving",
            code="too_short",
            key="LOG",
            hint="record longer drives to judge by",
        )
    if most and len(found) > most:
        found = [found[k] for k in np.linspace(0, len(found) - 1, most).astype(int)]
    return found


def _room(track: Track, row: int, horizon_s: float) -> int:
    """Good rows ahead, up to the horizon."""
    ahead = track.good[row : row + round(horizon_s / track.dt_s) + 1]
    return int(np.argmin(ahead)) - 1 if not ahead.all() else len(ahead) - 1


def _errors(track: Track, shown: Array, row: int, horizons: Sequence[int]) -> list[list[float]]:
    """[position, heading, speed, metres] by horizon; shown: from the start on."""
    found = [[np.nan] * len(horizons) for _ in range(4)]
    steps = np.hypot(np.diff(track.x_m[row : row + len(shown)]), np.diff(track.y_m[row : row + len(shown)]))
    for column, ahead in enumerate(horizons):
        if ahead < len(shown):
            x, y, heading, speed, _ = shown[ahead]
            at = row + ahead
            found[0][column] = float(np.hypot(x - track.x_m[at], y - track.y_m[at]))
            found[1][column] = float(abs(wrapped(heading - track.heading_rad[at])))
            found[2][column] = float(abs(speed - track.speed_mps[at]))
            found[3][column] = float(steps[:ahead].sum())
    return found


def _one_step(track: Track, shown: Array, first: int, warm: int) -> Array:
    """[rows, 2]: errors of the rate of speed and the yaw rate one tick after a measured motion, memory filled."""
    rows = np.arange(warm // 2, warm + 1)
    at = first + rows
    rate = (shown[rows, 3] - track.speed_mps[at - 1]) / track.dt_s
    return np.stack([rate - track.accel_mps2[at], shown[rows, 4] - track.yaw_rate_radps[at]], axis=1)


def judge_all(
    models: Mapping[str, ModelSpec], vehicle: VehicleSpec, tracks: Sequence[Track], options: Mapping[str, Any]
) -> Any:
    """A generator for a worker: names as they are done; returns Judged by name. options: keywords of `judge`."""
    found = {}
    for name, model in models.items():
        found[name] = judge(model, vehicle, tracks, **options)
        yield name
    return found


def headings_of(
    models: Mapping[str, ModelSpec], vehicle: VehicleSpec, track: Track, row: int, seconds: float
) -> dict[str, Array]:
    """What each model says of the heading from a start on, rad, a value a tick (the paper's Fig. 3b)."""
    rest = vehicle.nominal.rest_pedal_frac
    behind_m = rear_behind_m(vehicle.nominal)
    warm, ahead, found = round(WARM_S / track.dt_s), _room(track, row, seconds), {}
    for name, model in models.items():
        rig = rig_of(model)
        outputs = outputs_of(track, model, rest, rig.identity)
        found[name] = ridden(rig, track, outputs, row - warm, warm, ahead, behind_m)[warm:, 2]
    return found


RESAMPLES = 1000
MANY = 15  # drives from which on their bootstrap will do
QUANTITIES = ("position_m", "heading_rad", "speed_mps")


def table_of(judged: Judged, seed: int = 1) -> dict[str, Any]:
    """Plain data: rows 'level' and 'hills' (None where there is no such start), and the one-step errors.

    A row has the counts of starts and drives and by horizon ('10') for each quantity mean, its 95 % interval (None
    where all starts are of one drive) and the 95th percentile, and position error per metre driven (mean over starts
    that moved).
    """
    found: dict[str, Any] = {
        "kind": judged.kind,
        "one_step": {"accel_mps2": judged.accel_mps2, "yaw_rate_radps": judged.yaw_rate_radps},
    }
    for name, rows in (("level", ~judged.hill), ("hills", judged.hill)):
        found[name] = _row(judged, rows, seed) if rows.any() else None
    return found


def _row(judged: Judged, rows: Array, seed: int) -> dict[str, Any]:
    drives = np.array(judged.drives)[rows]
    row: dict[str, Any] = {"starts": int(rows.sum()), "drives": len(set(drives.tolist()))}
    for column, seconds in enumerate(judged.horizons_s):
        values = {name: getattr(judged, name)[rows, column] for name in QUANTITIES}
        metres = judged.metres[rows, column]
        with np.errstate(invalid="ignore"):
            values["position_per_m"] = np.where(metres > 1.0, values["position_m"] / np.maximum(metres, 1.0), np.nan)
        if np.isfinite(values["position_m"]).any():
            row[f"{seconds:g}"] = {name: _spread(one, drives, seed) for name, one in values.items()}
    return row


def _spread(values: Array, drives: Array, seed: int) -> dict[str, Any]:
    known = np.isfinite(values)
    if not known.any():
        return {"n": 0, "mean": None, "p95": None, "low": None, "high": None}
    low, high = (None if math.isnan(one) else one for one in interval_of(values[known], drives[known], seed))
    mean, p95 = float(values[known].mean()), float(np.percentile(values[known], 95))
    return {"n": int(known.sum()), "mean": mean, "p95": p95, "low": low, "high": high}


def interval_of(values: Array, drives: Array, seed: int = 1) -> tuple[float, float]:
    """95 % interval of the mean over whole drives: by their bootstrap, or of few by Student's t (`few_drives`)."""
    totals, counts = _by_drive(values, drives)
    if len(totals) < MANY:
        return few_drives(totals, counts)
    picks = np.random.default_rng(seed).integers(0, len(totals), (RESAMPLES, len(totals)))
    means = totals[picks].sum(axis=1) / counts[picks].sum(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def few_drives(parts: Array, wholes: Array) -> tuple[float, float]:
    """95 % interval of sum(parts) / sum(wholes), one of each a drive, by Student's t: a bootstrap of a few drives, or
    their least and most, holds the truth far too seldom. Of one drive nothing says how far others are off: NaN.
    """
    from scipy.stats import t as student

    n, ratio = len(parts), float(parts.sum() / wholes.sum())
    if n < 2:
        return math.nan, math.nan
    left = parts - ratio * wholes
    doubt = math.sqrt(n / (n - 1.0) * float(left @ left)) / abs(float(wholes.sum()))
    reach = float(student.ppf(0.975, n - 1)) * doubt
    least = 0.0 if (parts >= 0.0).all() else -math.inf  # of errors, which are not below 0
    return max(ratio - reach, least), ratio + reach


def _by_drive(values: Array, drives: Array) -> tuple[Array, Array]:
    """(sum, count) of each drive."""
    _, place = np.unique(drives, return_inverse=True)
    return np.bincount(place, weights=values), np.bincount(place).astype(np.float64)


def reduction(ours: Judged, other: Judged, seconds: float, *, hills: bool = False, seed: int = 1) -> dict[str, Any]:
    """By how many percent the mean position error is smaller than another model's over the same starts.

    With a 95 % interval (whole drives drawn, both models on the same ones) and the number of starts.
    """
    column = ours.horizons_s.index(seconds)
    mine, theirs = ours.position_m[:, column], other.position_m[:, column]
    rows = np.isfinite(mine) & np.isfinite(theirs) & (ours.hill == hills)
    drives = np.array(ours.drives)[rows]
    sums, _ = _by_drive(mine[rows], drives)
    others, counts = _by_drive(theirs[rows], drives)
    value = 100.0 * (1.0 - float(sums.sum()) / float(others.sum()))
    if len(counts) < MANY:
        ends = (100.0 * (1.0 - one) for one in few_drives(sums, others)[::-1])
        low, high = (None if math.isnan(one) else one for one in ends)
        return {"value": value, "low": low, "high": high, "n": int(rows.sum())}
    picks = np.random.default_rng(seed).integers(0, len(counts), (RESAMPLES, len(counts)))
    drawn = 100.0 * (1.0 - sums[picks].sum(axis=1) / others[picks].sum(axis=1))
    low, high = np.percentile(drawn, [2.5, 97.5])
    return {"value": value, "low": float(low), "high": float(high), "n": int(rows.sum())}
