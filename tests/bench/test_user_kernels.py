"""Code of the user's that the compiler does not take is named; what is ours keeps the compiler's own words."""

from __future__ import annotations

from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace
from numba import njit
from numba.core.errors import NumbaError

from tests.bench.tiny import write_bench
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load
from tunefree_hil.bench.user_kernels import UserKernel, list_user_kernels, run_kernel
from tunefree_hil.config.load import load_model

NOMINAL = load_model("mkz_nominal")
PLANT = UserKernel("mine.py:PLANT", "model.toml", "plant.kind")


@njit
def words(number: Any) -> Any:
    return number.wings  # a float has none


@njit
def doubled(number: float) -> float:
    return 2.0 * number


def test_what_cannot_be_compiled_is_named() -> None:
    with pytest.raises(InputError, match=r"mine\.py:PLANT") as caught:
        run_kernel(words, (1.0,), [PLANT])
    assert (caught.value.file, caught.value.key) == ("model.toml", "plant.kind") and "bus" in caught.value.hint


def test_what_is_ours_keeps_the_compilers_words_and_what_compiles_answers() -> None:
    with pytest.raises(NumbaError):
        run_kernel(words, (1.0,), [])
    assert run_kernel(doubled, (2.0,), [PLANT]) == run_kernel(doubled, (2.0,), []) == 4.0


def test_the_plant_and_each_part_of_the_controller_may_be_the_users(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path))
    assert list_user_kernels(bench, NOMINAL) == []
    controller = replace(bench.spec.controller, lateral="mine.py:CONTROLLER", inner="mine.py:INNER")
    own = list_user_kernels(
        changed(bench, spec=replace(bench.spec, controller=controller)),
        replace(NOMINAL, plant=replace(NOMINAL.plant, kind="mine.py:PLANT")),
    )
    assert [one.key for one in own] == ["plant.kind", "controller.lateral", "controller.inner"]
    assert own[0].file.endswith("model.toml") and own[1].file == bench.file
