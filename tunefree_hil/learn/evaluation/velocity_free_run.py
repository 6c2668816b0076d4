"""Free run in speed and yaw rate, model beside model: for cars whose position nobody measured.

The same starts for all, and beside them the plainest of guesses: the car keeps the speed and the yaw rate that it had.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ModelSpec, VehicleSpec
from tunefree_hil.learn.data_sheet import rear_behind_m
from tunefree_hil.learn.drives.drive import Array
from tunefree_hil.learn.evaluation.free_run import WARM_S, ridden, rig_of
from tunefree_hil.learn.evaluation.motion import Track, outputs_of, starts_of

SPEED, YAW = 3, 4  # of a row of `ridden`
NAIVE = "keeps its speed"
HORIZONS_S = (1.0, 3.0, 10.0)


class Trace(NamedTuple):
    """One free run as long as it goes: stamps from the start, s; speed and yaw rate measured, and by model, [n]."""

    name: str
    time_s: Array
    speed_mps: Array
    yaw_rate_radps: Array
    speeds: Mapping[str, Array]
    yaw_rates: Mapping[str, Array]


class Ahead(NamedTuple):
    """Absolute errors by model, a row a start, a column a horizon; NaN where the stretch ends before.

    drives: where each start is from. traces: the longest runs, one a stretch.
    """

    horizons_s: tuple[float, ...]
    drives: tuple[str, ...]
    speed_mps: Mapping[str, Array]
    yaw_rate_radps: Mapping[str, Array]
    traces: tuple[Trace, ...]


def look_ahead(
    models: Mapping[str, ModelSpec],
    vehicle: VehicleSpec,
    tracks: Sequence[Track],
    every_s: float = 0.5,
    horizons_s: tuple[float, ...] = HORIZONS_S,
) -> Generator[str, None, Ahead]:
    """Run all models from all starts; yields the stretches' names as they are done, for a worker.

    Raises InputError where no stretch has a start with room for the shortest horizon.
    """
    drives: list[str] = []
    traces: list[Trace] = []
    errors: dict[str, list[Array]] = {name: [] for name in (*models, NAIVE)}
    rigs = {name: rig_of(model) for name, model in models.items()}
    behind_m = rear_behind_m(vehicle.nominal)
    for track in tracks:
        warm, least = round(WARM_S / track.dt_s), round(min(horizons_s) / track.dt_s)
        rest = vehicle.nominal.rest_pedal_frac
        outputs = {name: outputs_of(track, rig.model, rest, rig.identity) for name, rig in rigs.items()}
        longest: Trace | None = None
        for row in starts_of(track, warm, least, max(round(every_s / track.dt_s), 1)):
            ahead = min(room(track, row), round(max(horizons_s) / track.dt_s))
            runs = {
                name: ridden(rig, track, outputs[name], row - warm, warm, ahead, behind_m)[warm:]
                for name, rig in rigs.items()
            }
            one = traced(track, row, ahead, runs)
            drives.append(track.name)
            for name in errors:
                errors[name].append(_missed(one, name, horizons_s, track.dt_s))
            longest = one if longest is None or len(one.time_s) > len(longest.time_s) else longest
        traces += [] if longest is None else [longest]
        yield track.name
    if not drives:
        raise InputError(
            f"no stretch has {WARM_S + min(horizons_s):g} s without a gap, moving and obeying",
            code="too_short",
            key="LOG",
            hint="record longer drives to judge by",
        )
    found = {name: np.array(some) for name, some in errors.items()}  # [starts, 2, horizons]
    return Ahead(
        tuple(horizons_s), tuple(drives), {name: one[:, 0] for name, one in found.items()},
        {name: one[:, 1] for name, one in found.items()}, tuple(traces),
    )  # fmt: skip


def room(track: Track, row: int) -> int:
    """Good rows behind a start."""
    rest = track.good[row:]
    return len(rest) - 1 if rest.all() else int(np.argmin(rest)) - 1


def traced(track: Track, row: int, ahead: int, runs: Mapping[str, Any]) -> Trace:
    """Measured motion from a row on, and what models made of it: rows of `ridden` from the start on, by name."""
    cut = slice(row, row + ahead + 1)
    speed, yaw = track.speed_mps[cut], track.yaw_rate_radps[cut]
    speeds = {name: run[:, SPEED] for name, run in runs.items()} | {NAIVE: np.full(ahead + 1, speed[0])}
    yaws = {name: run[:, YAW] for name, run in runs.items()} | {NAIVE: np.full(ahead + 1, yaw[0])}
    time_s = track.dt_s * np.arange(ahead + 1)
    return Trace(track.name, time_s, speed, yaw, speeds, yaws)


def _missed(one: Trace, name: str, horizons_s: Sequence[float], dt_s: float) -> Array:
    """[2, horizons]: how far speed and yaw rate are off."""
    found = np.full((2, len(horizons_s)), np.nan)
    for column, seconds in enumerate(horizons_s):
        k = round(seconds / dt_s)
        if k < len(one.time_s):
            found[0, column] = abs(one.speeds[name][k] - one.speed_mps[k])
            found[1, column] = abs(one.yaw_rates[name][k] - one.yaw_rate_radps[k])
    return found
