"""Which of what recalibration moved pays: on free runs over the blocks that choose, never over those that prove.

A search moves all nuisances together (gap/estimation/nuisance.py), link by link and told the motion. What that buys there may cost
elsewhere, in a signal that has nothing to do with what was found; so the groups of nuisances - along the car, across
it, its sensors - are left out in turn, and one that does not pay stays as it was. Effects found are never left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from tunefree_hil.base.contracts import Port
from tunefree_hil.config.schema import EffectSpec, ModelSpec, VehicleSpec
from tunefree_hil.gap.estimation.nuisance import BY_KEY
from tunefree_hil.gap.measured.blocks import CHOICE
from tunefree_hil.gap.measured.chain import Opened
from tunefree_hil.gap.model.graph import LINKAGE, effects
from tunefree_hil.gap.validation.gap_closed import floors_of
from tunefree_hil.gap.validation.holdout import HEADING, POSITION, Proof, Variant, prove
from tunefree_hil.gap.validation.repair import repaired

Array = np.ndarray

ALONG, ACROSS, SENSORS = "along", "across", "sensors"
GROUPS = (ALONG, ACROSS, SENSORS)
STEERS = (Port.STEER_A, Port.STEER_OUT, Port.STEER_B)
# Beside the rows of gap/estimation/nuisance.py that say so: what shows in how the car turns and in what it feels sideways
SIDEWAYS = {"plant.yaw_inertia_kgm2", "plant.front_axle_m", "plant.wheelbase_m", LINKAGE}
# By how much one block's gain differs from another's (logarithms of errors, summed over the signals), and how many
# blocks that counts for beside those that there are: two blocks that happen to agree know no scatter.
SCATTER, WORTH = 0.3, 4
SURE = 0.975
TINY = 1e-30  # square: of a signal without noise


class Paid(NamedTuple):
    """values: keys as gap/model/graph.py takes them, without what did not pay. left: the groups that stay as they were."""

    values: dict[str, float]
    left: tuple[str, ...]


def that_pays(
    model: ModelSpec, vehicle: VehicleSpec, values: Mapping[str, float], found: Sequence[EffectSpec],
    drives: Sequence[Opened],
) -> Paid:  # fmt: skip
    """Values of a fit without the groups of nuisances that do not pay; with all where no block that chooses is whole.

    found: the effects that were found; what belongs to them stays.
    """
    groups = groups_of(values, {one.name for one in found})
    now, left = dict(values), list[str]()
    run = chosen_runs(model, vehicle, now, found, drives) if groups else None
    if run is None or not run.blocks:
        return Paid(now, ())
    floors = floors_of(run, model)
    for group, keys in groups.items():
        without = {key: value for key, value in now.items() if key not in keys}
        other = chosen_runs(model, vehicle, without, found, drives)
        if not pays(gained(run, other, floors)):
            now, run = without, other
            left.append(group)
    return Paid(now, tuple(left))


def groups_of(values: Mapping[str, float], found: set[str]) -> dict[str, set[str]]:
    """Keys of nuisances that were moved and that a model can have, by group, in the order of GROUPS."""
    some: dict[str, set[str]] = {group: set() for group in GROUPS}
    known = effects()
    for key, value in values.items():
        name, _, parameter = key.partition(".")
        neutral = known[name].neutral[parameter] if name in known else 0.0
        if name != "clock" and name not in found and value != neutral:
            some[_group_of(key, known[name].port if name in known else None)].add(key)
    return {group: keys for group, keys in some.items() if keys}


def _group_of(key: str, port: Port | None) -> str:
    if port in (Port.REPORT, Port.INS):
        return SENSORS
    turns = key in SIDEWAYS or (key in BY_KEY and BY_KEY[key].sideways)
    if port in STEERS or key.startswith("actuator.steer.") or turns:
        return ACROSS
    return ALONG


def chosen_runs(
    model: ModelSpec, vehicle: VehicleSpec, values: Mapping[str, float], found: Sequence[EffectSpec],
    drives: Sequence[Opened],
) -> Proof:  # fmt: skip
    """Free runs over the blocks that choose; the one variant is called ''."""
    made = repaired(model, vehicle, values, found)
    return prove({"": Variant(made.model, made.day)}, vehicle, drives, role=CHOICE, brief=True)


def pays(gains: Array) -> bool:
    """Whether gains of blocks are above chance: their mean beyond its doubt of 95 %, by Student's t. These blocks were
    fitted on too, so that what is not clear on them is nothing.
    """
    count = len(gains)
    freedom = WORTH + count - 1
    variance = (WORTH * SCATTER**2 + float(((gains - gains.mean()) ** 2).sum())) / freedom
    return float(gains.mean()) > float(stdtrit(freedom, SURE)) * float(np.sqrt(variance / count))


def gained(one: Proof, other: Proof, floors: Mapping[str, float]) -> Array:
    """By how much the first run is nearer to what was measured, [blocks]: the logarithm of the other's error over its
    own, summed over the signals. An error counts with the floor beside it, so that what lies below that hardly does.
    Heading and position are left out: they are sums of the others.
    """
    total = np.zeros(one.blocks)
    for signal, counts in one.counts.items():
        if signal not in (HEADING, POSITION):
            least = (floors[signal] ** 2 + TINY) * counts
            mine, theirs = (run.squares[""][signal] for run in (one, other))
            rows = counts > 0.0
            total[rows] += 0.5 * np.log((theirs + least)[rows] / (mine + least)[rows])
    return total
