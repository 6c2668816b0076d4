"""Windows out of many tracks at once: a warm-up on what was measured, and what free run is compared with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.learn.drives import Array
from tunefree_hil.learn.motion import Track, outputs_of, runs_of

EVERY_ROWS = 10  # a window can begin at each of these
LEAST_MEAN_MPS = 0.3  # a car that stands teaches nothing
SPEED, YAW, ACCEL, HEADING, X, Y = range(6)


class Pool(NamedTuple):
    """All tracks end to end. inputs [n, 3]: actuator outputs (duty, duty, rad at the wheel); commands: the same asked.

    motion [n, 6]: speed, yaw rate, rate of speed, heading, x, y. extra [n, m]: what a learner adds. spans: rows
    [begin, end) without a gap, good throughout.
    """

    dt_s: float
    rest: float
    inputs: Tensor
    commands: Tensor
    motion: Tensor
    grade_rad: Tensor
    spans: tuple[tuple[int, int], ...]

    @property
    def seconds(self) -> float:
        """Of driving that can be used."""
        return sum(end - begin for begin, end in self.spans) * self.dt_s


class Window(NamedTuple):
    """Rows [T, ..., B] of B windows: row `warm` is where free run begins."""

    rows: Tensor  # [T, B] of the pool
    warm: int
    ahead: int


def pool_of(tracks: Sequence[Track], model: ModelSpec, rest: float) -> Pool:
    """The pool of tracks (at least one, all of one tick), with the outputs of the model's own actuators."""
    spans, at = [], 0
    for track in tracks:
        spans += [(at + begin, at + end) for begin, end in runs_of(track.good)]
        at += track.rows
    motion = [np.stack([t.speed_mps, t.yaw_rate_radps, t.accel_mps2, t.heading_rad, t.x_m, t.y_m], 1) for t in tracks]
    outputs = [outputs_of(track, model, rest) for track in tracks]
    asked = [np.where(track.obeyed, track.commands, track.recorded) for track in tracks]
    return Pool(
        tracks[0].dt_s, rest, _tensor(outputs), _tensor(asked), _tensor(motion),
        _tensor([track.grade_rad for track in tracks]), tuple(spans),
    )  # fmt: skip


def with_mirrored(pool: Pool) -> Pool:
    """The pool, and behind it itself with left and right exchanged.

    A car is symmetric but for the offset that `calibrate` takes out of the steering: what is learned of a left turn
    holds for the right one, and a straight wheel turns the car neither way.
    """
    rows = len(pool.inputs)
    steered = torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64)
    turned = torch.ones(6, dtype=torch.float64)
    turned[[YAW, HEADING, Y]] = -1.0
    return pool._replace(
        inputs=torch.cat([pool.inputs, pool.inputs * steered]),
        commands=torch.cat([pool.commands, pool.commands * steered]),
        motion=torch.cat([pool.motion, pool.motion * turned]),
        grade_rad=torch.cat([pool.grade_rad, pool.grade_rad]),
        spans=(*pool.spans, *((begin + rows, end + rows) for begin, end in pool.spans)),
    )


def _tensor(parts: Sequence[Array]) -> Tensor:
    return torch.nan_to_num(torch.from_numpy(np.concatenate(parts)).to(torch.float64))


def begins(pool: Pool, warm: int, ahead: int, every: int = EVERY_ROWS) -> Array:
    """Rows at which a window of warm + ahead ticks can begin, its free part moving."""
    speed = pool.motion[:, SPEED].numpy()
    summed = np.concatenate([[0.0], np.cumsum(speed)])
    found = []
    for begin, end in pool.spans:
        rows = np.arange(begin, end - warm - ahead, every)
        mean = (summed[rows + warm + ahead] - summed[rows + warm]) / ahead
        found.append(rows[mean > LEAST_MEAN_MPS])
    return np.concatenate(found) if found else np.zeros(0, dtype=int)


def window_at(first: Array, warm: int, ahead: int) -> Window:
    """The windows that begin at the rows `first`."""
    rows = torch.from_numpy(first).unsqueeze(0) + torch.arange(warm + ahead + 1).unsqueeze(1)
    return Window(rows, warm, ahead)


def drawn(some: Array, count: int, seed: int, step: int) -> Array:
    """`count` of the rows, by lot that only seed and step decide: so a training can go on where it was cut off."""
    return np.sort(np.random.default_rng([seed, step]).choice(some, count, replace=len(some) < count))


def spread(some: Array, count: int) -> Array:
    """At most `count` of the rows, evenly spread."""
    if len(some) <= count:
        return some
    return some[np.linspace(0, len(some) - 1, count).astype(int)]
