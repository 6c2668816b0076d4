"""Suggestions of a Gaussian process by BoTorch: upper confidence bound (paper, eq. 8), and maximum entropy.

The process models the negative logarithm of the score, which grows with the violation of the requirements
(`rank_value`). Columns of the model are the places of the parameters in the unit box; a choice has a column
for each value. The acquisition is maximised for each combination of the choices, or with relaxed choices where there
are many; steps are relaxed. Then each maximum is moved to the nearest allowed point and judged there.

Only `suggestion.py` imports this module, when it is used: it needs torch.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import torch
from botorch.acquisition import AcquisitionFunction, UpperConfidenceBound, qUpperConfidenceBound
from botorch.acquisition.max_value_entropy_search import qLowerBoundMaxValueEntropy
from botorch.exceptions import BotorchWarning, ModelFittingError
from botorch.fit import fit_gpytorch_mll
from botorch.models import SingleTaskGP
from botorch.optim import optimize_acqf
from botorch.sampling import SobolQMCNormalSampler
from gpytorch.mlls import ExactMarginalLogLikelihood
from gpytorch.utils.warnings import GPInputWarning, NumericalWarning

from tunefree_hil.tune.sampling.points import (
    ScoredPoint,
    derive_slot_seed,
    from_unit,
    sampler_value_from_score,
    share_from_value,
    value_from_share,
)
from tunefree_hil.tune.sampling.quasi_random import draw_sobol_units
from tunefree_hil.tune.sampling.ranking import rank_value
from tunefree_hil.tune.space import Space


class BotorchCriteria(NamedTuple):
    """How far the model is fitted and the acquisition is searched. More costs time."""

    # steps of the fit: BoTorch's own limit costs 0.9 to 3 s of a processor at 50 to 200 trials, this 0.2 to 0.5 s, for
    # the same result within the seeds (measured with Optuna 5.0 and BoTorch 0.18, 11 parameters)
    fit_steps: int = 75
    raw_points: int = 512  # points of which the best start a search of the acquisition; Optuna's GP takes 2,048
    starts: int = 8  # searches of the acquisition; Optuna's GP has 10
    acquisition_steps: int = 100  # of each search
    monte_carlo_samples: int = 128  # for points in flight; BoTorch's and Optuna's default
    entropy_points: int = 1024  # points, the best of which stands for the unknown maximum; BoTorch's example has 1,000
    most_combinations: int = 4  # of choices, each with a search of its own: two switches


CRITERIA = BotorchCriteria()
Row = list[float]  # a point as columns of the model


def suggest_by_botorch(
    space: Space,
    history: Sequence[ScoredPoint],
    *,
    kappa_w: float | None,
    seed: int,
    slots: Sequence[int],
    pending: Sequence[Mapping[str, float]] = (),
) -> list[dict[str, float]]:
    """Suggest the parameters of slots that are tried at the same time.

    Args:
        space: Search space.
        history: Finished trials in slot order, two or more.
        kappa_w: Weight of the uncertainty (paper, eq. 8); None for maximum entropy.
        seed: Seed of the study.
        slots: Numbers of the slots.
        pending: Sets of parameters in flight.
    """
    waiting = [dict(parameters) for parameters in pending]
    suggested: list[dict[str, float]] = []
    with _reproducible_torch():
        torch.manual_seed(derive_slot_seed(seed, slots[0]))
        model = _fit_model(space, history)
        for slot in slots:
            slot_seed = derive_slot_seed(seed, slot)
            torch.manual_seed(slot_seed)
            acquisition = _make_acquisition(model, space, waiting, kappa_w, slot_seed)
            known = {tuple(parameters.values()) for parameters in [*waiting, *(point.parameters for point in history)]}
            suggested.append(_find_maximum(acquisition, space, known))
            waiting.append(suggested[-1])
    return suggested


def row_from_parameters(space: Space, parameters: Mapping[str, float]) -> Row:
    """The columns of the model: a place in the range, or a column for each value of a choice."""
    row: Row = []
    for axis in space.axes:
        value = parameters[axis.name]
        if axis.choices:
            row += [float(choice == axis.clip(value)) for choice in axis.grid]
        else:
            row.append(share_from_value(axis, value))
    return row


def parameters_from_row(space: Space, row: Sequence[float]) -> dict[str, float]:
    """The allowed point nearest to a row, which may lie between steps or choices."""
    parameters: dict[str, float] = {}
    start = 0
    for axis in space.axes:
        width = len(axis.grid) if axis.choices else 1
        columns = row[start : start + width]
        start += width
        if axis.choices:
            parameters[axis.name] = axis.grid[max(range(width), key=columns.__getitem__)]
        else:
            parameters[axis.name] = value_from_share(axis, columns[0])
    return parameters


def list_fixed_columns(space: Space) -> list[dict[int, float]]:
    """Columns of choices and their values, for each combination; one empty entry where there are too many."""
    columns: list[list[dict[int, float]]] = []
    start = 0
    for axis in space.axes:
        width = len(axis.grid) if axis.choices else 1
        if axis.choices:
            columns.append([{start + k: float(k == chosen) for k in range(width)} for chosen in range(width)])
        start += width
    if math.prod(len(values) for values in columns) > CRITERIA.most_combinations:
        return [{}]
    return [{k: value for part in parts for k, value in part.items()} for parts in itertools.product(*columns)]


def _fit_model(space: Space, history: Sequence[ScoredPoint]) -> SingleTaskGP:
    rows = torch.tensor([row_from_parameters(space, point.parameters) for point in history], dtype=torch.float64)
    values = torch.tensor([[-sampler_value_from_score(rank_value(point))] for point in history], dtype=torch.float64)
    model = SingleTaskGP(rows, values)
    untrained = {name: value.clone() for name, value in model.state_dict().items()}
    try:
        fit_gpytorch_mll(
            ExactMarginalLogLikelihood(model.likelihood, model),
            optimizer_kwargs={"options": {"maxiter": CRITERIA.fit_steps}},
        )
    except ModelFittingError:  # such as many equal scores: the priors of the model are a usable guess
        model.load_state_dict(untrained)
    return model.eval()


def _make_acquisition(
    model: SingleTaskGP, space: Space, waiting: Sequence[dict[str, float]], kappa_w: float | None, seed: int
) -> AcquisitionFunction:
    rows = [row_from_parameters(space, parameters) for parameters in waiting]
    pending = torch.tensor(rows, dtype=torch.float64) if rows else None
    if kappa_w is None:
        units = draw_sobol_units(len(space.axes), CRITERIA.entropy_points, seed)
        points = [row_from_parameters(space, from_unit(space, unit)) for unit in units]
        return qLowerBoundMaxValueEntropy(model, torch.tensor(points, dtype=torch.float64), X_pending=pending)
    if pending is None:
        return UpperConfidenceBound(model, beta=kappa_w**2)
    sampler = SobolQMCNormalSampler(torch.Size([CRITERIA.monte_carlo_samples]), seed=seed)
    return qUpperConfidenceBound(model, beta=kappa_w**2, sampler=sampler, X_pending=pending)


def _find_maximum(acquisition: AcquisitionFunction, space: Space, known: set[tuple[float, ...]]) -> dict[str, float]:
    """The allowed point with the largest acquisition; one that is known only where there is no other."""
    width = sum(len(axis.grid) if axis.choices else 1 for axis in space.axes)
    bounds = torch.tensor([[0.0] * width, [1.0] * width], dtype=torch.float64)
    rows: list[Row] = []
    for fixed in list_fixed_columns(space):
        maxima, _ = optimize_acqf(
            acquisition,
            bounds,
            q=1,
            num_restarts=CRITERIA.starts,
            raw_samples=CRITERIA.raw_points,
            options={"maxiter": CRITERIA.acquisition_steps},
            fixed_features=fixed or None,
            return_best_only=False,
            retry_on_optimization_warning=False,
        )
        rows += maxima.squeeze(-2).tolist()
    points = [parameters_from_row(space, row) for row in rows]
    allowed = torch.tensor([row_from_parameters(space, parameters) for parameters in points], dtype=torch.float64)
    with torch.no_grad():
        values = acquisition(allowed.unsqueeze(-2)).tolist()
    best = max(range(len(points)), key=lambda k: (tuple(points[k].values()) not in known, values[k]))
    return points[best]


@contextmanager
def _reproducible_torch() -> Iterator[None]:
    """One thread, a generator of its own, and no warnings of searches that end at their limit of steps."""
    threads = torch.get_num_threads()
    with torch.random.fork_rng(devices=[]), warnings.catch_warnings():
        for category in (BotorchWarning, NumericalWarning, GPInputWarning):
            warnings.simplefilter("ignore", category)
        torch.set_num_threads(1)
        try:
            yield
        finally:
            torch.set_num_threads(threads)
