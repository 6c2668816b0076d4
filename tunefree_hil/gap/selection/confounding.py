"""What a calibration had put down to the wrong cause, and takes back once the right one is named.

A model that is made of drives across a banked road has a steering offset for it. The bank, once it is named, does not
show alone, as the model steers against it already; and the offset that goes is nothing that the model lacks.

A hill that was there when a model was made, and an accelerometer that was off: a later log tells them apart or not.

A model that is made of drives up the same hill has it in its rolling resistance, and what the accelerometer says of the
hill is then an offset to all appearance. Only that the rolling resistance would be no tyre's speaks for one of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tunefree_hil.base.units import G_MPS2
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.gap.estimation.intervals import across
from tunefree_hil.gap.estimation.least_squares import Fitted
from tunefree_hil.gap.estimation.nuisance import RECALIBRATED, UNWRITTEN
from tunefree_hil.gap.model.graph import effects
from tunefree_hil.gap.selection.baseline_misfit import NEWS, Usual
from tunefree_hil.gap.selection.criteria import Weighed
from tunefree_hil.plant.data_sheet import DEFAULTS

Array = np.ndarray

FROM_GAP = "log"  # in the provenance of an effect that `gap` named: that was evidence, and a calibration's guess is not
NEARLY = 3.0  # deviations, from which on something else than nothing is left of it
NEAR = 0.1  # of what goes: the first effect's form is not quite the car's, and so much it may leave or take too much


def taken_back(
    steps: Sequence[Weighed], first: Sequence[Weighed], found: Fitted, model: ModelSpec, blocks: Array
) -> tuple[list[Weighed], tuple[str, ...]]:
    """(steps that are missing, in words which are none): of several, whoever takes away what the model has of the very
    same effect by its calibration, so that nothing is left of it, and would be no name alone. first: every suspect by
    itself; found: the model with all steps.
    """
    has, alone = _by_calibration(model), {one.name: one.counts for one in first}
    values = across(found, blocks)
    gone = [
        one
        for one in steps
        if one.name in has
        and not one.others
        and not alone.get(one.name)
        and _is_undone(one.name, has[one.name], values)
    ]
    if not gone or len(gone) == len(steps):
        return list(steps), ()
    stay = [one for one in steps if one not in gone]
    by = " and ".join(one.name for one in stay)
    words = (f"{one.name} of the model goes: its calibration had it for {by}" for one in gone)
    return stay, tuple(words)


def _by_calibration(model: ModelSpec) -> dict[str, list[Mapping[str, float]]]:
    """Parameters of the effects that a model has by its calibration, by effect."""
    found: dict[str, list[Mapping[str, float]]] = {}
    for one in model.effects:
        of_own_logs = one.provenance == RECALIBRATED and one.name in UNWRITTEN  # repair.moved: it is in no folder
        if FROM_GAP not in one.provenance and not of_own_logs:
            found.setdefault(one.name, []).append(one.params)
    return found


def _is_undone(
    name: str, has: Sequence[Mapping[str, float]], values: Mapping[str, tuple[float, float]]
) -> bool:  # fmt: skip
    """Whether the model's effects and the one that was found are none together, and each by itself is one."""
    for parameter, neutral in effects()[name].neutral.items():
        if neutral not in (0.0, 1.0):  # of limits the lower one counts, and no other takes it back
            return False
        value, by = values[f"{name}.{parameter}"]
        was = sum(one[parameter] for one in has) if neutral == 0.0 else math.prod(one[parameter] for one in has)
        off = value + was if neutral == 0.0 else value * was - 1.0
        size = abs(was - neutral)
        if size <= NEARLY * by or abs(off) > max(NEARLY * by, NEAR * size):
            return False
    return True


HILL, OFFSET, BIAS, ROLLING = "grade", "accel_bias", "bias_mps2", "rolling_frac"
WITH_ROLLING = ("physics", "hybrid")  # kinds of plant that have it, whether or not their file says so
DOUBT = 0.35  # standard deviation of the logarithm of a rolling resistance: tyres and roads of one kind of car
LEAST_NATS = 2.0  # by which it tells a hill in it from none
AS_MUCH = 0.1  # of an offset: by so much it may differ from one log to the next, and be the same hill


def with_hill(steps: Sequence[Weighed], found: Fitted, usual: Usual, model: ModelSpec) -> list[Weighed]:
    """Steps; an accelerometer's offset that the model's own logs had as well has a hill for a rival, unless the model's
    rolling resistance says that there was none. found: the model with all of them.
    """
    return [
        step._replace(others=(*step.others, HILL))
        if step.name == OFFSET and HILL not in step.others and _was_there(found, usual) and may_be_hill(found, model)
        else step
        for step in steps
    ]


def _was_there(found: Fitted, usual: Usual) -> bool:
    """Whether the own logs had the same offset."""
    known = usual.own.get(OFFSET) or usual.effects.get(OFFSET) or {}
    was, by = known.get(BIAS, (math.nan, 0.0))
    bias = found.values[f"{OFFSET}.{BIAS}"]
    return abs(bias - was) <= max(NEWS * by, AS_MUCH * abs(bias))


def may_be_hill(found: Fitted, model: ModelSpec) -> bool:
    """Whether a hill as steep as the offset makes believe may stand in the model's rolling resistance; in a net that
    has none any hill may.
    """
    ordinary = DEFAULTS[ROLLING]
    if model.plant.kind not in WITH_ROLLING and ROLLING not in model.plant.params:
        return True
    rolling = model.plant.params.get(ROLLING, ordinary)
    level = rolling - found.values[f"{OFFSET}.{BIAS}"] / G_MPS2
    if rolling <= 0.0 or level <= 0.0:
        return False
    off, off_level = (math.log(one / ordinary) / DOUBT for one in (rolling, level))
    return 0.5 * (off_level**2 - off**2) < LEAST_NATS
