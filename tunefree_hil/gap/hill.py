"""A hill that was there when a model was made, and an accelerometer that was off: a later log tells them apart or not.

A model that is made of drives up the same hill has it in its rolling resistance, and what the accelerometer says of the
hill is then an offset to all appearance. Only that the rolling resistance would be no tyre's speaks for one of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from tunefree_hil.base.units import G_MPS2
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.gap.decide import Weighed
from tunefree_hil.gap.problem import Fitted
from tunefree_hil.gap.usual import NEWS, Usual
from tunefree_hil.plant.data_sheet import DEFAULTS

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
