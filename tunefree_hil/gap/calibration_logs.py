"""A model's own logs asked: what explains them, what its sensors say throughout, and what it misses of them as usual.

Where the catalogue explains all that a model misses of its own logs, a later search finds that by itself. Where it does
not, the sensors' own numbers (a scale, an offset, a latency: what holds one sensor against another, whatever the car
does) are still told by these logs, and belong to the model; what is missed then is what is usual with it (usual.py).
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Link, links_of
from tunefree_hil.config.schema import EffectSpec, ModelSpec, VehicleSpec
from tunefree_hil.gap.estimation.calibration_priors import OwnNumbers, own_numbers
from tunefree_hil.gap.estimation.evidence import judged
from tunefree_hil.gap.estimation.intervals import across, deviations
from tunefree_hil.gap.estimation.residuals import Setting
from tunefree_hil.gap.measured.chain import Opened
from tunefree_hil.gap.measured.observability import lost_links
from tunefree_hil.gap.model.graph import effects
from tunefree_hil.gap.pipeline import Named
from tunefree_hil.gap.selection.baseline_misfit import KINDS, NOTHING, Usual, by_name
from tunefree_hil.gap.selection.criteria import MOST_WORSE, PLAIN_NATS, Weighed
from tunefree_hil.gap.selection.search import looked_at, weighed
from tunefree_hil.gap.workers.pool import Team
from tunefree_hil.gap.workers.worker import Modelled, Question
from tunefree_hil.learn.estimate import NORMAL_95
from tunefree_hil.learn.model_folder import OWN_LOGS

Array = np.ndarray

SENSING = (Link.WHEEL_VS_INS, Link.YAW_VS_INS, Link.ACCEL_VS_DVDT, Link.CLOCK)
OF_THE_CAR = ("power_limit",)  # what a car just has, and none of the plant's constants stands for
OF_TYRES = ("tyre_relaxation",)  # what any tyre has, and no plant of ours by itself
MOST_SENSORS = 6
UNTOLD = (4.0 * np.pi) ** -0.5  # deviation in u from which on logs say less of a parameter than its flat prior does


class OwnLogs(NamedTuple):
    """A question about a model's own logs."""

    model: ModelSpec
    vehicle: VehicleSpec
    drives: Sequence[Opened]
    workers: int = 2


def explained(found: Named) -> Usual:
    """Of a search that leaves nothing broken: what explains the own logs, and what they are missed by without it."""
    there = by_name(across(found.repaired.fitted, judged(found.question.blocks)))
    return NOTHING._replace(own=there, own_missed={one.signal: one.amount for one in found.looked if one.broken})


def limits_named(found: Named, model: ModelSpec) -> list[EffectSpec]:
    """Those of OF_THE_CAR that a search of the own logs plainly names, and the model does not have: a later log is not
    to be told that they are missing. A lower one that comes later shows all the same: of two limits the lower counts.
    """
    plain = {one.name for one in found.effects if one.evidence > PLAIN_NATS and not one.faint}
    values = by_name(across(found.repaired.fitted, judged(found.question.blocks)))
    return [_of_own_logs(name, values[name]) for name in _not_in(model, OF_THE_CAR) if name in plain]


def limits(asked: OwnLogs) -> Generator[str, None, list[EffectSpec]]:
    """The same of own logs in which nothing is broken, each limit by itself: a later log may be one at it from end to
    end.
    """
    yield "limits of the car"
    return _plainly_held(asked, OF_THE_CAR)


def tyres(asked: OwnLogs) -> Generator[str, None, list[EffectSpec]]:
    """Of a model that misses its own logs: those of OF_TYRES that they plainly hold where it comes near them. Of each
    later log they would explain as much, and stand before whatever came later.
    """
    yield "its tyres"
    return _plainly_held(asked, OF_TYRES, unbroken=True)


def _plainly_held(asked: OwnLogs, wanted: Sequence[str], *, unbroken: bool = False) -> list[EffectSpec]:
    """Those of some effects that the own logs plainly hold, each by itself, and the model does not have. unbroken: only
    those that show best where the model comes near its logs.
    """
    team = Team(Setting(asked.model, asked.vehicle, tuple(asked.drives)), workers=1)
    try:
        question = team.open()
        blocks, missing = judged(question.blocks), _not_in(asked.model, wanted)
        if unbroken:
            _, looked = looked_at(team, question, question.null, blocks)
            question = question._replace(broken=frozenset(one.signal for one in looked if one.broken))
        names = [one.name for one in question.suspects if one.name in missing]
        found = weighed(team, question, names, None, blocks) if names else []
    finally:
        team.close()
    plain = [one for one in found if one.counts and one.evidence > PLAIN_NATS and (one.unbroken or not unbroken)]
    return [_of_own_logs(one.name, by_name(across(one.model.fitted, blocks))[one.name]) for one in plain]


def _not_in(model: ModelSpec, wanted: Sequence[str]) -> list[str]:
    has = {one.name for one in model.effects}
    return [name for name in wanted if name not in has]


def sensors(asked: OwnLogs) -> Generator[str, None, list[EffectSpec]]:
    """What ails the sensors, whatever else is missed: one after the other, each beside those before it, as long as
    there is plain evidence; whether all blocks say so is not asked, as none of them is explained. Where there is no
    second sensor to hold one against, it would be held against the car's model, which is wrong: nobody is asked.
    """
    yield "its sensors"
    team = Team(Setting(asked.model, asked.vehicle, tuple(asked.drives)), asked.workers)
    try:
        question = team.open()
        told = set(SENSING) - set(lost_links(asked.drives))
        names = [one.name for one in question.suspects if links_of(effects()[one.name])[0] in told]
        blocks, model = judged(question.blocks), None
        for _ in range(MOST_SENSORS):
            yield f"its sensors, {len(names)} of them"
            some = [one for one in weighed(team, question, names, model, blocks) if _is_plain(one)]
            best = max(some, key=lambda one: one.evidence, default=None)
            if best is None:
                break
            model, names = best.model, [name for name in names if name != best.name]
    finally:
        team.close()
    values = by_name({} if model is None else across(model.fitted, blocks))
    return [_of_own_logs(name, by) for name, by in sorted(values.items())]  # as the graph has them in series


def _of_own_logs(name: str, params: Mapping[str, tuple[float, float]]) -> EffectSpec:
    """The entry of [[effects]]. params: value and deviation."""
    return EffectSpec(
        name=name,
        params={key: value for key, (value, _) in params.items()},
        interval={key: [value - NORMAL_95 * by, value + NORMAL_95 * by] for key, (value, by) in params.items()},
        provenance={"by": OWN_LOGS},
    )


def _is_plain(one: Weighed) -> bool:
    """Whether a sensor is plainly off, and no other signal the worse for it."""
    return one.matters and min(one.evidence, one.gain.total) > PLAIN_NATS and one.worst_missed < MOST_WORSE


def usual(asked: OwnLogs) -> Generator[str, None, Usual]:
    """What is missed, and what each effect would be, alone: all of them, however little they gain. NOTHING where the
    sensors explained what was missed.
    """
    yield "what is left"
    team = Team(Setting(asked.model, asked.vehicle, tuple(asked.drives)), asked.workers, thorough=True)
    try:
        question = team.open()
        blocks = judged(question.blocks)
        _, looked = looked_at(team, question, question.null, blocks)
        broken = frozenset(one.signal for one in looked if one.broken)
        if not broken:
            return NOTHING
        yield f"{len(question.suspects)} suspects, each alone"
        found = team.fit([one.name for one in question.suspects], None)
    finally:
        team.close()
    values: dict[str, dict[str, tuple[float, float]]] = {}
    for name, one in found.items():
        values |= by_name(known_of(name, one, blocks))
    kinds = {key: {one.signal: getattr(one, key) for one in looked} for key in KINDS}
    return Usual({one.signal: one.amount for one in looked}, values, broken, **kinds)


def numbers_of(question: Question) -> OwnNumbers:
    """Where own logs put what recalibration may move, by a question about them."""
    return own_numbers(question.null.fitted, question.drifting, judged(question.blocks))


def known_of(name: str, model: Modelled, blocks: Array) -> dict[str, tuple[float, float]]:
    """What the own logs make of an effect, by key, as far as they tell it. A limit of which they tell nothing lies
    beyond all that they reached: one that is lower later came later, however little is known of the first.
    """
    found, neutral = across(model.fitted, blocks), effects()[name].neutral
    keys, by = list(model.fitted.keys), deviations(model.fitted, blocks)
    told = {key for key in found if by[keys.index(key)] < UNTOLD}
    limits = {key for key in found if not np.isfinite(neutral[key.partition(".")[2]])}
    endless = {key: (value, 0.0) for key, (value, _) in found.items() if key in limits - told}
    return {key: known for key, known in found.items() if key in told} | endless
