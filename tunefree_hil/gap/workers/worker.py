"""What a process of learn/compiled_process.py is asked in a search for a name: one question kept open, models fitted one by one.

A question is opened once per process (graph compiled, recalibration fitted, its slopes taken); several processes open
the same one and share the suspects. What goes back to whoever asks is small: no residuals.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.gap.diagnostics.lack_of_fit import Left, leftovers
from tunefree_hil.gap.diagnostics.residual_tests import Burst, Region, Shape, burst_of, regions, shape_of, windows_of
from tunefree_hil.gap.estimation.calibration_priors import after_own, own_numbers_of
from tunefree_hil.gap.estimation.candidates import Suspect, doubted, suspects_of
from tunefree_hil.gap.estimation.gauss_newton import fit_candidate, fit_null, fit_on, fit_without
from tunefree_hil.gap.estimation.grid import Scan, Start
from tunefree_hil.gap.estimation.least_squares import Fitted, Problem, Slopes
from tunefree_hil.gap.estimation.nuisance import Nuisance, correlation, doubts_of, held_of, nuisances, related_of
from tunefree_hil.gap.estimation.residuals import Kind, Setting, Work, apart
from tunefree_hil.gap.measured.blocks import Blocks

Array = np.ndarray

AVERAGED_S = 1.0  # long beside a sensor's noise, short beside a block
NOT_SLOW: dict[str, tuple[Array, Array]] = {}


class Modelled(NamedTuple):
    """A fitted model as it is sent: without residuals, with their squares and counts by target and block [b].

    slow: the same of means over AVERAGED_S, in which noise is next to nothing and what a drive goes astray by is left.
    """

    fitted: Fitted
    squares: dict[str, tuple[Array, Array]]
    slow: dict[str, tuple[Array, Array]] = NOT_SLOW


class Question(NamedTuple):
    """What a question is, once opened. sizes: by target the deviation of what was measured. broken: targets that
    recalibration alone leaves broken (locate.look); None: nobody has looked. usually: those of them that the model
    misses as usual (usual.py). drifting: what recalibration may move.
    """

    null: Modelled
    blocks: Blocks
    kinds: dict[str, Kind]
    sizes: dict[str, float]
    suspects: tuple[Suspect, ...]
    cannot: dict[str, str]
    broken: frozenset[str] | None = None
    usually: frozenset[str] = frozenset()
    drifting: tuple[Nuisance, ...] = ()


class _Open:
    def __init__(self, setting: Setting) -> None:
        self.work = Work(setting)
        doubts = doubts_of(setting.model)
        held = held_of(setting.model, setting.drives[0].pace)
        drifting = nuisances(self.work.graph, setting.model, doubts, held)
        own, correlated = own_numbers_of(setting.model), correlation(drifting, related_of(setting.model))
        drifting, correlated = after_own(drifting, correlated, own)
        self.problem = Problem(self.work, drifting, correlated, known=bool(own.keys))
        self.null, self.slopes = fit_null(self.problem)
        some, self.cannot = suspects_of(self.work.graph, setting.model, setting.vehicle, setting.drives)
        self.suspects = {one.name: doubted(one, drifting, doubts) for one in some}
        self._scan: tuple[Any, Scan] | None = None

    def again(self, model: Fitted) -> Fitted:
        """A model that came back, with its residuals."""
        return model._replace(residuals=self.work.residuals(model.values))

    def slopes_at(self, model: Fitted) -> Slopes:
        """Slopes of all its keys."""
        if not model.free:
            return self.slopes
        which = list(range(len(model.keys)))
        return self.problem.slopes(model.keys, model.z, model.free, which, model.residuals)

    def scan_beside(self, model: Fitted | None, noise: Fitted | None) -> Scan:
        """Of candidates beside a model (None: the null), under the noise of another (None: its own); the newest is
        kept: grids come first, fits after them.
        """
        key = tuple(() if one is None else (one.keys, tuple(one.z)) for one in (model, noise))
        if self._scan is None or self._scan[0] != key:
            start = self.null if model is None else self.again(model)
            self._scan = (key, Scan(self.problem, start, self.slopes_at(start), noise))
        return self._scan[1]


_questions: dict[str, _Open] = {}


def open_question(token: str, setting: Setting) -> Question:
    """Open a question under a name of the caller's; any other is forgotten. Raises InputError where nothing can be
    compared.
    """
    _questions.clear()
    one = _questions[token] = _Open(setting)
    work = one.work
    if not work.kinds:
        raise InputError(
            "the logs hold nothing that could be compared with a simulation",
            code="nothing_to_compare",
            key="LOG",
            hint="drive for a minute or more, above walking pace, with reports of actuators and motion",
        )
    sizes = {name: work.size(name) for name in work.kinds}
    found = tuple(one.suspects.values())
    drifting = tuple(one.problem.nuisances.values())
    return Question(_sent(work, one.null), work.blocks, work.kinds, sizes, found, one.cannot, drifting=drifting)


def scan_suspects(
    token: str, names: Sequence[str], start: Fitted | None, noise: Fitted | None
) -> tuple[dict[str, Start], dict[str, str]]:
    """(where each suspect's search beside `start` (None: the null) begins, and what it gains there under the noise of
    another model (None: of `start`); those of which no value makes a car, with the reason).
    """
    one, found, lost = _questions[token], {}, {}
    scan = one.scan_beside(start, noise)
    for name in names:
        try:
            found[name] = scan.best(one.suspects[name].free)
        except InputError as error:  # outside what the body allows everywhere on its grid: then it is not this
            lost[name] = error.message
    return found, lost


def fit_suspects(
    token: str, begins: Mapping[str, Start], start: Fitted | None, hopeless: float, noise: Fitted | None
) -> Generator[int, None, tuple[dict[str, Modelled], dict[str, str]]]:
    """(each suspect by itself beside `start`, from where its search begins; those that left what makes a car, with the
    reason); yields how many are done. hopeless: a gain below which one step is enough.
    """
    one = _questions[token]
    scan = one.scan_beside(start, noise)
    found, lost = {}, {}
    for done, (name, begin) in enumerate(begins.items()):
        yield done
        try:
            found[name] = _sent(one.work, fit_candidate(scan, name, one.suspects[name].free, begin, hopeless))
        except InputError as error:  # a step over the edge of what makes a car
            lost[name] = error.message
    return found, lost


def fitted_on(token: str, models: Sequence[Fitted]) -> list[Modelled]:
    """Models fitted on until nothing is gained: what others are to be weighed beside, or against."""
    one = _questions[token]
    return [_sent(one.work, fit_on(one.problem, one.again(model))) for model in models]


def fitted_without(token: str, model: Fitted, names: Sequence[str]) -> dict[str, Modelled]:
    """A model without each of some of its effects, the rest fitted on."""
    one = _questions[token]
    return {name: _sent(one.work, fit_without(one.problem, model, name)) for name in names}


def left_by(token: str, models: Sequence[Fitted], blocks: Array) -> list[dict[str, Left]]:
    """What each model leaves that could be explained by anything."""
    work = _questions[token].work
    targets = [compared.targets for compared in work.compared]
    drives = work.setting.drives
    return [leftovers(drives, targets, work.residuals(model.values), work.block, blocks) for model in models]


def seen_of(token: str, model: Fitted, target: str) -> tuple[list[Region], Shape | None]:
    """Where in a drive a target is missed, and what that looks like; blocks that prove are not looked at."""
    work = _questions[token].work
    residual = work.residuals(model.values)[target]
    shape = shape_of(residual, work.measured(target), work.seen(target), work.kinds[target].dt_s)
    return regions(work, target, residual), shape


def moved_by(token: str, model: Fitted, key: str, by: float) -> dict[str, float]:
    """What another value of one of a model's free parameters moves of each target where it may be looked at, root mean
    square, in its unit. by: to either side, in u; the mean of both, or the one that makes a car.
    """
    work, found = _questions[token].work, list[dict[str, float]]()
    i = model.keys.index(key)
    free = next(one for one in model.free if one.key == key)
    was = work.residuals(model.values)
    for u in (model.z[i] - by, model.z[i] + by):
        try:
            now = work.residuals({**model.values, key: free.value(float(np.clip(u, free.least, free.most)))})
        except InputError:
            continue
        found.append({name: apart(some, now[name], work.seen(name)) for name, some in was.items()})
    return {name: float(np.mean([one[name] for one in found])) for name in was} if found else {}


def bursts_of(token: str, models: Sequence[Fitted], blocks: Array) -> list[dict[str, Burst]]:
    """How loud each model's misses get where they are loudest, by target."""
    work = _questions[token].work
    return [
        {
            name: burst_of(some, work.measured(name), work.valid(name), work.block[name], blocks, work.kinds[name].dt_s)
            for name, some in work.residuals(model.values).items()
        }
        for model in models
    ]


def _sent(work: Work, model: Fitted) -> Modelled:
    squares, slow = {}, {}
    for name, some in model.residuals.items():
        rows = max(round(AVERAGED_S / work.kinds[name].dt_s), 1)
        squares[name] = _squares(work, name, some, 1)
        slow[name] = _squares(work, name, some, rows)
    return Modelled(model._replace(residuals={}), squares, slow)


def _squares(work: Work, name: str, residual: Sequence[Array], rows: int) -> tuple[Array, Array]:
    """(sums of squares, counts) by block [b] of means over so many rows."""
    sums, counts = np.zeros(work.blocks.count), np.zeros(work.blocks.count)
    for one, valid, block in zip(residual, work.valid(name), work.block[name], strict=True):
        means, at = windows_of(one, valid, block, rows)
        np.add.at(sums, at, means.mean(axis=1) ** 2)
        np.add.at(counts, at, 1.0)
    return sums, counts


def forget(token: str) -> Any:
    """Close a question."""
    return _questions.pop(token, None) is not None
