"""What a search came to, as it is kept between sessions: the answer, both models' values, and how it looked.

Repair, proof, page and pictures are made of this and the logs alone, so that a run that was cut off after the search
goes on without it, and comes to the same numbers: floats survive JSON bit for bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.gap.ask import Modelled
from tunefree_hil.gap.name import Named
from tunefree_hil.gap.regions import Region
from tunefree_hil.gap.result import as_data
from tunefree_hil.gap.shape import Shape
from tunefree_hil.learn.write_model import plain

SCHEMA = "tunefree.gap_search/3"


class Kept(NamedTuple):
    """answer: as in gap.json (result.py); null, repaired: values by key as gap/graph.py takes them, of recalibration
    alone and with the effects. free: the keys that belong to effects found. regions, shape: of the target that shows it
    best, `signal` ('' where nothing is broken and nobody was found). seconds: that the search took. named: whether
    names were looked for. foretold: by target, of what the model with the effects still misses, the share that
    something foretells.
    """

    answer: dict[str, Any]
    null: dict[str, float]
    repaired: dict[str, float]
    free: tuple[str, ...]
    signal: str
    regions: tuple[Region, ...]
    shape: Shape | None
    seconds: float
    named: bool = True
    foretold: dict[str, float] = {}  # noqa: RUF012 - never mutated

    @property
    def verdict(self) -> str | None:
        """One of gap/name.py's VERDICTS; None where nobody was to be named."""
        return self.answer["verdict"]

    @property
    def names(self) -> list[str]:
        """Of the effects that were found."""
        return [one["name"] for one in self.answer["effects"]]


def keep(found: Named, kind: str, seconds: float, named: bool = True) -> Kept:
    """Of a search's result. kind: of the model's plant; named: whether names were looked for."""
    card, answer = found.card, as_data(found, kind)
    if answer["verdict"] == "none_missing" and not any(one["enough"] for one in answer["excitation"].values()):
        answer |= {"verdict": "cannot_test", "absorbed": False, "words": [_lacking(answer)]}  # nothing could be seen
    return Kept(
        answer, _values(found.question.null), _values(found.repaired),
        tuple(one.key for one in found.repaired.fitted.free), "" if card is None else card.looked.signal,
        () if card is None else card.regions, None if card is None else card.shape, seconds, named,
        {name: min(max(one.explained / one.total, 0.0), 1.0) for name, one in found.after.items() if one.total > 0.0},
    )  # fmt: skip


def as_json(kept: Kept) -> dict[str, Any]:
    """Plain data."""
    return {"schema": SCHEMA, **plain(kept._asdict())}


def from_json(data: Mapping[str, Any]) -> Kept:
    """The same again. Raises ValueError for what no `as_json` wrote, by this version."""
    if data.get("schema") != SCHEMA:
        raise ValueError(f"schema is {data.get('schema')!r}, expected {SCHEMA!r}")
    try:
        fields = {name: data[name] for name in Kept._fields}
        shape = fields["shape"]
        return Kept(**fields)._replace(
            free=tuple(fields["free"]),
            regions=tuple(Region(**one) for one in fields["regions"]),
            shape=None if shape is None else Shape(**shape),
        )
    except (KeyError, TypeError) as error:
        raise ValueError(f"no whole search: {error}") from error


def _values(model: Modelled) -> dict[str, float]:
    return {key: float(value) for key, value in model.fitted.values.items()}


def _lacking(answer: Mapping[str, Any]) -> str:
    """What to record, where no effect could have been seen."""
    lacks = sorted({words for one in answer["excitation"].values() for words in one["lacks"]})
    return f"no effect of the catalogue could have shown itself; record a drive with more: {'; '.join(lacks)}"
