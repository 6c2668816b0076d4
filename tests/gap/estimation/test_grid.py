"""Grids of candidates: on a straight line whose best value is known."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.effects import catalogue
from tunefree_hil.gap.estimation import nuisance
from tunefree_hil.gap.estimation.candidates import free_of
from tunefree_hil.gap.estimation.grid import AMOUNTS, DELAY_STEP_S, EVEN, FACTORS, SMALL, TWINS, Scan, grid_of, without
from tunefree_hil.gap.estimation.least_squares import Fitted, Free, Slopes, Sums, is_free
from tunefree_hil.gap.estimation.noise import Colour, Piece, colour_of, whitened
from tunefree_hil.gap.workers.pool import HOPELESS

ROWS = 200
T = np.linspace(0.0, 1.0, ROWS)
COLOUR = Colour(np.array([1.0]), 1.0, 1.0)
TRUTH = 0.37
WIND = Free("wind.size", 0.0, 1.0, False, 0.0, 0.0, 1.3)
BENT = 8.0 * np.sin(9.0 * T)


class Work:
    """Residuals of one target: `a` is recalibration's, the wind bends; 'wall.size' makes no car."""

    def residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        if "wall.size" in values:
            raise InputError("no such car", code="no_car")
        return {"x": [BENT * (values.get("wind.size", 0.0) - TRUTH) + 3.0 * T * values.get("a", 0.0)]}

    def size(self, name: str) -> float:
        return 2.0

    def seen(self, name: str) -> list[np.ndarray]:
        return [np.ones(ROWS, dtype=bool)]

    def white(self, name: str, residual: list[np.ndarray], colour: Colour) -> tuple[np.ndarray, np.ndarray]:
        return residual[0], np.zeros(ROWS, dtype=np.int64)


def prior(keys: Any, free: Any) -> np.ndarray:
    """Each number by itself."""
    return np.diag((~is_free(keys, free)).astype(float))


class Problem:
    """As `gap.problem` has it, of that work."""

    work = Work()
    prior, walls = staticmethod(prior), staticmethod(lambda keys, _: np.zeros((0, len(keys))))

    def judged(self) -> np.ndarray:
        return np.array([0])

    def values(self, keys: Any, z: np.ndarray, free: Any) -> dict[str, float]:
        return dict(zip(keys, map(float, z), strict=True))


def scan() -> Scan:
    residuals = Work().residuals({})
    sums = {"x": Sums(np.array([0]), np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1, 1)), np.full(1, ROWS), COLOUR)}
    start = Fitted("", ("a",), np.zeros(1), (), {"a": 0.0}, np.eye(1), sums, residuals)
    return Scan(Problem(), start, Slopes({"x": (np.array([0]), [3.0 * T[:, None]])}))  # pyright: ignore[reportArgumentType]


def test_the_grid_comes_near_and_the_finer_one_nearer() -> None:
    one = scan()
    coarse = one.best([WIND])
    fine = one.finer([WIND], coarse)
    assert coarse.keys == ("a", "wind.size") and abs(coarse.z[-1] - TRUTH) < 0.5 / (EVEN - 1)
    assert abs(fine.z[-1] - TRUTH) < 0.02 and fine.gain >= coarse.gain > 0.5 * float(np.sum((TRUTH * BENT) ** 2))


def test_what_a_point_gains_is_beyond_what_recalibration_gains_alone() -> None:
    still = Free("still.size", 0.0, 1.0, False, 0.0, 0.0, 1.3)
    assert scan().best([still]).gain == pytest.approx(0.0, abs=1e-9)


def test_an_effect_of_which_no_value_makes_a_car_is_refused() -> None:
    with pytest.raises(InputError, match="no value"):
        scan().best([WIND._replace(key="wall.size")])


def test_grids_are_as_fine_as_what_they_search_is_rugged() -> None:
    even = Free("a.b", 0.01, 0.5, False, 0.0, 0.0, 1.3)
    some = (even, even._replace(logarithmic=True), even._replace(low=-0.5))
    assert [len(grid_of([one])) for one in some] == [EVEN, FACTORS, 2 * len(AMOUNTS)]
    assert len(grid_of([even, even])) == 3 * EVEN and all(len(point) == 2 for point in grid_of([even, even]))


@pytest.mark.parametrize("high", [0.2, 0.8])
def test_no_delay_lies_far_from_a_point_of_its_grid(high: float) -> None:
    """Which it would be worse to take than none: edges that are moved by another time stand beside those measured."""
    delay = Free("a.delay_s", 0.01, high, False, 0.0, 0.0, 1.3)
    asked = [delay.value(float(point[0])) for point in grid_of([delay])]
    assert asked[0] == pytest.approx(0.01) and asked[-1] == pytest.approx(high)
    far = [max(DELAY_STEP_S, 0.11 * one) for one in asked[:-1]]
    assert all(0.0 < step < wide + 1e-9 for step, wide in zip(np.diff(asked), far, strict=True))


def test_the_finer_points_reach_to_the_neighbours_of_the_best() -> None:
    delay = Free("wind.delay_s", 0.01, 0.8, False, 0.0, 0.0, 1.3)
    begin, asked = scan().best([delay]), list[float]()

    class Asked(Scan):
        def _best(self, free: Any, points: Any) -> Any:
            asked.extend(float(point[0]) for point in points)
            return begin

    one = scan()
    Asked(one.problem, one.start, Slopes({"x": (np.array([0]), [3.0 * T[:, None]])})).finer([delay], begin)
    places = sorted(float(point[0]) for point in grid_of([delay]))
    here = int(np.argmin(np.abs(np.array(places) - begin.z[-1])))
    assert min(asked) <= places[max(here - 1, 0)] + 1e-9 and max(asked) >= places[min(here + 1, len(places) - 1)] - 1e-9


def test_no_point_for_an_amount_is_neutral_and_small_amounts_are_asked_too() -> None:
    offset = Free("a.b", -0.3, 0.3, False, 0.0, -0.3, 1.3)
    asked = sorted(offset.value(float(point[0])) for point in grid_of([offset]))
    assert asked == pytest.approx([-0.3, -0.09, -0.03, -0.009, 0.009, 0.03, 0.09, 0.3])


FACTOR_EFFECTS = tuple(one for one in nuisance.ROWS if catalogue()[one.effect].neutral[one.parameter] == 1.0)
FELT = 40.0 * np.sin(9.0 * T)  # by the logarithm of the factor


@cache
def factor(name: str, parameter: str) -> Free:
    effect = catalogue()[name]
    return free_of("g.size", effect.priors[parameter], effect.neutral[parameter])


class Factor(Work):
    """A car whose only trouble is a factor; recalibration may move the very same one, 3 deviations far."""

    prior, walls = staticmethod(prior), staticmethod(lambda keys, _: np.zeros((0, len(keys))))

    def __init__(self, truth: float, sigma: float) -> None:
        self.truth, self.sigma, self.work = truth, sigma, self

    def residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        return {"x": [FELT * np.log(values.get("g.size", 1.0) / self.truth)]}

    def white(self, name: str, residual: list[np.ndarray], colour: Colour) -> tuple[np.ndarray, np.ndarray]:
        return residual[0], np.zeros(ROWS, dtype=np.int64)

    def judged(self) -> np.ndarray:
        return np.array([0])

    def values(self, keys: Any, z: np.ndarray, free: Any) -> dict[str, float]:
        own = {one.key: one for one in free}
        told = zip(keys, map(float, z), strict=True)
        return {key: own[key].value(at) if key in own else 1.0 + self.sigma * at for key, at in told}

    def scan(self) -> Scan:
        """Beside what recalibration comes to alone."""
        z = np.array([np.clip((self.truth - 1.0) / self.sigma, -3.0, 3.0)])
        values = self.values(("g.size",), z, ())
        residuals = self.residuals(values)
        sums = {"x": Sums(np.array([0]), np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1, 1)), np.full(1, ROWS), COLOUR)}
        slopes = Slopes({"x": (np.array([0]), [self.sigma * FELT[:, None] / values["g.size"]])})
        return Scan(self, Fitted("", ("g.size",), z, (), values, np.eye(1), sums, residuals), slopes)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("drift", FACTOR_EFFECTS, ids=lambda one: one.effect)
def test_a_factor_that_recalibration_cannot_take_is_worth_a_fit_wherever_it_lies(
    drift: nuisance.Drift,
) -> None:
    one, sigma = factor(drift.effect, drift.parameter), drift.sigma
    for truth in np.exp(np.linspace(np.log(one.low), np.log(one.high), 60)):
        if abs(truth - 1.0) > 3.0 * sigma:  # what is nearer is a matter of recalibration
            found = Factor(float(truth), sigma).scan().best([one])
            assert found.gain > HOPELESS, (truth, found)
            widest = np.log(one.high / one.low) / (FACTORS - 1)
            assert abs(np.log(one.value(float(found.z[-1])) / truth)) <= max(0.5 * widest, 3.0 * sigma) + 1e-9


def test_a_factor_has_points_near_neutral_beside_its_even_grid() -> None:
    one = factor("brake_gain", "gain_frac")
    asked = [one.value(float(point[0])) for point in grid_of([one])]
    assert len(asked) == FACTORS + 2 * len(SMALL)
    assert min(value for value in asked if value > 1.003) < 1.03 and max(v for v in asked if v < 0.999) > 0.97


def test_slopes_without_a_column_are_numbered_anew() -> None:
    slopes = Slopes({"x": (np.array([0, 2]), [np.array([[1.0, 2.0]])])})
    columns, pieces = without(slopes, [1, 2]).by_target["x"]
    assert columns.tolist() == [1] and pieces[0].tolist() == [[2.0]]


def test_beside_a_latency_its_own_clock_is_not_recalibrated() -> None:
    one = scan()
    one.start = one.start._replace(keys=("a", "clock.ins_s"))
    assert [one.kept([WIND._replace(key=late)]) for late in TWINS] == [[0], [0]] and one.kept([WIND]) == [0, 1]


@pytest.mark.parametrize(("key", "clock_s", "place"), [("ins_latency", 0.01, 0.01), ("report_latency", -0.01, 0.01)])
def test_a_latency_begins_where_recalibration_has_put_its_clock(key: str, clock_s: float, place: float) -> None:
    """An INS that is late and reports that are late are the same clock, moved to either side."""
    one = scan()
    one.start = one.start._replace(values={"clock.ins_s": clock_s})
    late = WIND._replace(key=f"{key}.delay_s", low=0.0, high=0.1, least=-0.35, most=1.35)
    assert late.value(float(one._recalibrated([late])[0][0])) == pytest.approx(place)


REACH, STOP = 8.0, 7.8  # what the signal comes to, and where it stops
LIMIT = Free("stop.size", 0.0, 20.0, False, np.inf, -0.3, 1.3)


class Stopped(Work):
    """A signal that is stopped where it is farthest; a grid from 0 to 20 has a point at 7.3 and the next at 9.1."""

    asked = 0

    def residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        self.asked += 1
        signal = REACH * np.sin(9.0 * T)
        return {"x": [np.minimum(signal, 20.0 * values.get("stop.size", np.inf)) - np.minimum(signal, STOP)]}


@pytest.mark.parametrize("reached", [True, False])
def test_a_limit_that_is_hardly_touched_is_found_between_the_points(
    reached: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = Stopped()
    monkeypatch.setattr(Problem, "work", work)
    if not reached:
        monkeypatch.setattr("tests.gap.estimation.test_grid.STOP", 2.0 * REACH)
    one = scan()
    one = Scan(one.problem, one.start._replace(residuals=work.residuals({})), one._slopes)
    found, asked = one.best([LIMIT]), work.asked
    if reached:
        assert 20.0 * found.z[-1] == pytest.approx(STOP, abs=0.1)
        assert found.gain > 0.5 * float(np.sum(work.residuals({})["x"][0] ** 2)) > 0.0
    else:
        assert found.gain == pytest.approx(0.0, abs=1e-9) and 20.0 * found.z[-1] > REACH
    assert asked < 3 * EVEN + 20


def test_a_limit_that_cuts_much_off_is_left_to_its_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.gap.estimation.test_grid.STOP", 3.0)
    work = Stopped()
    monkeypatch.setattr(Problem, "work", work)
    one = scan()
    one = Scan(one.problem, one.start._replace(residuals=work.residuals({})), one._slopes)
    asked = work.asked
    assert 20.0 * one.best([LIMIT]).z[-1] == pytest.approx(3.0, abs=1.0) and work.asked - asked == EVEN + 1


def test_how_far_a_grid_moves_what_is_compared_is_told_as_a_share_of_the_signal() -> None:
    still = Free("still.size", 0.0, 1.0, False, 0.0, 0.0, 1.3)
    bent = float(np.sqrt(np.mean(BENT**2)))
    assert scan().best([WIND]).moves == pytest.approx(0.5 * bent), "the farthest point"
    assert scan().best([still]).moves == 0.0


DRAGGED = 4000
ROUGH = np.random.default_rng(3).normal(0.0, 0.05, DRAGGED)  # m/s^2
PULL = 0.3  # m/s^2, what a constant force that the start lacks takes: six times the noise
SEEN = np.ones(DRAGGED, dtype=bool)


class Dragged(Work):
    """A car that a constant force drags at all times; `wind.size` is how much of it a model has."""

    def residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        return {"x": [ROUGH + PULL * (values.get("wind.size", 0.0) / TRUTH - 1.0)]}

    def seen(self, name: str) -> list[np.ndarray]:
        return [SEEN]

    def white(self, name: str, residual: list[np.ndarray], colour: Colour) -> tuple[np.ndarray, np.ndarray]:
        found = whitened(Piece(residual[0], SEEN), colour.filter)
        return found.values[found.valid] / colour.sigma, np.zeros(int(found.valid.sum()), dtype=np.int64)

    def fitted(self, values: dict[str, float]) -> Fitted:
        """A model with these values, and the noise that it leaves."""
        residuals = self.residuals(values)
        colour = colour_of([Piece(residuals["x"][0], SEEN)], 1e-4, 0.02)
        sums = {"x": Sums(np.array([0]), np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1, 1)), np.ones(1), colour)}
        return Fitted("", ("a",), np.zeros(1), (), values, np.eye(1), sums, residuals)


class DraggedProblem(Problem):
    work = Dragged()


def test_what_a_constant_force_explains_is_seen_by_the_noise_of_a_model_that_has_it() -> None:
    work, free = DraggedProblem.work, [WIND]
    start, slopes = work.fitted({}), Slopes({"x": (np.array([0]), [np.zeros((DRAGGED, 1))])})
    by_own = Scan(DraggedProblem(), start, slopes).best(free)  # pyright: ignore[reportArgumentType]
    by_best = Scan(DraggedProblem(), start, slopes, work.fitted({"wind.size": TRUTH})).best(free)  # pyright: ignore[reportArgumentType]
    assert by_own.gain < 20.0, "4000 rows that all say the same are worth a few"
    assert by_best.gain > 1000.0 and abs(by_best.z[-1] - TRUTH) < 0.1
