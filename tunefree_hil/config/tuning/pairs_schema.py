"""Schema of a file of pairs ("tunefree.pairs/1"): human drives and the generated drives that they should beat."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from msgspec import field
from msgspec.structs import replace

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.convert import convert, read_toml
from tunefree_hil.config.vehicle_schema import Spec


class PairSpec(Spec, frozen=True, kw_only=True):
    """Runs as `compare` takes them: each scenario that a human and a generated run have in common is a pair."""

    human: str
    generated: list[str]
    group: str = ""  # pairs of a group are held out together; '': those of the same scenario
    kind: Literal["human", "model"] = "human"  # a person, or a driver model


class PairsSpec(Spec, frozen=True, kw_only=True):
    """A file of pairs."""

    schema: Literal["tunefree.pairs/1"]
    pairs: list[PairSpec] = field(default_factory=list)
    path: str = ""


def load_pairs(path: Path) -> PairsSpec:
    """Read a file of pairs. Raises InputError that names file and key."""
    spec = convert(read_toml(path), PairsSpec, path)
    for number, pair in enumerate(spec.pairs):
        if not pair.generated:
            raise InputError(
                "names no run",
                code="no_pairs",
                file=str(path),
                key=f"pairs[{number}].generated",
                hint="give at least one run that drove the same scenario as the human",
            )
    if not spec.pairs:
        raise InputError("has no pair", code="no_pairs", file=str(path), key="pairs", hint="add [[pairs]]")
    return replace(spec, path=str(path))
