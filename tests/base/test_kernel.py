"""Kernels as they are compiled: an inlined one has no code of its own in its callers."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.base.test_kernel_cache import run
from tunefree_hil.base.kernel import inlined, kernel

MODULE = """
from tunefree_hil.base.kernel import inlined, kernel

@kernel
def scaled(x):
    return 2.0 * x

part = inlined(scaled)

@kernel
def total(x):
    return part(x) + scaled(x)

def is_always_inlined(one):
    [text] = one.inspect_llvm().values()
    return "alwaysinline" in text

def main():
    print(total(3.0), is_always_inlined(part), is_always_inlined(scaled))
"""


@pytest.mark.compiled
def test_an_inlined_kernel_is_part_of_its_callers_and_the_kernel_itself_stays_as_it_is(tmp_path: Path) -> None:
    assert run(tmp_path, MODULE) == "12.0 True False"


def test_there_is_nothing_to_inline_in_plain_python() -> None:
    @kernel
    def doubled(x: float) -> float:
        return 2.0 * x

    assert inlined(doubled) is doubled
