"""The absolute test: what anything could explain is found, and noise is not explained."""

from __future__ import annotations

import numpy as np
import pytest

from tests.gap.made_answer import VEHICLE, late_drive
from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.diagnostics.lack_of_fit import (
    REGRESSION,
    LackOfFit,
    RegressionData,
    _build_data,
    _DriveTarget,
    build_features,
    cross_validate,
    pool_lack_of_fit,
)
from tunefree_hil.gap.diagnostics.residual_tests import assess_links
from tunefree_hil.gap.estimation.residuals import TargetProperties
from tunefree_hil.gap.measured.chain import build_measured_drive
from tunefree_hil.gap.measured.targets import DriveComparison

N, BLOCKS = 4000, 20
OPENED = build_measured_drive(late_drive(40.0), VEHICLE)


def made(share: float, seed: int = 1) -> RegressionData:
    chance = np.random.default_rng(seed)
    columns = chance.standard_normal((N, 30))
    residual = share * columns[:, 4] + chance.standard_normal(N)
    return RegressionData(columns, residual, np.ones(N, dtype=bool), np.arange(N) * BLOCKS // N)


@pytest.mark.parametrize("share", [0.0, 0.5, 2.0])
def test_what_could_be_explained_is_measured_on_blocks_not_fitted_on(share: float) -> None:
    left = cross_validate(made(share), np.arange(BLOCKS))
    assert left.explained == pytest.approx(share**2, abs=0.05 + 0.05 * share**2)
    assert left.total == pytest.approx(1.0 + share**2, rel=0.1)


def test_of_too_few_rows_nothing_is_foretold_and_what_is_missed_is_missed() -> None:
    columns, residual, valid, block = made(2.0)
    few = RegressionData(columns[:40], residual[:40], valid[:40], block[:40])
    left = cross_validate(few, np.arange(BLOCKS))
    assert left == pytest.approx(LackOfFit(float(np.mean(residual[:40] ** 2)), 0.0))


def test_every_row_counts_as_much_whichever_drive_it_is_of() -> None:
    columns, residual, valid, block = made(0.0, seed=2)
    short = RegressionData(columns[:400], residual[:400], valid[:400], block[:400] + BLOCKS)
    left = pool_lack_of_fit([made(2.0), short], np.arange(2 * BLOCKS))
    assert left.total == pytest.approx((N * 5.0 + 400 * 1.0) / (N + 400), rel=0.05), "3 if drives counted alike"
    assert left.explained > 3.0


@pytest.mark.parametrize("share", [0.0, 2.0])
def test_many_drives_of_one_block_each_tell_together_what_none_tells_alone(share: float) -> None:
    columns, residual, valid, block = made(share)
    residual = residual + np.where(block // 4 % 2, 3.0, -3.0)  # of each drive its own, that no other foretells
    cuts = [block == b for b in range(BLOCKS)]
    pieces = [RegressionData(columns[rows], residual[rows], valid[rows], block[rows]) for rows in cuts]
    missed = float(np.mean(pieces[0].residual ** 2))
    assert pool_lack_of_fit(pieces[:1], np.arange(BLOCKS)) == pytest.approx(LackOfFit(missed, 0.0)), (
        "missed all the same"
    )
    left = pool_lack_of_fit(pieces, np.arange(BLOCKS))
    assert left.explained == pytest.approx(share**2, abs=0.6) and left.total == pytest.approx(10.0 + share**2, rel=0.1)


def test_features_look_at_nothing_that_comes_later() -> None:
    target = next(one for one in DriveComparison(OPENED).targets if one.name == "yaw_rate")
    half = OPENED.ticks // 2
    later = OPENED.inputs.outputs.copy()
    later[half + 1 :] = 0.3
    other = OPENED._replace(inputs=OPENED.inputs._replace(outputs=later))
    rows = target.rows <= half
    was, now = (build_features(one, target) for one in (OPENED, other))
    assert np.array_equal(was[rows], now[rows]) and not np.array_equal(was[~rows], now[~rows])


def test_a_link_is_broken_where_more_is_left_than_a_calibrated_model_may_miss() -> None:
    kinds = {
        name: TargetProperties(name, Link.REPORT_TO_MOTION, "m/s2", 0.05, 0.0) for name in ("much", "little", "noisy")
    }
    kinds["noisy"] = kinds["noisy"]._replace(noise=0.99)
    left = {"much": LackOfFit(0.02, 0.01), "little": LackOfFit(0.0002, 0.0001), "noisy": LackOfFit(1.0, 0.004)}
    found = assess_links(left, kinds, dict.fromkeys(kinds, 1.0))
    assert found[0].signal == "much" and {one.signal: one.is_broken for one in found} == {
        "much": True, "little": False, "noisy": False,
    }  # fmt: skip


def test_few_rows_are_asked_by_few_columns() -> None:
    target = next(one for one in DriveComparison(OPENED).targets if one.name == "yaw_rate")
    residual, block = np.zeros(len(target.rows)), np.zeros(len(target.rows), dtype=int)
    widths = [
        _build_data([_DriveTarget(OPENED, target)], [residual], [block], rows)[0].features.shape[1]
        for rows in (5000, 500, 300, 50)
    ]
    assert widths == sorted(widths, reverse=True) and len(set(widths)) == 4
    assert all(
        rows >= REGRESSION.min_rows_per_column * width for rows, width in zip((5000, 500, 300), widths, strict=False)
    )


def test_what_a_small_car_does_slowly_has_a_shape() -> None:
    """One over the speed, and which way the wheel turns, by the size of the car, its ticks, its steering."""
    target = next(one for one in DriveComparison(OPENED).targets if one.name == "yaw_rate")
    x = OPENED.inputs
    small = OPENED._replace(inputs=x._replace(speed_mps=0.05 * x.speed_mps, outputs=0.05 * x.outputs), size_scale=0.05)
    whole, little = (
        build_features(OPENED, target),
        build_features(small._replace(max_steer_rad=0.05 * OPENED.max_steer_rad), target),
    )
    over = -2  # one over the speed: the last but how far the drive has gone
    assert little[:, over] == pytest.approx(20.0 * whole[:, over]) and np.ptp(whole[:, over]) > 0.0
    turning = slice(-4 - 6, -4)  # lags of the last signal, before what stands still
    assert little[:, turning] == pytest.approx(whole[:, turning]) and np.ptp(whole[:, turning]) > 1.0
