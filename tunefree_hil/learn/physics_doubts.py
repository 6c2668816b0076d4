"""How well a fit of free runs knows a car's constants, where few stretches of a drive tell most of them.

A window of a drive knows what its manoeuvre moves; windows one behind the other see the same manoeuvre, and share what
the model's form lacks there. So whole stretches are taken as independent (learn/least.py takes each window as that),
and what the fit itself took off their residuals is given back.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from tunefree_hil.learn.least import Least
from tunefree_hil.learn.windows import Window

Array = np.ndarray

STRETCH = 3  # windows one behind the other: they see one manoeuvre, and share what the model's form lacks there
LEAST_STRETCHES = 4  # of which something can be told; of fewer each window is one
LEAST_LEFT = 1e-6  # of a stretch's residuals that the fit can have left in them


class Together(NamedTuple):
    """What a fit does not know of some constants goes together: names [p], correlation [p, p] of what they are off by
    (of the logarithm of what is a factor).
    """

    names: tuple[str, ...] = ()
    correlation: Array = np.zeros((0, 0))


def deviations_left(least: Least) -> Array:
    """What is left of each unknown's doubt (1 before the fit), with the windows' own scatter where that is wider."""
    inner = np.linalg.pinv(least.jacobian.T @ least.jacobian, hermitian=True)
    return np.maximum(np.sqrt(np.maximum(np.diag(inner), 0.0)), least.deviation)


def stretches_of(some: Sequence[Window]) -> Array:
    """The stretch of each window [windows]: STRETCH of a drive, one behind the other; the window where they are few."""
    found, stretch, held = np.zeros(len(some), dtype=int), -1, 0
    for i, window in enumerate(some):
        if i == 0 or window.name != some[i - 1].name or held == STRETCH:
            stretch, held = stretch + 1, 0
        found[i], held = stretch, held + 1
    return found if stretch + 1 >= LEAST_STRETCHES else np.arange(len(some))


def doubts_left(least: Least, stretches: Array) -> Array:
    """Half of each unknown's 95 % interval, in what was doubted before the fit (1: one standard deviation of that).

    What a fit leaves of a stretch's residuals is less than its error, and the more so the more it told the fit: taken
    as they are, the few stretches that know the tyres would vouch for themselves. They are set right by what the fit
    took off them (Bell and McCaffrey 2002), stretch by stretch (`stretches` [n], of each residual that is data).
    """
    pulls = _pulls(least, stretches)
    count = len(pulls)
    scatter = np.sqrt(np.sum(pulls * pulls, axis=0) * (count / (count - 1)))
    wide = float(student.ppf(0.975, count - 1)) * scatter
    return np.minimum(np.maximum(wide, least.quantile * deviations_left(least)), least.quantile)


def together(names: Sequence[str], least: Least, stretches: Array) -> Together:
    """How the unknowns' doubts hang together: half as the fit's own curvature says, half as its stretches do. The first
    knows which of them only their sum is known of; the second, of so few, also what goes together by chance.
    """
    pulls = _pulls(least, stretches)
    inner = np.linalg.pinv(least.jacobian.T @ least.jacobian, hermitian=True)
    return Together(tuple(names), 0.5 * (_correlation(inner) + _correlation(pulls.T @ pulls)))


def _correlation(covariance: Array) -> Array:
    size = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    found = covariance / np.outer(size, size)
    np.fill_diagonal(found, 1.0)
    return found


def _pulls(least: Least, stretches: Array) -> Array:
    """By how much each stretch pulls the unknowns [stretches, p], its residuals as large as its errors are."""
    inner = np.linalg.pinv(least.jacobian.T @ least.jacobian, hermitian=True)
    root = np.linalg.cholesky(inner)
    every = np.unique(stretches)
    pulls = np.zeros((len(every), len(inner)))
    for i, one in enumerate(every):
        rows = np.flatnonzero(stretches == one)
        here, miss = least.jacobian[rows], least.residuals[rows]
        basis, size, _ = np.linalg.svd(here @ root, full_matrices=False)
        more = 1.0 / np.sqrt(np.maximum(1.0 - size * size, LEAST_LEFT)) - 1.0
        pulls[i] = inner @ (here.T @ (miss + basis @ (more * (basis.T @ miss))))
    return pulls
