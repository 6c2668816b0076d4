"""A model's own logs asked: what explains them, what its sensors say throughout, and what it misses of them as usual.

Where the catalogue explains all that a model misses of its own logs, a later search finds that by itself. Where it does
not, the sensors' own numbers (a scale, an offset, a latency: what holds one sensor against another, whatever the car
does) are still told by these logs, and belong to the model; what is missed then is what is usual with it (usual.py).
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import NamedTuple

from tunefree_hil.base.contracts import Link, links_of
from tunefree_hil.config.schema import EffectSpec, ModelSpec, VehicleSpec
from tunefree_hil.gap.chain import Opened
from tunefree_hil.gap.evidence import LEAST_NATS, judged
from tunefree_hil.gap.graph import effects
from tunefree_hil.gap.interval import across
from tunefree_hil.gap.name import Named, looked_at
from tunefree_hil.gap.search import weighed
from tunefree_hil.gap.team import Team
from tunefree_hil.gap.usual import NOTHING, Usual, by_name
from tunefree_hil.gap.work import Setting

SENSING = (Link.WHEEL_VS_INS, Link.YAW_VS_INS, Link.ACCEL_VS_DVDT, Link.CLOCK)
MOST_SENSORS = 6
NORMAL_95 = 1.96
BY = "the model's own logs"  # provenance


class Asked(NamedTuple):
    """A question about a model's own logs."""

    model: ModelSpec
    vehicle: VehicleSpec
    drives: Sequence[Opened]
    workers: int = 2


def explained(found: Named) -> Usual:
    """Of a search that leaves nothing broken: what explains the own logs."""
    return NOTHING._replace(own=by_name(across(found.repaired.fitted, judged(found.question.blocks))))


def sensors(asked: Asked) -> Generator[str, None, list[EffectSpec]]:
    """What ails the sensors, whatever else is missed: one after the other, each beside those before it, as long as
    there is evidence; whether all blocks say so is not asked, as none of them is explained.
    """
    team = Team(Setting(asked.model, asked.vehicle, tuple(asked.drives)), asked.workers)
    try:
        question = team.open()
        names = [one.name for one in question.suspects if links_of(effects()[one.name])[0] in SENSING]
        blocks, model = judged(question.blocks), None
        for _ in range(MOST_SENSORS):
            yield f"sensors, {len(names)} suspects"
            some = [one for one in weighed(team, question, names, model, blocks) if one.matters]
            best = max(some, key=lambda one: one.evidence, default=None)
            if best is None or best.evidence <= LEAST_NATS or best.gain.total <= LEAST_NATS:
                break
            model, names = best.model, [name for name in names if name != best.name]
    finally:
        team.close()
    values = by_name({} if model is None else across(model.fitted, blocks))
    return [
        EffectSpec(
            name=name,
            params={key: value for key, (value, _) in params.items()},
            interval={key: [value - NORMAL_95 * by, value + NORMAL_95 * by] for key, (value, by) in params.items()},
            provenance={"by": BY},
        )
        for name, params in sorted(values.items())  # as the graph has them in series
    ]


def usual(asked: Asked) -> Generator[str, None, Usual]:
    """What is missed, and what each effect would be, alone: all of them, however little they gain."""
    team = Team(Setting(asked.model, asked.vehicle, tuple(asked.drives)), asked.workers, thorough=True)
    try:
        question = team.open()
        blocks = judged(question.blocks)
        _, looked = looked_at(team, question, question.null, blocks)
        yield f"each of {len(question.suspects)} effects"
        found = team.fit([one.name for one in question.suspects], None)
    finally:
        team.close()
    values: dict[str, dict[str, tuple[float, float]]] = {}
    for one in found.values():
        values |= by_name(across(one.fitted, blocks))
    return Usual({one.signal: one.amount for one in looked}, values)
