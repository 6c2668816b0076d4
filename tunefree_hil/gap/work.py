"""Drives, graph and targets of one question, as the fits take them: parameter values in, residuals by target out.

Lives in a process of learn/worker.py, where the graph is compiled. Residuals of a target are those of all drives, one
behind the other; `Piece`s keep the drives apart where rows are filtered over time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Link
from tunefree_hil.config.schema import ModelSpec, VehicleSpec
from tunefree_hil.gap.chain import Opened
from tunefree_hil.gap.graph import Graph, Values
from tunefree_hil.gap.noise import Colour, Piece, colour_of, sensor_noise, whitened
from tunefree_hil.gap.segments import GUARD, PROOF, Blocks, block_at, blocks_of
from tunefree_hil.gap.targets import Compared

Array = np.ndarray
Residuals = dict[str, list[Array]]  # by target, a piece a drive

FLOOR_SHARE = 0.3  # of the sensor's own noise: what is left is never believed to be less
EXACT = 0.002  # of the signal: no model of a car is believed to be better than that at any instant


class Setting(NamedTuple):
    """A question: a model of a vehicle, and drives of that vehicle."""

    model: ModelSpec
    vehicle: VehicleSpec
    drives: tuple[Opened, ...]


class Kind(NamedTuple):
    """What is the same for all drives of a target. floor: of its residuals, in its unit, above 0."""

    name: str
    link: Link
    unit: str
    dt_s: float
    floor: float


class Work:
    """A question made ready. blocks: of all drives; kinds: targets by name."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.dt_s = setting.drives[0].dt_s
        self.graph = Graph(setting.model, setting.vehicle, self.dt_s)
        self.compared = [Compared(one) for one in setting.drives]
        self.blocks: Blocks = blocks_of([one.ticks for one in setting.drives], self.dt_s)
        self.kinds: dict[str, Kind] = {}
        self._where: dict[str, list[tuple[int, int]]] = {}
        for drive, compared in enumerate(self.compared):
            for place, target in enumerate(compared.targets):
                self._where.setdefault(target.name, []).append((drive, place))
                noise = max(sensor_noise(target.measured, target.valid), target.quantum / 12.0**0.5)
                floor = max(FLOOR_SHARE * noise, EXACT * target.size)
                self.kinds.setdefault(target.name, Kind(target.name, target.link, target.unit, target.dt_s, floor))
        self.block = {name: [self._block(*one) for one in where] for name, where in self._where.items()}
        self.judged = {name: [self._judged(b) for b in some] for name, some in self.block.items()}

    def residuals(self, values: Values) -> Residuals:
        """Simulated minus measured."""
        found: Residuals = {name: [] for name in self._where}
        for compared, opened in zip(self.compared, self.setting.drives, strict=True):
            some = compared.of(self.graph.run(opened.inputs, values))
            for target, one in zip(compared.targets, some, strict=True):
                found[target.name].append(np.nan_to_num(one, nan=1e6, posinf=1e6, neginf=-1e6))
        return found

    def valid(self, name: str) -> list[Array]:
        """Which rows of a target count at all, a piece a drive."""
        return [self.compared[drive].targets[place].valid for drive, place in self._where[name]]

    def seen(self, name: str) -> list[Array]:
        """Which of them may be looked at before a repair is proved."""
        return [valid & judged for valid, judged in zip(self.valid(name), self.judged[name], strict=True)]

    def measured(self, name: str) -> list[Array]:
        """What was measured of a target."""
        return [self.compared[drive].targets[place].measured for drive, place in self._where[name]]

    def rows(self, name: str) -> list[Array]:
        """The rows of its drive at which a target is compared."""
        return [self.compared[drive].targets[place].rows for drive, place in self._where[name]]

    def drives_of(self, name: str) -> list[int]:
        """The drives that have a target."""
        return [drive for drive, _ in self._where[name]]

    def colour(self, name: str, residual: Sequence[Array]) -> Colour:
        """What a target's noise would be if this were all noise. Proof blocks are not looked at."""
        kind = self.kinds[name]
        pieces = [Piece(one, seen) for one, seen in zip(residual, self.seen(name), strict=True)]
        return colour_of(pieces, kind.floor, kind.dt_s)

    def white(self, name: str, residual: Sequence[Array], colour: Colour) -> tuple[Array, Array]:
        """(whitened rows over sigma [m] or [m, k], their block [m]) of all drives together; guards left out."""
        values, blocks = [], []
        for one, valid, block in zip(residual, self.valid(name), self.block[name], strict=True):
            piece = whitened(Piece(one, valid), colour.filter)
            keep = piece.valid & (block != GUARD)
            values.append(piece.values[keep] / colour.sigma)
            blocks.append(block[keep])
        return np.concatenate(values), np.concatenate(blocks)

    def size(self, name: str) -> float:
        """Deviation of the signal that a target is about, over its drives."""
        some = [self.compared[drive].targets[place].size for drive, place in self._where[name]]
        return float(np.sqrt(np.mean(np.square(some))))

    def _block(self, drive: int, place: int) -> Array:
        return block_at(self.blocks, drive, self.compared[drive].targets[place].rows)

    def _judged(self, block: Array) -> Array:
        roles = np.append(self.blocks.roles, GUARD)[block]
        return (roles != PROOF) & (roles != GUARD)
