"""Batches of windows from many tracks: a warm-up on the measured motion, then free run that is compared with it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.learn.drives.drive import Array
from tunefree_hil.learn.drives.runs import find_runs
from tunefree_hil.learn.evaluation.motion import MotionTrack, simulate_actuators

START_SPACING_ROWS = 10
SPEED, YAW, ACCEL, HEADING, X, Y = range(6)  # columns of TrackPool.motion
# Edges of the classes of driving, as shares of the greatest value: means over the window of speed, pedals (throttle
# less brake) and steering wheel; finer where a pedal begins to act.
SPEED_CLASS_EDGES = tuple(0.1 * i for i in range(1, 10))
PEDAL_CLASS_EDGES = (0.02, 0.05, 0.1, 0.15, 0.25, 0.5)
STEER_CLASS_EDGES = (0.04, 0.2, 0.5)


class TrainingWindowCriteria(NamedTuple):
    """How windows are selected and drawn (docs/results/criteria.md)."""

    min_mean_speed_mps: float = 0.3  # mean speed of the free part; at standstill there is nothing to learn
    greatest_quantile: float = 0.999  # in place of the greatest value, so that single outliers do not set the scale
    # 0: all windows have equal weight; 1: all classes of driving; between them, as later use is unknown
    balancing_exponent: float = 0.5
    min_class_windows: int = 20  # a class with fewer windows is drawn as if it had this number


CRITERIA = TrainingWindowCriteria()


class TrackPool(NamedTuple):
    """All tracks end to end.

    Attributes:
        rest: Duty of a released pedal.
        inputs: Actuator outputs (duty, duty, rad at the wheel), shape (n_rows, 3).
        commands: The same as commanded.
        motion: Columns SPEED to Y, shape (n_rows, 6).
        spans: [begin, end) of usable rows without a gap.
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
        """Usable driving."""
        return sum(end - begin for begin, end in self.spans) * self.dt_s


class WindowBatch(NamedTuple):
    """Windows of one length. rows: of the pool, shape (n_ticks, n_windows); free run begins at row `warm_up`."""

    rows: Tensor
    warm_up: int
    ahead: int


def make_pool(tracks: Sequence[MotionTrack], model: ModelSpec, rest: float) -> TrackPool:
    """The pool of tracks (at least one, all of one tick), with the outputs of the model's actuators."""
    spans, offset = [], 0
    for track in tracks:
        spans += [(offset + begin, offset + end) for begin, end in find_runs(track.is_good)]
        offset += track.n_rows
    motion = [np.stack([t.speed_mps, t.yaw_rate_radps, t.accel_mps2, t.heading_rad, t.x_m, t.y_m], 1) for t in tracks]
    outputs = [simulate_actuators(track, model, rest) for track in tracks]
    # Kind paper takes commands: in the bench, too, the effects act on them before the plant.
    commands = [simulate_actuators(track, model, rest, takes_commands=True) for track in tracks]
    return TrackPool(
        dt_s=tracks[0].dt_s,
        rest=rest,
        inputs=_tensor_from_arrays(outputs),
        commands=_tensor_from_arrays(commands),
        motion=_tensor_from_arrays(motion),
        grade_rad=_tensor_from_arrays([track.grade_rad for track in tracks]),
        spans=tuple(spans),
    )


def add_mirrored(pool: TrackPool) -> TrackPool:
    """The pool, followed by itself with left and right exchanged.

    A vehicle is symmetric but for the steering offset, which `calibrate` removes. So what is learned in a left turn
    is valid for a right turn, and with a centred wheel the vehicle drives straight on.
    """
    rows = len(pool.inputs)
    steer_sign = torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64)
    motion_sign = torch.ones(6, dtype=torch.float64)
    motion_sign[[YAW, HEADING, Y]] = -1.0
    return pool._replace(
        inputs=torch.cat([pool.inputs, pool.inputs * steer_sign]),
        commands=torch.cat([pool.commands, pool.commands * steer_sign]),
        motion=torch.cat([pool.motion, pool.motion * motion_sign]),
        grade_rad=torch.cat([pool.grade_rad, pool.grade_rad]),
        spans=(*pool.spans, *((begin + rows, end + rows) for begin, end in pool.spans)),
    )


def _tensor_from_arrays(arrays: Sequence[Array]) -> Tensor:
    return torch.nan_to_num(torch.from_numpy(np.concatenate(arrays)).to(torch.float64))


def find_window_starts(pool: TrackPool, warm_up: int, ahead: int, every: int = START_SPACING_ROWS) -> Array:
    """Rows at which a window of warm_up + ahead ticks can begin, its free part in motion."""
    speed = pool.motion[:, SPEED].numpy()
    summed = np.concatenate([[0.0], np.cumsum(speed)])
    starts = []
    for begin, end in pool.spans:
        rows = np.arange(begin, end - warm_up - ahead, every)
        mean = (summed[rows + warm_up + ahead] - summed[rows + warm_up]) / ahead
        starts.append(rows[mean > CRITERIA.min_mean_speed_mps])
    return np.concatenate(starts) if starts else np.zeros(0, dtype=int)


def make_windows(starts: Array, warm_up: int, ahead: int) -> WindowBatch:
    """The windows that begin at the rows `starts`."""
    rows = torch.from_numpy(starts).unsqueeze(0) + torch.arange(warm_up + ahead + 1).unsqueeze(1)
    return WindowBatch(rows, warm_up, ahead)


def draw_rows(rows: Array, count: int, seed: int, step: int, probabilities: Array | None = None) -> Array:
    """Draw `count` of the rows, from seed and step alone, so that a training can be resumed.

    Args:
        rows: To draw from.
        count: How many.
        seed: Of the training.
        step: Of the training.
        probabilities: Of each row, with sum 1; None: equal.
    """
    rng = np.random.default_rng([seed, step])
    return np.sort(rng.choice(rows, count, replace=probabilities is not None or len(rows) < count, p=probabilities))


def compute_draw_probabilities(pool: TrackPool, starts: Array, warm_up: int, ahead: int) -> Array:
    """Probability of each window: the rarer its class of driving, the greater.

    The logs need not have the classes in the proportions of later use. A class's share is between that in the logs and
    an equal one (balancing_exponent).
    """
    classes = classify_windows(pool, starts, warm_up, ahead)
    _, label, counts = np.unique(classes, axis=0, return_inverse=True, return_counts=True)
    n_windows = np.maximum(counts[label.reshape(-1)], CRITERIA.min_class_windows)
    probabilities = n_windows.astype(np.float64) ** -CRITERIA.balancing_exponent
    return probabilities / probabilities.sum()


def classify_windows(pool: TrackPool, starts: Array, warm_up: int, ahead: int) -> Array:
    """Classes of speed, pedals and steering in the free part of each window, shape (n_windows, 3)."""
    over_rest = (pool.inputs - torch.tensor([pool.rest, pool.rest, 0.0])).numpy()
    pedals = over_rest[:, 0] - over_rest[:, 1]
    signals = np.stack([pool.motion[:, SPEED].numpy(), pedals, np.abs(over_rest[:, 2])], axis=1)
    summed = np.concatenate([np.zeros((1, 3)), np.cumsum(signals, axis=0)])
    means = (summed[starts + warm_up + ahead] - summed[starts + warm_up]) / ahead
    shares = means / np.maximum(np.quantile(np.abs(signals), CRITERIA.greatest_quantile, axis=0), 1e-6)
    pedal_edges = (*(-edge for edge in reversed(PEDAL_CLASS_EDGES)), *PEDAL_CLASS_EDGES)
    edges = (SPEED_CLASS_EDGES, pedal_edges, STEER_CLASS_EDGES)
    return np.stack([np.digitize(shares[:, i], edges[i]) for i in range(3)], axis=1)


def spread_evenly(rows: Array, count: int) -> Array:
    """At most `count` of the rows, evenly spread."""
    if len(rows) <= count:
        return rows
    return rows[np.linspace(0, len(rows) - 1, count).astype(int)]
