"""Residual model of one problem: a model, its vehicle and drives; parameter values in, residuals by target out.

It lives in a worker process (gap/workers/worker.py), where the simulation is compiled. The residuals of a target are a
list of arrays, one for each drive that has the target, so that no filter runs from one drive into the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Link
from tunefree_hil.config.schema import ModelSpec, VehicleSpec
from tunefree_hil.gap.estimation.noise import (
    NoiseModel,
    ResidualPiece,
    estimate_noise_model,
    estimate_white_noise,
    whiten_piece,
)
from tunefree_hil.gap.measured.blocks import GUARD, HOLDOUT, Blocks, find_block_indices
from tunefree_hil.gap.measured.chain import MeasuredDrive
from tunefree_hil.gap.measured.holdout_assignment import assign_holdout_blocks
from tunefree_hil.gap.measured.targets import DriveComparison, Target, find_sparse_targets
from tunefree_hil.gap.model.card import HoldoutErrors, read_holdout_errors
from tunefree_hil.gap.model.graph import CHANNELS, EffectGraph, Values

Array = np.ndarray
Residuals = dict[str, list[Array]]  # by target, one array a drive

WHEEL_SPEED_TARGET = "wheel_vs_ins"
# Target: the entry of a calibration's card with the error of free runs. The card has speed, not its rate.
FREE_RUN_ENTRY = {"yaw_rate": "yaw_rate_radps", "lateral_accel": "lateral_accel_mps2"}
INS_YAW_RATE = "ins.yaw_rate_radps"
NON_FINITE_RESIDUAL = 1e6  # stands for a simulation that diverged


class NoiseFloorCriteria(NamedTuple):
    """Smallest noise that a residual is taken to have (docs/results/criteria.md)."""

    min_sensor_share: float = 0.3  # of the sensor's own white noise
    min_signal_share: float = 0.002  # of the signal's RMS: no model of a car is more exact than that at every instant
    # smallest scale of a wheel speed error, of the speed: wheels are off by a share of it, however steady the drive
    min_level_share: float = 0.1


CRITERIA = NoiseFloorCriteria()


class ProblemSpec(NamedTuple):
    """A model of a vehicle, and drives of that vehicle."""

    model: ModelSpec
    vehicle: VehicleSpec
    drives: tuple[MeasuredDrive, ...]


class TargetProperties(NamedTuple):
    """Properties of a target over all drives.

    Args:
        name: of the target
        link: the link of the measured chain that it belongs to
        unit: of its residuals, and of the fields below
        dt_s: time between its rows
        floor: smallest noise of its residuals, above 0 (`NoiseFloorCriteria`)
        calibration_misfit: error of the model's own calibration on drives that it was not fitted on, beyond noise; 0
            where the card does not tell
        noise: of the sensors; slowly varying noise is in it, but not in `floor`
        is_yaw_from_wheels: the yaw rate is computed from wheel speeds, which a bump in the road disturbs
    """

    name: str
    link: Link
    unit: str
    dt_s: float
    floor: float
    calibration_misfit: float = 0.0
    noise: float = 0.0
    is_yaw_from_wheels: bool = False


class ResidualModel:
    """Simulates a problem's drives and compares them with the measurements.

    Attributes:
        comparisons: targets of each drive
        blocks: blocks of all drives, with their roles
        target_properties: by target
        target_blocks: by target, the block number of each of its rows, one array a drive
    """

    def __init__(self, spec: ProblemSpec) -> None:
        self.spec = spec
        self.dt_s = spec.drives[0].dt_s
        self.graph = EffectGraph(spec.model, spec.vehicle, self.dt_s)
        total_ticks = sum(drive.ticks for drive in spec.drives)
        self.comparisons = [DriveComparison(drive, drive.ticks / total_ticks) for drive in spec.drives]
        sparse_targets = find_sparse_targets(self.comparisons)
        for comparison in self.comparisons:
            comparison.drop_targets(sparse_targets)
        self.blocks: Blocks = assign_holdout_blocks(spec.drives)
        self._places: dict[str, list[tuple[int, int]]] = {}  # by target: (drive, index among its targets)
        for drive, comparison in enumerate(self.comparisons):
            for index, target in enumerate(comparison.targets):
                self._places.setdefault(target.name, []).append((drive, index))
        errors = read_holdout_errors(spec.model)
        self.target_properties = {name: self._pool_properties(name, errors) for name in self._places}
        self.target_blocks = {name: [self._block_numbers(*p) for p in places] for name, places in self._places.items()}
        self._non_holdout = {
            name: [self._is_non_holdout(numbers) for numbers in drives] for name, drives in self.target_blocks.items()
        }

    def simulate_residuals(self, values: Values) -> Residuals:
        """Simulated minus measured, by target."""
        residuals: Residuals = {name: [] for name in self._places}
        for comparison, drive in zip(self.comparisons, self.spec.drives, strict=True):
            differences = comparison.residuals(self.graph.simulate(drive.inputs, values))
            for target, difference in zip(comparison.targets, differences, strict=True):
                limit = NON_FINITE_RESIDUAL
                residuals[target.name].append(np.nan_to_num(difference, nan=limit, posinf=limit, neginf=-limit))
        return residuals

    def valid_rows(self, name: str) -> list[Array]:
        """Which rows of a target count, by drive."""
        return [self.comparisons[drive].targets[index].valid for drive, index in self._places[name]]

    def non_holdout_rows(self, name: str) -> list[Array]:
        """Which valid rows of a target are outside holdout and guard blocks, by drive."""
        pairs = zip(self.valid_rows(name), self._non_holdout[name], strict=True)
        return [is_valid & is_usable for is_valid, is_usable in pairs]

    def measured_values(self, name: str) -> list[Array]:
        """Measured values of a target, by drive."""
        return [self.comparisons[drive].targets[index].measured for drive, index in self._places[name]]

    def drive_rows(self, name: str) -> list[Array]:
        """Rows of each drive at which a target is compared."""
        return [self.comparisons[drive].targets[index].rows for drive, index in self._places[name]]

    def drive_indices(self, name: str) -> list[int]:
        """Drives that have a target."""
        return [drive for drive, _ in self._places[name]]

    def estimate_noise(self, name: str, residual: Sequence[Array]) -> NoiseModel:
        """Noise model of a target's residual, outside holdout blocks."""
        properties = self.target_properties[name]
        pieces = [ResidualPiece(*pair) for pair in zip(residual, self.non_holdout_rows(name), strict=True)]
        return estimate_noise_model(pieces, properties.floor, properties.dt_s)

    def whiten(self, name: str, residual: Sequence[Array], noise: NoiseModel) -> tuple[Array, Array]:
        """Whiten residuals (and columns of a Jacobian beside them) of all drives, in units of the noise.

        Returns: rows outside guard blocks, shape (n_rows,) or (n_rows, n_columns), and their block numbers (n_rows,)
        """
        values, blocks = [], []
        for raw, valid, block in zip(residual, self.valid_rows(name), self.target_blocks[name], strict=True):
            piece = whiten_piece(ResidualPiece(raw, valid), noise.whitening_filter)
            is_used = piece.valid & (block != GUARD)
            values.append(piece.values[is_used] / noise.sigma)
            blocks.append(block[is_used])
        return np.concatenate(values), np.concatenate(blocks)

    def signal_scale(self, name: str) -> float:
        """Standard deviation of the signal of a target, over its drives."""
        speeds = [self.spec.drives[i].inputs.speed_mps for i in self.drive_indices(name)]
        return pool_signal_scale(self._targets(name), speeds)

    def _targets(self, name: str) -> list[Target]:
        return [self.comparisons[drive].targets[index] for drive, index in self._places[name]]

    def _pool_properties(self, name: str, errors: HoldoutErrors) -> TargetProperties:
        misfit = misfit_beyond_noise(name, errors, self._sensor_noise(FREE_RUN_ENTRY.get(name, "")))
        properties = pool_target_properties(self._targets(name), misfit)
        return properties._replace(is_yaw_from_wheels=name == "yaw_rate" and self._is_yaw_from_wheels(name))

    def _is_yaw_from_wheels(self, name: str) -> bool:
        drives = [self.spec.drives[drive] for drive in self.drive_indices(name)]
        return any(drive.has_wheel_yaw_rate and not drive.has_signals(INS_YAW_RATE) for drive in drives)

    def _sensor_noise(self, signal: str) -> float:
        """Noise of the chassis's sensor, or else of the INS, over the drives that have one; 0 without any."""
        noises = []
        for drive in self.spec.drives:
            fields = [field for field in (f"report.{signal}", f"ins.{signal}") if field in drive.signals]
            noises += [drive.signals[field].noise for field in fields[:1]]
        return _root_mean_square(noises) if noises else 0.0

    def _block_numbers(self, drive: int, index: int) -> Array:
        return find_block_indices(self.blocks, drive, self.comparisons[drive].targets[index].rows)

    def _is_non_holdout(self, block_numbers: Array) -> Array:
        roles = np.append(self.blocks.roles, GUARD)[block_numbers]
        return (roles != HOLDOUT) & (roles != GUARD)


def rms_difference(residual: Sequence[Array], reference: Sequence[Array], rows: Sequence[Array]) -> float:
    """RMS difference of two residuals of a target over the given rows of all drives; 0 without rows."""
    difference = np.concatenate([(a - b)[used] for a, b, used in zip(residual, reference, rows, strict=True)])
    return float(np.sqrt(np.mean(difference * difference))) if len(difference) else 0.0


def pool_target_properties(targets: Sequence[Target], calibration_misfit: float) -> TargetProperties:
    """Combine a target's properties over its drives: each has its own noise and rate of reports."""
    rough = [max(estimate_white_noise(target.measured, target.valid), target.quantum / 12.0**0.5) for target in targets]
    sensor_floor = CRITERIA.min_sensor_share * _root_mean_square(rough)
    floor = max(sensor_floor, CRITERIA.min_signal_share * _root_mean_square([target.size for target in targets]))
    dt_s = float(np.mean([target.dt_s for target in targets]))
    noise = _root_mean_square([max(target.noise, white) for target, white in zip(targets, rough, strict=True)])
    first = targets[0]
    return TargetProperties(first.name, first.link, first.unit, dt_s, floor, calibration_misfit, noise)


def pool_signal_scale(targets: Sequence[Target], speeds: Sequence[Array]) -> float:
    """Standard deviation of a target's signal over its drives; of wheel speed errors at least a share of the speed.

    Args:
        targets: of each drive
        speeds: of each drive, m/s, shape (n_ticks,)
    """
    deviation = _root_mean_square([target.size for target in targets])
    if targets[0].name != WHEEL_SPEED_TARGET:
        return deviation
    level = [float(np.mean(speed[target.rows][target.valid])) for speed, target in zip(speeds, targets, strict=True)]
    return max(deviation, CRITERIA.min_level_share * _root_mean_square(level))


def misfit_beyond_noise(name: str, errors: HoldoutErrors, noise: float) -> float:
    """Error of a calibration on held-out drives in a target's signal, without its noise; 0 where the card has none.

    Args:
        name: of the target
        errors: from the model's card
        noise: of the sensor; for an actuator's report that of the card is used
    """
    misfit = errors.motion.get(FREE_RUN_ENTRY.get(name, ""), 0.0)
    if name in CHANNELS:
        misfit, noise = errors.actuators.get(name, (0.0, 0.0))
    return float(max(misfit * misfit - noise * noise, 0.0)) ** 0.5


def _root_mean_square(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
