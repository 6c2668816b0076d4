"""A fit that few stretches told most of a constant does not take their word for how well it knows it."""

from __future__ import annotations

import numpy as np

from tests.learn.made_drives import made_drive, whole
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.learn.physics.unknowns import (
    CRITERIA,
    assign_stretches,
    compute_interval_half_widths,
    compute_remaining_uncertainty,
    estimate_correlation,
)
from tunefree_hil.learn.physics.windows import extract_windows
from tunefree_hil.learn.robust_least_squares import RobustFit, compute_std_devs


def test_windows_one_behind_the_other_are_one_stretch() -> None:
    windows = extract_windows([whole(made_drive(110.0, seed=seed)) for seed in (1, 2)], load_vehicle("mkz_bywire"))
    some, names = assign_stretches(windows.windows), [window.name for window in windows.windows]
    every = np.unique(some)
    assert (
        len(every) >= CRITERIA.min_stretches
        and max(np.sum(some == one) for one in every) == CRITERIA.windows_per_stretch
    )
    assert all(len({names[i] for i in np.flatnonzero(some == one)}) == 1 for one in every), "none is of two drives"
    few = windows.windows[: CRITERIA.windows_per_stretch * (CRITERIA.min_stretches - 1)]
    assert assign_stretches(few).tolist() == list(range(len(few))) and len(assign_stretches(())) == 0


def test_the_few_stretches_that_know_a_constant_do_not_vouch_for_themselves() -> None:
    chance, old, new = np.random.default_rng(5), [], []
    for _ in range(150):
        truth, found, were, are = _few_that_know(chance)
        old += list(np.abs(found - truth) < were)
        new += list(np.abs(found - truth) < are)
    assert np.mean(old) < 0.65, np.mean(old)
    assert 0.8 < np.mean(new) < 0.99, np.mean(new)


def test_what_is_known_as_a_sum_is_doubted_together() -> None:
    chance, count, rows = np.random.default_rng(2), 12, 8
    stretches = np.repeat(np.arange(count), rows)
    slopes = chance.standard_normal((count * rows, 3))
    slopes[:, 1] = slopes[:, 0] + 0.05 * slopes[:, 1]  # the first two nearly as a sum only
    noise = chance.standard_normal(count * rows)
    jacobian = np.concatenate([slopes, np.eye(3)])
    x = np.linalg.lstsq(jacobian, np.concatenate([noise, np.zeros(3)]), rcond=None)[0]
    least = RobustFit(x, np.full(3, 0.1), 2.2, jacobian, np.concatenate([slopes @ x - noise, x]), 1.0)
    found = estimate_correlation(("a", "b", "c"), least, stretches)
    assert found.names == ("a", "b", "c") and np.allclose(np.diag(found.correlation), 1.0)
    assert found.correlation[0, 1] < -0.9 and abs(found.correlation[0, 2]) < 0.5


def _few_that_know(chance: np.random.Generator) -> tuple[np.ndarray, ...]:
    """(truth, found, half of the interval window by window, stretch by stretch) of three constants, of each of which
    half of the stretches know most; what the form lacks is the same in a stretch's windows.
    """
    count, rows, unknowns = 12, 8, 3
    knows = np.where(np.arange(count)[:, None] % 2 == np.arange(unknowns) % 2, 30.0, 3.0)
    stretches = np.repeat(np.arange(count), CRITERIA.windows_per_stretch * rows)
    windows = np.repeat(np.arange(count * CRITERIA.windows_per_stretch), rows)
    slopes = knows[stretches] * chance.standard_normal((count, unknowns))[stretches]
    slopes += 0.3 * chance.standard_normal(slopes.shape)
    truth = 0.3 * chance.standard_normal(unknowns)
    lacks = chance.standard_normal(count)[stretches] + 0.3 * chance.standard_normal(len(stretches))
    jacobian = np.concatenate([slopes, np.eye(unknowns)])
    sought = np.concatenate([slopes @ truth + lacks, np.zeros(unknowns)])
    x = np.linalg.lstsq(jacobian, sought, rcond=None)[0]
    residuals = jacobian @ x - sought
    deviation, quantile = compute_std_devs(jacobian, residuals, windows, unknowns)
    least = RobustFit(x, deviation, quantile, jacobian, residuals, 1.0)
    return truth, x, quantile * compute_remaining_uncertainty(least), compute_interval_half_widths(least, stretches)
