"""Windows out of many tracks at once: a warm-up on what was measured, and what free run is compared with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.learn.drives.drive import Array
from tunefree_hil.learn.drives.runs import runs
from tunefree_hil.learn.evaluation.motion import Track, outputs_of

EVERY_ROWS = 10  # a window can begin at each of these
LEAST_MEAN_MPS = 0.3  # a car that stands teaches nothing
SPEED, YAW, ACCEL, HEADING, X, Y = range(6)
# Kinds of driving that windows are told apart by, as shares of the greatest of each: means over the window of speed,
# pedals (throttle less brake) and turned wheel; finer where a pedal begins to bite.
SPEED_KINDS = tuple(0.1 * i for i in range(1, 10))
PEDAL_KINDS = (0.02, 0.05, 0.1, 0.15, 0.25, 0.5)
WHEEL_KINDS = (0.04, 0.2, 0.5)
GREATEST = 0.999  # quantile that is taken for the greatest
EVEN = 0.5  # 0: every window alike; 1: every kind of driving alike
FEW = 20  # windows, from which on a kind is no rarer


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
        spans += [(at + begin, at + end) for begin, end in runs(track.good)]
        at += track.rows
    motion = [np.stack([t.speed_mps, t.yaw_rate_radps, t.accel_mps2, t.heading_rad, t.x_m, t.y_m], 1) for t in tracks]
    outputs = [outputs_of(track, model, rest) for track in tracks]
    # kind paper learns from what its effects make of the commands: they are run before it in the bench as well
    asked = [outputs_of(track, model, rest, identity=True) for track in tracks]
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


def drawn(some: Array, count: int, seed: int, step: int, chances: Array | None = None) -> Array:
    """`count` of the rows, by lot that only seed and step decide: so a training can go on where it was cut off.

    chances: of each row, in all 1; None for all alike.
    """
    lots = np.random.default_rng([seed, step])
    return np.sort(lots.choice(some, count, replace=chances is not None or len(some) < count, p=chances))


def chances_of(pool: Pool, some: Array, warm: int, ahead: int) -> Array:
    """How often each window is to be drawn: the rarer its kind of driving is among all, the more often.

    Who collects decides how long each kind is driven; nobody knows how long the car will be driven so later. Between
    both: a kind's share is the root of what it would be (EVEN).
    """
    kinds = kinds_of(pool, some, warm, ahead)
    _, kind, counts = np.unique(kinds, axis=0, return_inverse=True, return_counts=True)
    rare = np.maximum(counts[kind.reshape(-1)], FEW).astype(np.float64) ** -EVEN
    return rare / rare.sum()


def kinds_of(pool: Pool, some: Array, warm: int, ahead: int) -> Array:
    """[n, 3]: classes of speed, pedals and wheel of the windows that begin at the rows `some`, in their free part."""
    over = (pool.inputs - torch.tensor([pool.rest, pool.rest, 0.0])).numpy()
    driven = np.stack([pool.motion[:, SPEED].numpy(), over[:, 0] - over[:, 1], np.abs(over[:, 2])], axis=1)
    summed = np.concatenate([np.zeros((1, 3)), np.cumsum(driven, axis=0)])
    means = (summed[some + warm + ahead] - summed[some + warm]) / ahead
    shares = means / np.maximum(np.quantile(np.abs(driven), GREATEST, axis=0), 1e-6)
    pedals = (*(-edge for edge in reversed(PEDAL_KINDS)), *PEDAL_KINDS)
    edges = (SPEED_KINDS, pedals, WHEEL_KINDS)
    return np.stack([np.digitize(shares[:, i], edges[i]) for i in range(3)], axis=1)


def spread(some: Array, count: int) -> Array:
    """At most `count` of the rows, evenly spread."""
    if len(some) <= count:
        return some
    return some[np.linspace(0, len(some) - 1, count).astype(int)]
