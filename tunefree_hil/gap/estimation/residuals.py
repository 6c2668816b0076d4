"""Drives, graph and targets of one question, as the fits take them: parameter values in, residuals by target out.

Lives in a process of learn/compiled_process.py, where the graph is compiled. Residuals of a target are those of all drives, one
behind the other; `Piece`s keep the drives apart where rows are filtered over time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Link
from tunefree_hil.config.schema import ModelSpec, VehicleSpec
from tunefree_hil.gap.estimation.noise import Colour, Piece, colour_of, sensor_noise, whitened
from tunefree_hil.gap.measured.blocks import GUARD, PROOF, Blocks, block_at
from tunefree_hil.gap.measured.chain import Opened
from tunefree_hil.gap.measured.holdout_assignment import dealt
from tunefree_hil.gap.measured.targets import Compared, Target, too_few
from tunefree_hil.gap.model.card import HeldOut, held_out_of
from tunefree_hil.gap.model.graph import CHANNELS, Graph, Values

Array = np.ndarray
Residuals = dict[str, list[Array]]  # by target, a piece a drive

FLOOR_SHARE = 0.3  # of the sensor's own noise: what is left is never believed to be less
LEVELLED, LEAST_OF_LEVEL = "wheel_vs_ins", 0.1  # wheels are off by a share of the speed, however even the drive is
# By target: what a calibration's card says of free runs. Of speed itself it does, of its rate it does not.
BY_FREE_RUN = {"yaw_rate": "yaw_rate_radps", "lateral_accel": "lateral_accel_mps2"}
INS_YAW = "ins.yaw_rate_radps"  # where it is measured it is what is compared
EXACT = 0.002  # of the signal: no model of a car is believed to be better than that at any instant


class Setting(NamedTuple):
    """A question: a model of a vehicle, and drives of that vehicle."""

    model: ModelSpec
    vehicle: VehicleSpec
    drives: tuple[Opened, ...]


class Kind(NamedTuple):
    """What is the same for all drives of a target. floor: of its residuals, in its unit, above 0. missed: what the
    model's own calibration missed of it on drives that it was not fitted on, beyond noise; 0 where nobody says. noise:
    of the sensors, as loud as they are in it; the floor asks only for what of that differs from row to row. by_wheels:
    wheels tell this yaw rate, and a bump in the road moves it as well.
    """

    name: str
    link: Link
    unit: str
    dt_s: float
    floor: float
    missed: float = 0.0
    noise: float = 0.0
    by_wheels: bool = False


class Work:
    """A question made ready. blocks: of all drives; kinds: targets by name."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.dt_s = setting.drives[0].dt_s
        self.graph = Graph(setting.model, setting.vehicle, self.dt_s)
        whole = sum(one.ticks for one in setting.drives)
        self.compared = [Compared(one, one.ticks / whole) for one in setting.drives]
        thin = too_few(self.compared)
        for one in self.compared:
            one.leave_out(thin)
        self.blocks: Blocks = dealt(setting.drives)
        self._where: dict[str, list[tuple[int, int]]] = {}
        for drive, compared in enumerate(self.compared):
            for place, target in enumerate(compared.targets):
                self._where.setdefault(target.name, []).append((drive, place))
        held_out = held_out_of(setting.model)
        self.kinds = {name: self._kind(name, held_out) for name in self._where}
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
        return size_of(self._targets(name), [self.setting.drives[i].inputs.speed_mps for i in self.drives_of(name)])

    def _targets(self, name: str) -> list[Target]:
        """Of all drives that have it."""
        return [self.compared[drive].targets[place] for drive, place in self._where[name]]

    def _kind(self, name: str, held_out: HeldOut) -> Kind:
        kind = kind_of(self._targets(name), missed_of(name, held_out, self._noise_of(BY_FREE_RUN.get(name, ""))))
        return kind._replace(by_wheels=name == "yaw_rate" and self._bumpy(self.drives_of(name)))

    def _bumpy(self, drives: Sequence[int]) -> bool:
        """Whether it is wheels that tell one of these drives' yaw rate."""
        some = [self.setting.drives[drive] for drive in drives]
        return any(one.by_wheels and not one.has(INS_YAW) for one in some)

    def _noise_of(self, signal: str) -> float:
        """Of a sensor, the chassis's or else the INS's, by its fresh values; 0 where there is none."""
        found = [[one.signals[f] for f in (f"report.{signal}", f"ins.{signal}") if f in one.signals][:1]
                 for one in self.setting.drives]  # fmt: skip
        some = [one.noise for drive in found for one in drive]
        return _root_mean(some) if some else 0.0

    def _block(self, drive: int, place: int) -> Array:
        return block_at(self.blocks, drive, self.compared[drive].targets[place].rows)

    def _judged(self, block: Array) -> Array:
        roles = np.append(self.blocks.roles, GUARD)[block]
        return (roles != PROOF) & (roles != GUARD)


def apart(some: Sequence[Array], others: Sequence[Array], seen: Sequence[Array]) -> float:
    """Root mean square of what two models' residuals of a target differ by, over all drives; seen: rows that count."""
    by = np.concatenate([(a - b)[rows] for a, b, rows in zip(some, others, seen, strict=True)])
    return float(np.sqrt(np.mean(by * by))) if len(by) else 0.0


def kind_of(targets: Sequence[Target], missed: float) -> Kind:
    """Of a target, over all drives: each has its own noise, and reports that come as often as they came."""
    rough = [max(sensor_noise(one.measured, one.valid), one.quantum / 12.0**0.5) for one in targets]
    floor = max(FLOOR_SHARE * _root_mean(rough), EXACT * _root_mean([one.size for one in targets]))
    dt_s = float(np.mean([one.dt_s for one in targets]))
    noise = _root_mean([max(one.noise, by) for one, by in zip(targets, rough, strict=True)])
    return Kind(targets[0].name, targets[0].link, targets[0].unit, dt_s, floor, missed, noise)


def size_of(targets: Sequence[Target], speeds: Sequence[Array]) -> float:
    """Deviation of the signal that a target is about, over its drives; of what is off by a share of a level at least
    LEAST_OF_LEVEL of that. speeds: of each drive.
    """
    deviation = _root_mean([one.size for one in targets])
    if targets[0].name != LEVELLED:
        return deviation
    level = [float(np.mean(speed[one.rows][one.valid])) for speed, one in zip(speeds, targets, strict=True)]
    return max(deviation, LEAST_OF_LEVEL * _root_mean(level))


def missed_of(name: str, held_out: HeldOut, noise: float) -> float:
    """What a calibration missed of other drives in the same signal as a target's, less the noise that is in it; 0 where
    it says nothing. noise: of the sensor; of an actuator's report the card has it.
    """
    missed = held_out.motion.get(BY_FREE_RUN.get(name, ""), 0.0)
    if name in CHANNELS:
        missed, noise = held_out.actuators.get(name, (0.0, 0.0))
    return float(max(missed * missed - noise * noise, 0.0)) ** 0.5


def _root_mean(some: Sequence[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(some))))
