"""From the two nets to the table that the controller looks up: monotone in the command, gaps marked, inverted.

On a grid over the region of the data the nets' accelerations are projected onto rows that never fall as the command
goes from full brake over both pedals at rest to full throttle (isotonic regression, pool adjacent violators). Each row
is then a list of (acceleration, command) points that both ascend strictly, so it can be read backwards, as the
controller does. Where a pedal does nothing, the command that is kept is the last one next to rest, elsewhere the first.

The net of eq. 1, to be evaluated without torch: two inputs, one hidden layer of sigmoids, one linear output.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import isotonic_regression

from tunefree_hil.base.open_loop_map import KEYS
from tunefree_hil.control.calibration_map import CalibrationMap
from tunefree_hil.learn.open_loop_map.cells import Edges, Law
from tunefree_hil.learn.open_loop_map.samples import BRAKE, PEDALS, SIGN, THROTTLE

Array = np.ndarray

BACKED, GAP, BEYOND = 1.0, 0.5, 0.0  # support: data here, data on both sides of the command, neither
WEIGHTS = {BACKED: 1.0, GAP: 0.1, BEYOND: 0.02}  # of a node in the projection
IDLE_MPS2 = 0.02  # from coasting, within which a pedal does nothing
LEAST_STEP_MPS2 = 0.005  # points closer than this say the same


class MapGrid(NamedTuple):
    """Rows of speed, columns of signed command (brake negative), ascending; both pedals at rest is one column.

    rest: its place among the columns, where command_frac holds 0. Accelerations and support: [rows, columns].
    """

    speed_mps: Array
    command_frac: Array
    rest: int
    rest_frac: float
    accel_mps2: Array
    support: Array


class MapTable(NamedTuple):
    """The triples of `calibration.npz` and the support of each, by speed and then by acceleration."""

    speed_mps: Array
    accel_mps2: Array
    command_frac: Array
    support: Array


def grid_of(
    laws: Mapping[str, Law], there: Mapping[str, Array], edges: Mapping[str, Edges], ranges: Mapping[str, Array]
) -> MapGrid:
    """Nodes on the edges of the cells, as far as there are data.

    there: by pedal, bool [speed cells, command cells] (map_cells.populated). ranges: by pedal, (least, most)
    acceleration seen: a net promises no more.
    """
    rows = np.flatnonzero(there[THROTTLE].any(axis=1) | there[BRAKE].any(axis=1))
    first, last = int(rows[0]), int(rows[-1]) + 1
    speeds = edges[THROTTLE].speed_mps[first : last + 1]
    parts = {pedal: _side(laws[pedal], there[pedal], edges[pedal], ranges[pedal], first, last) for pedal in PEDALS}
    (push, push_raw, push_backed), (slow, slow_raw, slow_backed) = parts[THROTTLE], parts[BRAKE]
    coast = _coast(push_raw[:, 0], push_backed[:, 0], slow_raw[:, 0], slow_backed[:, 0])
    raw = np.concatenate([slow_raw[:, :0:-1], coast[:, None], push_raw[:, 1:]], axis=1)
    middle = np.maximum(slow_backed[:, :1], push_backed[:, :1])
    backed = np.concatenate([slow_backed[:, :0:-1], middle, push_backed[:, 1:]], axis=1)
    commands = np.concatenate([-slow[:0:-1], [0.0], push[1:]])
    weights = np.vectorize(WEIGHTS.__getitem__)(backed)
    rising = np.stack([isotonic_regression(row, weights=own).x for row, own in zip(raw, weights, strict=True)])
    return MapGrid(speeds, commands, len(slow) - 1, float(push[0]), rising, backed)


def _side(law: Law, there: Array, edges: Edges, seen: Array, first: int, last: int) -> tuple[Array, Array, Array]:
    """(duties from rest on, accelerations [speeds, duties], support) of one pedal."""
    used = np.flatnonzero(there.any(axis=0))
    most = int(used[-1]) + 1  # the edge behind the last column with data
    rest = 0.5 * (edges.command_frac[0] + edges.command_frac[1])
    duties = np.concatenate([[rest], edges.command_frac[2 : max(most, 2) + 1]])
    speeds = edges.speed_mps[first : last + 1]
    accels = law(*np.meshgrid(speeds, duties, indexing="ij"))
    return duties, np.clip(accels, seen[0], seen[1]), _support(there, first, last, max(most, 2))


def _support(there: Array, first: int, last: int, most: int) -> Array:
    """[speed nodes, rest and command nodes]: of a node the cells around it; between backed ones in its row a gap."""
    padded = np.pad(there, ((1, 1), (0, 1)))
    by_speed = padded[first : last + 1] | padded[first + 1 : last + 2]  # either cell beside each speed node
    nodes = [by_speed[:, 0]] + [by_speed[:, j - 1] | by_speed[:, j] for j in range(2, most + 1)]
    backed = np.stack(nodes, axis=1)
    after = np.maximum.accumulate(backed[:, ::-1], axis=1)[:, ::-1]
    before = np.maximum.accumulate(backed, axis=1)
    return np.where(backed, BACKED, np.where(before & after, GAP, BEYOND))


def _coast(push: Array, push_support: Array, slow: Array, slow_support: Array) -> Array:
    """Both pedals at rest, as both nets have it: the mean, of one alone where only that one has data."""
    one = np.where(push_support >= slow_support, 1.0, 0.0)
    two = np.where(slow_support >= push_support, 1.0, 0.0)
    return (one * push + two * slow) / (one + two)


def table_of(grid: MapGrid) -> MapTable:
    """The grid read backwards."""
    rows: list[tuple[float, float, float, float]] = []
    for speed, accels, support in zip(grid.speed_mps, grid.accel_mps2, grid.support, strict=True):
        points = inverted(accels, grid.command_frac, support, grid.rest, grid.rest_frac)
        rows += [(float(speed), *point) for point in points]
    return MapTable(*np.array(rows).T)


def inverted(
    accels: Array, commands: Array, support: Array, rest: int, rest_frac: float
) -> list[tuple[float, float, float]]:
    """(acceleration, command, support) of one row, both ascending strictly; accels must not fall.

    Coasting stands in it twice, a hair apart: with the last command of the brake that does nothing and the last of the
    throttle, so that neither dead band is interpolated away.
    """
    coast = float(accels[rest])
    duties = np.where(np.arange(len(commands)) == rest, rest_frac, commands)
    push = _biting(accels[rest:], duties[rest:], support[rest:], 1.0)
    brakes = np.concatenate([[-rest_frac], commands[:rest][::-1]])
    slow = _biting(accels[rest::-1], brakes, support[rest::-1], -1.0)
    slow[0] = (coast - 0.5 * LEAST_STEP_MPS2, *slow[0][1:])
    if slow[0][1] >= push[0][1]:  # only where rest is duty 0 and neither pedal has a dead band: one point says it
        slow = slow[1:]
    return [*reversed(slow), *push]


def _biting(accels: Array, commands: Array, support: Array, sign: float) -> list[tuple[float, float, float]]:
    """From the last point that does as little as the first, each LEAST_STEP further; of equals the nearest to rest."""
    coast = float(accels[0])
    idle = int(np.flatnonzero(sign * (accels - coast) < IDLE_MPS2)[-1])
    kept = [(coast, float(commands[idle]), float(support[idle]))]
    for accel, command, backed in zip(accels[idle + 1 :], commands[idle + 1 :], support[idle + 1 :], strict=True):
        if sign * (float(accel) - kept[-1][0]) >= LEAST_STEP_MPS2:
            kept.append((float(accel), float(command), float(backed)))
    return kept


def law_of(calibration: CalibrationMap, pedal: str) -> Law:
    """The table read forwards for one pedal: (speed, duty) -> acceleration, linear, held at the ends."""
    speeds = np.asarray(calibration.speed_mps, dtype=np.float64)
    first = np.asarray(calibration.first, dtype=np.int64)
    accels, commands = np.asarray(calibration.at), np.asarray(calibration.value)

    def law(speed_mps: Array, command_frac: Array) -> Array:
        rows = [
            np.interp(SIGN[pedal] * command_frac, commands[low:high], accels[low:high])
            for low, high in itertools.pairwise(first)
        ]
        place = np.interp(speed_mps, speeds, np.arange(len(speeds)))
        below = np.minimum(place.astype(int), max(len(speeds) - 2, 0))
        above = np.minimum(below + 1, len(speeds) - 1)
        share, at = place - below, np.arange(len(place))
        table = np.stack(rows)
        return table[below, at] * (1.0 - share) + table[above, at] * share

    return law


def is_monotone(table: MapTable) -> bool:
    """Whether more acceleration needs more command at every speed, strictly: what a look-up backwards asks for."""
    for speed in np.unique(table.speed_mps):
        row = table.speed_mps == speed
        if np.any(np.diff(table.accel_mps2[row]) <= 0.0) or np.any(np.diff(table.command_frac[row]) <= 0.0):
            return False
    return True


def write_table(path: Path, table: MapTable, card: str) -> None:
    """`calibration.npz` (interfaces 3) with `support` and `card` (JSON) beside its arrays: whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part.npz")
    columns = dict(zip(KEYS, table[:3], strict=True))
    np.savez(part, **columns, support=table.support, card=np.array(card))
    part.replace(path)


class Scale(NamedTuple):
    """(value - middle) / span."""

    middle: float
    span: float

    def into(self, value: Array) -> Array:
        """SI -> about -1 to 1."""
        return (value - self.middle) / self.span

    def out(self, value: Array) -> Array:
        """Back to SI."""
        return value * self.span + self.middle


class PedalNet(NamedTuple):
    """Acceleration from speed and the duty of one pedal; its inputs and its output are scaled. Arrays [width]."""

    speed: Scale
    command: Scale
    accel: Scale
    w_speed: Array
    w_command: Array
    bias: Array
    w_out: Array
    b_out: float

    @property
    def width(self) -> int:
        """Hidden units."""
        return len(self.bias)

    def accel_of(self, speed_mps: Array, command_frac: Array) -> Array:
        """m/s2; the arguments have one shape. a = sum w_out sig(w_command u + w_speed v + bias) + b_out (eq. 1)."""
        v, u = self.speed.into(np.asarray(speed_mps)), self.command.into(np.asarray(command_frac))
        inner = v[..., None] * self.w_speed + u[..., None] * self.w_command + self.bias
        hidden = 0.5 + 0.5 * np.tanh(0.5 * inner)  # the sigmoid, without overflow
        return self.accel.out(hidden @ self.w_out + self.b_out)


def merged(nets: Sequence[PedalNet]) -> PedalNet:
    """The mean of nets with the same scales: one net of eq. 1 again, as wide as all of them together."""
    first, share = nets[0], 1.0 / len(nets)
    w_speed, w_command, bias, w_out = (
        np.concatenate([getattr(net, name) for net in nets]) for name in ("w_speed", "w_command", "bias", "w_out")
    )
    b_out = share * sum(net.b_out for net in nets)
    return first._replace(w_speed=w_speed, w_command=w_command, bias=bias, w_out=share * w_out, b_out=b_out)


def scale_of(values: Array) -> Scale:
    """From -1 to 1 over these values."""
    low, high = float(np.min(values)), float(np.max(values))
    return Scale(0.5 * (low + high), max(0.5 * (high - low), 1e-6))
