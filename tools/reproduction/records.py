"""The record of a reproduced figure or table: a JSON file, from which the page is generated."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from tools.measures._summary import rounded

SCHEMA = "tunefree.reproduction/1"
NOT_STATED = "not stated"


class Value(NamedTuple):
    """A number or text of ours beside the paper's.

    low, high: 95 % interval, or the least and the largest of few.
    """

    label: str
    ours: float | str
    unit: str = ""
    paper: str = NOT_STATED
    low: float | None = None
    high: float | None = None


class Claim(NamedTuple):
    """What the paper shows, as a statement that our numbers can contradict."""

    text: str
    is_met: bool


class Method(NamedTuple):
    """How the values were measured.

    bench: Bench files and models.
    n: Number of readings, with their unit ("8 searches").
    seeds: Of searches, trainings or sensor noise.
    """

    bench: str
    n: str
    seeds: str
    text: str


class Record(NamedTuple):
    """One figure or table.

    paper: Caption and content of the paper's, in our words.
    difference: What differs from the paper, and why.
    figures: File names of the pictures, in the folder of pictures.
    detail: Plain data behind the values.
    """

    name: str
    title: str
    paper: str
    claim: Claim
    values: tuple[Value, ...]
    method: Method
    difference: str
    figures: tuple[str, ...] = ()
    detail: Mapping[str, Any] = MappingProxyType({})


class Origin(NamedTuple):
    """Where a record comes from. changed_files: Tracked files that differed from the commit."""

    commit: str
    changed_files: int
    is_quick: bool
    seconds: float
    cpus: int


def write_record(folder: Path, record: Record, origin: Origin) -> Path:
    """Write a record to `<folder>/<name>.json`, whole or not at all."""
    data = {
        "schema": SCHEMA,
        **record._asdict(),
        "detail": dict(record.detail),
        "claim": record.claim._asdict(),
        "values": [value._asdict() for value in record.values],
        "method": record.method._asdict(),
        "origin": origin._asdict(),
    }
    path = folder / f"{record.name}.json"
    folder.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(rounded(data), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    os.replace(part, path)
    return path


class StoredRecord(NamedTuple):
    """A record as it was read."""

    record: Record
    origin: Origin


def read_record(path: Path) -> StoredRecord:
    """The inverse of `write_record`."""
    data = json.loads(path.read_text(encoding="utf-8"))
    data.pop("schema")
    origin = Origin(**data.pop("origin"))
    data["claim"] = Claim(**data["claim"])
    data["values"] = tuple(Value(**value) for value in data["values"])
    data["method"] = Method(**data["method"])
    data["figures"] = tuple(data["figures"])
    return StoredRecord(Record(**data), origin)
