"""Which of recalibration's updates improve free runs, on the selection blocks; the holdout is not used.

A search moves all nuisances together (gap/estimation/nuisance.py), link by link, from the measured motion. That may
make free runs worse. So each group of updates (along the vehicle, across it, its sensors) is left out in
turn, and one that does not improve the free runs is reverted. Effects that were found are never left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from tunefree_hil.base.contracts import Port
from tunefree_hil.config.schema import EffectSpec, ModelSpec, VehicleSpec
from tunefree_hil.gap.estimation.nuisance import DRIFT_BY_KEY
from tunefree_hil.gap.measured.blocks import SELECTION
from tunefree_hil.gap.measured.chain import MeasuredDrive
from tunefree_hil.gap.model.graph import LINKAGE_BEND_KEY, load_catalogue
from tunefree_hil.gap.validation.block_runs import HEADING, POSITION, BlockErrors, Variant, run_blocks
from tunefree_hil.gap.validation.gap_closed import error_floors
from tunefree_hil.gap.validation.repair import repair_model

Array = np.ndarray

ALONG, ACROSS, SENSORS = "along", "across", "sensors"
GROUPS = (ALONG, ACROSS, SENSORS)
STEER_PORTS = (Port.STEER_A, Port.STEER_OUT, Port.STEER_B)
# Lateral numbers that have no row in gap/estimation/nuisance.py
LATERAL_KEYS = {"plant.yaw_inertia_kgm2", "plant.front_axle_m", "plant.wheelbase_m", LINKAGE_BEND_KEY}
# Prior of the scatter of a block's gain (log errors, summed over signals), and the blocks that it counts for: two
# blocks that agree by chance have no scatter of their own
PRIOR_SCATTER, PRIOR_BLOCKS = 0.3, 4
CONFIDENCE = 0.975  # one-sided: the lower bound of a 95 % interval
MIN_SQUARE = 1e-30  # added to the floor of a signal without noise


class UpdateSelection(NamedTuple):
    """values: keys as gap/model/graph.py takes them, without those of `reverted_groups` (of GROUPS)."""

    values: dict[str, float]
    reverted_groups: tuple[str, ...]


def select_updates(
    model: ModelSpec,
    vehicle: VehicleSpec,
    values: Mapping[str, float],
    effects: Sequence[EffectSpec],
    drives: Sequence[MeasuredDrive],
) -> UpdateSelection:
    """Revert the groups of updates that do not improve free runs; none where no selection block can be run.

    Args:
        values: of a fit, with all updates.
        effects: that were found; their values stay.
    """
    groups = update_groups(values, {effect.name for effect in effects})
    remaining, reverted = dict(values), list[str]()
    run = run_selection_blocks(model, vehicle, remaining, effects, drives) if groups else None
    if run is None or not run.n_blocks:
        return UpdateSelection(remaining, ())
    floors = error_floors(run, model)
    for group, keys in groups.items():
        without = {key: value for key, value in remaining.items() if key not in keys}
        reverted_run = run_selection_blocks(model, vehicle, without, effects, drives)
        if not is_improvement(error_gains(run, reverted_run, floors)):
            remaining, run = without, reverted_run
            reverted.append(group)
    return UpdateSelection(remaining, tuple(reverted))


def update_groups(values: Mapping[str, float], effect_names: set[str]) -> dict[str, set[str]]:
    """Keys that recalibration moved and that a model can have, by group, in the order of GROUPS.

    effect_names: of the effects that were found; their keys are in no group.
    """
    groups: dict[str, set[str]] = {group: set() for group in GROUPS}
    catalogue = load_catalogue()
    for key, value in values.items():
        name, _, parameter = key.partition(".")
        effect = catalogue.get(name)
        neutral = effect.neutral[parameter] if effect else 0.0
        if name != "clock" and name not in effect_names and value != neutral:
            groups[_update_group(key, effect.port if effect else None)].add(key)
    return {group: keys for group, keys in groups.items() if keys}


def _update_group(key: str, port: Port | None) -> str:
    if port in (Port.REPORT, Port.INS):
        return SENSORS
    is_lateral = key in LATERAL_KEYS or (key in DRIFT_BY_KEY and DRIFT_BY_KEY[key].is_lateral)
    if port in STEER_PORTS or key.startswith("actuator.steer.") or is_lateral:
        return ACROSS
    return ALONG


def run_selection_blocks(
    model: ModelSpec,
    vehicle: VehicleSpec,
    values: Mapping[str, float],
    effects: Sequence[EffectSpec],
    drives: Sequence[MeasuredDrive],
) -> BlockErrors:
    """Free runs of one model over the selection blocks; its variant is called ''."""
    made = repair_model(model, vehicle, values, effects)
    return run_blocks({"": Variant(made.model, made.day_effects)}, vehicle, drives, role=SELECTION, skip_forgotten=True)


def is_improvement(gains: Array) -> bool:
    """Whether gains (n_blocks,) are above chance: their mean above its 95 % interval by Student's t.

    These blocks were fitted on as well, so that what is not clear on them does not count.
    """
    count = len(gains)
    freedom = PRIOR_BLOCKS + count - 1
    variance = (PRIOR_BLOCKS * PRIOR_SCATTER**2 + float(((gains - gains.mean()) ** 2).sum())) / freedom
    return float(gains.mean()) > float(stdtrit(freedom, CONFIDENCE)) * float(np.sqrt(variance / count))


def error_gains(run: BlockErrors, reference: BlockErrors, floors: Mapping[str, float]) -> Array:
    """By how much a run is nearer to the measurement than another, (n_blocks,): log of the ratio of their errors,
    summed over the signals without heading and position, which are sums of the others. The floor is added to an error.
    """
    total = np.zeros(run.n_blocks)
    for signal, counts in run.counts.items():
        if signal not in (HEADING, POSITION):
            least = (floors[signal] ** 2 + MIN_SQUARE) * counts
            run_squares, reference_squares = (result.squared_errors[""][signal] for result in (run, reference))
            rows = counts > 0.0
            total[rows] += 0.5 * np.log((reference_squares + least)[rows] / (run_squares + least)[rows])
    return total
