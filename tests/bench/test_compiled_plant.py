"""A plant that the compiler does not take is named; what is ours keeps the compiler's own words."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace
from numba import njit
from numba.core.errors import NumbaError

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench.compiled_plant import answer_of
from tunefree_hil.config.load import load_model

NOMINAL = load_model("mkz_nominal")
OWN = replace(NOMINAL, plant=replace(NOMINAL.plant, kind="mine.py:PLANT"))


@njit
def words(number: Any) -> Any:
    return number.wings  # a float has none


@njit
def doubled(number: float) -> float:
    return 2.0 * number


def test_a_plant_from_a_file_that_cannot_be_compiled_is_named() -> None:
    with pytest.raises(InputError, match=r"mine\.py:PLANT") as caught:
        answer_of(words, (1.0,), OWN)
    assert caught.value.key == "plant.kind" and caught.value.file.endswith("model.toml") and "bus" in caught.value.hint


def test_a_shipped_kind_keeps_the_compilers_words_and_what_compiles_answers() -> None:
    with pytest.raises(NumbaError):
        answer_of(words, (1.0,), NOMINAL)
    assert answer_of(doubled, (2.0,), OWN) == answer_of(doubled, (2.0,), NOMINAL) == 4.0
