"""Every key of every file is described by `doctor --schema`, and nothing is described that is no key."""

from __future__ import annotations

import pytest
from msgspec.structs import fields

from tunefree_hil.config.convert import SET_BY_LOADER
from tunefree_hil.config.key_meanings import WORDS
from tunefree_hil.config.load import SPECS, json_schema
from tunefree_hil.config.schema import Spec

LONGEST = 110


@pytest.mark.parametrize("kind", SPECS)
def test_no_property_of_a_schema_lacks_its_description(kind: str) -> None:
    for name, definition in json_schema(kind)["$defs"].items():
        for key, one in definition["properties"].items():
            words = one.get("description", "")
            assert words and "\n" not in words and len(words) <= LONGEST, f"{name}.{key}: {words!r}"


def test_nothing_is_described_that_is_no_key() -> None:
    kinds = {kind.__name__: kind for kind in Spec.__subclasses__()}
    tops = set(SPECS.values())
    for name, words in WORDS.items():
        own = {field.name for field in fields(kinds[name])}
        assert set(words) == (own - set(SET_BY_LOADER) if kinds[name] in tops else own), name


def test_no_two_keys_of_a_table_mean_the_same() -> None:
    """A line that was copied and not changed."""
    for name, words in WORDS.items():
        assert len(set(words.values())) == len(words), name
