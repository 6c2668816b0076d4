"""The absolute test: what anything could explain is found, and noise is not explained."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.leftover import Left, left_of
from tunefree_hil.gap.locate import look
from tunefree_hil.gap.work import Kind

N, BLOCKS = 4000, 20


def made(share: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    chance = np.random.default_rng(seed)
    columns = chance.standard_normal((N, 30))
    residual = share * columns[:, 4] + chance.standard_normal(N)
    return columns, residual, np.ones(N, dtype=bool), np.arange(N) * BLOCKS // N


@pytest.mark.parametrize("share", [0.0, 0.5, 2.0])
def test_what_could_be_explained_is_measured_on_blocks_not_fitted_on(share: float) -> None:
    left = left_of(*made(share), np.arange(BLOCKS))
    assert left.explained == pytest.approx(share**2, abs=0.05 + 0.05 * share**2)
    assert left.total == pytest.approx(1.0 + share**2, rel=0.1)


def test_too_few_rows_say_nothing() -> None:
    columns, residual, valid, block = made(2.0)
    assert left_of(columns[:40], residual[:40], valid[:40], block[:40], np.arange(BLOCKS)) == Left(0.0, 0.0)


def test_a_link_is_broken_where_more_is_left_than_a_calibrated_model_may_miss() -> None:
    kinds = {name: Kind(name, Link.REPORT_TO_MOTION, "m/s2", 0.05, 0.0) for name in ("much", "little", "noisy")}
    left = {"much": Left(0.02, 0.01), "little": Left(0.0002, 0.0001), "noisy": Left(1.0, 0.004)}
    found = look(left, kinds, dict.fromkeys(kinds, 1.0))
    assert found[0].signal == "much" and {one.signal: one.broken for one in found} == {
        "much": True, "little": False, "noisy": False,
    }  # fmt: skip
