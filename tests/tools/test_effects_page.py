"""docs/reference/effects.md says what the code does."""

from __future__ import annotations

import re

import pytest

from tools.make_effects_page import GROUPS, PAGE, page, tables
from tunefree_hil.base.contracts import Port
from tunefree_hil.effects import catalogue


def test_the_page_is_what_the_tool_writes() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert page(text) == text, "run tools/make_effects_page.py"


def test_every_effect_and_parameter_is_in_its_tables() -> None:
    named = re.findall(r"^\| `(\w+)` \|", tables().split("### What a drive")[0], re.MULTILINE)
    assert sorted(named) == sorted([*catalogue(), *catalogue()]), "once with numbers, once in words"
    assert {port for ports in GROUPS.values() for port in ports} == set(Port)
    for effect in catalogue().values():
        assert all(key in tables() for key in effect.neutral)


def test_a_page_without_marks_is_refused() -> None:
    with pytest.raises(ValueError, match="lacks the marks"):
        page("# Effects\n")
