"""Grids of candidates: on a straight line whose best value is known."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.effects import catalogue
from tunefree_hil.gap.estimation import nuisance
from tunefree_hil.gap.estimation.candidates import free_parameter_from_prior
from tunefree_hil.gap.estimation.grid import (
    CRITERIA,
    NEAR_NEUTRAL_SHARES,
    RECALIBRATION_TWINS,
    SHARES_OF_PRIOR,
    GridScan,
    grid_points,
    select_columns,
)
from tunefree_hil.gap.estimation.least_squares import Fit, FreeParameter, Jacobian, NormalEquations, is_free
from tunefree_hil.gap.estimation.noise import NoiseModel, ResidualPiece, estimate_noise_model, whiten_piece
from tunefree_hil.gap.workers.pool import CRITERIA as SCREENING

ROWS = 200
T = np.linspace(0.0, 1.0, ROWS)
COLOUR = NoiseModel(np.array([1.0]), 1.0, 1.0)
TRUTH = 0.37
WIND = FreeParameter("wind.size", 0.0, 1.0, False, 0.0, 0.0, 1.3)
BENT = 8.0 * np.sin(9.0 * T)


class FakeResidualModel:
    """Residuals of one target: `a` is a nuisance, `wind.size` an effect; 'wall.size' is no possible car."""

    def simulate_residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        if "wall.size" in values:
            raise InputError("no such car", code="no_car")
        return {"x": [BENT * (values.get("wind.size", 0.0) - TRUTH) + 3.0 * T * values.get("a", 0.0)]}

    def signal_scale(self, name: str) -> float:
        return 2.0

    def non_holdout_rows(self, name: str) -> list[np.ndarray]:
        return [np.ones(ROWS, dtype=bool)]

    def whiten(self, name: str, residual: list[np.ndarray], colour: NoiseModel) -> tuple[np.ndarray, np.ndarray]:
        return residual[0], np.zeros(ROWS, dtype=np.int64)


def prior(keys: Any, free: Any) -> np.ndarray:
    """Precision of independent priors."""
    return np.diag((~is_free(keys, free)).astype(float))


class FakeProblem:
    """A least-squares problem with that residual model."""

    residual_model = FakeResidualModel()
    prior_precision = staticmethod(prior)
    joint_bounds = staticmethod(lambda keys, _: np.zeros((0, len(keys))))

    def non_holdout_blocks(self) -> np.ndarray:
        return np.array([0])

    def parameter_values(self, keys: Any, z: np.ndarray, free: Any) -> dict[str, float]:
        return dict(zip(keys, map(float, z), strict=True))


def scan() -> GridScan:
    residuals = FakeResidualModel().simulate_residuals({})
    sums = {
        "x": NormalEquations(
            np.array([0]), np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1, 1)), np.full(1, ROWS), COLOUR
        )
    }
    start = Fit("", ("a",), np.zeros(1), (), {"a": 0.0}, np.eye(1), sums, residuals)
    return GridScan(FakeProblem(), start, Jacobian({"x": (np.array([0]), [3.0 * T[:, None]])}))  # pyright: ignore[reportArgumentType]


def test_the_grid_comes_near_and_the_refined_one_nearer() -> None:
    one = scan()
    coarse = one.find_start([WIND])
    fine = one.refine_start([WIND], coarse)
    assert coarse.keys == ("a", "wind.size") and abs(coarse.z[-1] - TRUTH) < 0.5 / (CRITERIA.linear_points - 1)
    assert abs(fine.z[-1] - TRUTH) < 0.02 and fine.gain >= coarse.gain > 0.5 * float(np.sum((TRUTH * BENT) ** 2))


def test_the_gain_of_a_point_is_beyond_that_of_recalibration_alone() -> None:
    still = FreeParameter("still.size", 0.0, 1.0, False, 0.0, 0.0, 1.3)
    assert scan().find_start([still]).gain == pytest.approx(0.0, abs=1e-9)


def test_an_effect_without_a_possible_value_is_an_error() -> None:
    with pytest.raises(InputError, match="no value"):
        scan().find_start([WIND._replace(key="wall.size")])


def test_grids_have_as_many_points_as_their_parameter_needs() -> None:
    even = FreeParameter("a.b", 0.01, 0.5, False, 0.0, 0.0, 1.3)
    some = (even, even._replace(is_logarithmic=True), even._replace(low=-0.5))
    assert [len(grid_points([one])) for one in some] == [
        CRITERIA.linear_points,
        CRITERIA.logarithmic_points,
        2 * len(SHARES_OF_PRIOR),
    ]
    assert len(grid_points([even, even])) == 3 * CRITERIA.linear_points and all(
        len(point) == 2 for point in grid_points([even, even])
    )


@pytest.mark.parametrize("high", [0.2, 0.8])
def test_no_delay_lies_far_from_a_point_of_its_grid(high: float) -> None:
    """A wrong delay would be worse than none: edges would be moved beside the measured ones."""
    delay = FreeParameter("a.delay_s", 0.01, high, False, 0.0, 0.0, 1.3)
    asked = [delay.value_from_u(float(point[0])) for point in grid_points([delay])]
    assert asked[0] == pytest.approx(0.01) and asked[-1] == pytest.approx(high)
    far = [max(CRITERIA.delay_step_s, 0.11 * one) for one in asked[:-1]]
    assert all(0.0 < step < wide + 1e-9 for step, wide in zip(np.diff(asked), far, strict=True))


def test_the_refined_points_reach_to_the_neighbours_of_the_best() -> None:
    delay = FreeParameter("wind.delay_s", 0.01, 0.8, False, 0.0, 0.0, 1.3)
    begin, asked = scan().find_start([delay]), list[float]()

    class Asked(GridScan):
        def _best_of(self, free: Any, points: Any) -> Any:
            asked.extend(float(point[0]) for point in points)
            return begin

    one = scan()
    Asked(one.problem, one.base, Jacobian({"x": (np.array([0]), [3.0 * T[:, None]])})).refine_start([delay], begin)
    places = sorted(float(point[0]) for point in grid_points([delay]))
    here = int(np.argmin(np.abs(np.array(places) - begin.z[-1])))
    assert min(asked) <= places[max(here - 1, 0)] + 1e-9 and max(asked) >= places[min(here + 1, len(places) - 1)] - 1e-9


def test_no_point_of_a_two_sided_grid_is_neutral_and_small_values_are_in_it() -> None:
    offset = FreeParameter("a.b", -0.3, 0.3, False, 0.0, -0.3, 1.3)
    asked = sorted(offset.value_from_u(float(point[0])) for point in grid_points([offset]))
    assert asked == pytest.approx([-0.3, -0.09, -0.03, -0.009, 0.009, 0.03, 0.09, 0.3])


FACTOR_EFFECTS = tuple(one for one in nuisance.DRIFTS if catalogue()[one.effect].neutral[one.parameter] == 1.0)
FELT = 40.0 * np.sin(9.0 * T)  # by the logarithm of the factor


@cache
def factor(name: str, parameter: str) -> FreeParameter:
    effect = catalogue()[name]
    return free_parameter_from_prior("g.size", effect.priors[parameter], effect.neutral[parameter])


class Factor(FakeResidualModel):
    """A car that differs by a factor only; recalibration may move the same one by 3 deviations."""

    prior_precision = staticmethod(prior)
    joint_bounds = staticmethod(lambda keys, _: np.zeros((0, len(keys))))

    def __init__(self, truth: float, sigma: float) -> None:
        self.truth, self.sigma, self.residual_model = truth, sigma, self

    def simulate_residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        return {"x": [FELT * np.log(values.get("g.size", 1.0) / self.truth)]}

    def whiten(self, name: str, residual: list[np.ndarray], colour: NoiseModel) -> tuple[np.ndarray, np.ndarray]:
        return residual[0], np.zeros(ROWS, dtype=np.int64)

    def non_holdout_blocks(self) -> np.ndarray:
        return np.array([0])

    def parameter_values(self, keys: Any, z: np.ndarray, free: Any) -> dict[str, float]:
        own = {one.key: one for one in free}
        told = zip(keys, map(float, z), strict=True)
        return {key: own[key].value_from_u(at) if key in own else 1.0 + self.sigma * at for key, at in told}

    def scan(self) -> GridScan:
        """Beside the recalibrated model."""
        z = np.array([np.clip((self.truth - 1.0) / self.sigma, -3.0, 3.0)])
        values = self.parameter_values(("g.size",), z, ())
        residuals = self.simulate_residuals(values)
        sums = {
            "x": NormalEquations(
                np.array([0]), np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1, 1)), np.full(1, ROWS), COLOUR
            )
        }
        slopes = Jacobian({"x": (np.array([0]), [self.sigma * FELT[:, None] / values["g.size"]])})
        return GridScan(self, Fit("", ("g.size",), z, (), values, np.eye(1), sums, residuals), slopes)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("drift", FACTOR_EFFECTS, ids=lambda one: one.effect)
def test_a_factor_beyond_recalibration_passes_the_screening_wherever_it_lies(
    drift: nuisance.Drift,
) -> None:
    one, sigma = factor(drift.effect, drift.parameter), drift.sigma
    for truth in np.exp(np.linspace(np.log(one.low), np.log(one.high), 60)):
        if abs(truth - 1.0) > 3.0 * sigma:  # what is nearer is a matter of recalibration
            found = Factor(float(truth), sigma).scan().find_start([one])
            assert found.gain > SCREENING.min_gain, (truth, found)
            widest = np.log(one.high / one.low) / (CRITERIA.logarithmic_points - 1)
            assert abs(np.log(one.value_from_u(float(found.z[-1])) / truth)) <= max(0.5 * widest, 3.0 * sigma) + 1e-9


def test_a_factor_has_points_near_neutral_beside_its_regular_grid() -> None:
    one = factor("brake_gain", "gain_frac")
    asked = [one.value_from_u(float(point[0])) for point in grid_points([one])]
    assert len(asked) == CRITERIA.logarithmic_points + 2 * len(NEAR_NEUTRAL_SHARES)
    assert min(value for value in asked if value > 1.003) < 1.03 and max(v for v in asked if v < 0.999) > 0.97


def test_selected_columns_of_a_jacobian_are_numbered_anew() -> None:
    slopes = Jacobian({"x": (np.array([0, 2]), [np.array([[1.0, 2.0]])])})
    columns, pieces = select_columns(slopes, [1, 2]).by_target["x"]
    assert columns.tolist() == [1] and pieces[0].tolist() == [[2.0]]


def test_beside_a_latency_its_own_clock_is_not_recalibrated() -> None:
    one = scan()
    one.base = one.base._replace(keys=("a", "clock.ins_s"))
    assert [one.kept_columns([WIND._replace(key=late)]) for late in RECALIBRATION_TWINS] == [
        [0],
        [0],
    ] and one.kept_columns([WIND]) == [0, 1]


@pytest.mark.parametrize(("key", "clock_s", "place"), [("ins_latency", 0.01, 0.01), ("report_latency", -0.01, 0.01)])
def test_a_latency_begins_where_recalibration_has_put_its_clock(key: str, clock_s: float, place: float) -> None:
    """A late INS and late reports move the same clock to either side."""
    one = scan()
    one.base = one.base._replace(values={"clock.ins_s": clock_s})
    late = WIND._replace(key=f"{key}.delay_s", low=0.0, high=0.1, u_min=-0.35, u_max=1.35)
    assert late.value_from_u(float(one._twin_points([late])[0][0])) == pytest.approx(place)


REACH, STOP = 8.0, 7.8  # what the signal comes to, and where it stops
LIMIT = FreeParameter("stop.size", 0.0, 20.0, False, np.inf, -0.3, 1.3)


class Stopped(FakeResidualModel):
    """A signal with a limit below its maximum; a grid from 0 to 20 has a point at 7.3 and the next at 9.1."""

    asked = 0

    def simulate_residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        self.asked += 1
        signal = REACH * np.sin(9.0 * T)
        return {"x": [np.minimum(signal, 20.0 * values.get("stop.size", np.inf)) - np.minimum(signal, STOP)]}


@pytest.mark.parametrize("reached", [True, False])
def test_a_limit_that_is_hardly_reached_is_found_between_the_grid_points(
    reached: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = Stopped()
    monkeypatch.setattr(FakeProblem, "residual_model", work)
    if not reached:
        monkeypatch.setattr("tests.gap.estimation.test_grid.STOP", 2.0 * REACH)
    one = scan()
    one = GridScan(one.problem, one.base._replace(residuals=work.simulate_residuals({})), one._jacobian)
    found, asked = one.find_start([LIMIT]), work.asked
    if reached:
        assert 20.0 * found.z[-1] == pytest.approx(STOP, abs=0.1)
        assert found.gain > 0.5 * float(np.sum(work.simulate_residuals({})["x"][0] ** 2)) > 0.0
    else:
        assert found.gain == pytest.approx(0.0, abs=1e-9) and 20.0 * found.z[-1] > REACH
    assert asked < 3 * CRITERIA.linear_points + 20


def test_a_limit_that_acts_strongly_is_left_to_its_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.gap.estimation.test_grid.STOP", 3.0)
    work = Stopped()
    monkeypatch.setattr(FakeProblem, "residual_model", work)
    one = scan()
    one = GridScan(one.problem, one.base._replace(residuals=work.simulate_residuals({})), one._jacobian)
    asked = work.asked
    assert (
        20.0 * one.find_start([LIMIT]).z[-1] == pytest.approx(3.0, abs=1.0)
        and work.asked - asked == CRITERIA.linear_points + 1
    )


def test_the_largest_effect_of_a_grid_is_a_share_of_the_signal() -> None:
    still = FreeParameter("still.size", 0.0, 1.0, False, 0.0, 0.0, 1.3)
    bent = float(np.sqrt(np.mean(BENT**2)))
    assert scan().find_start([WIND]).max_effect_share == pytest.approx(0.5 * bent), "the farthest point"
    assert scan().find_start([still]).max_effect_share == 0.0


DRAGGED = 4000
ROUGH = np.random.default_rng(3).normal(0.0, 0.05, DRAGGED)  # m/s^2
PULL = 0.3  # m/s^2, what a constant force that the start lacks takes: six times the noise
SEEN = np.ones(DRAGGED, dtype=bool)


class Dragged(FakeResidualModel):
    """A car with a constant force; `wind.size` is the share of it in the model."""

    def simulate_residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        return {"x": [ROUGH + PULL * (values.get("wind.size", 0.0) / TRUTH - 1.0)]}

    def non_holdout_rows(self, name: str) -> list[np.ndarray]:
        return [SEEN]

    def whiten(self, name: str, residual: list[np.ndarray], colour: NoiseModel) -> tuple[np.ndarray, np.ndarray]:
        found = whiten_piece(ResidualPiece(residual[0], SEEN), colour.whitening_filter)
        return found.values[found.valid] / colour.sigma, np.zeros(int(found.valid.sum()), dtype=np.int64)

    def fitted(self, values: dict[str, float]) -> Fit:
        """A model with these values, and the noise of its residual."""
        residuals = self.simulate_residuals(values)
        colour = estimate_noise_model([ResidualPiece(residuals["x"][0], SEEN)], 1e-4, 0.02)
        sums = {
            "x": NormalEquations(np.array([0]), np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1, 1)), np.ones(1), colour)
        }
        return Fit("", ("a",), np.zeros(1), (), values, np.eye(1), sums, residuals)


class DraggedProblem(FakeProblem):
    residual_model = Dragged()


def test_a_constant_force_gains_much_under_the_noise_of_a_model_that_has_it() -> None:
    work, free = DraggedProblem.residual_model, [WIND]
    start, slopes = work.fitted({}), Jacobian({"x": (np.array([0]), [np.zeros((DRAGGED, 1))])})
    by_own = GridScan(DraggedProblem(), start, slopes).find_start(free)  # pyright: ignore[reportArgumentType]
    by_best = GridScan(DraggedProblem(), start, slopes, work.fitted({"wind.size": TRUTH})).find_start(free)  # pyright: ignore[reportArgumentType]
    assert by_own.gain < 20.0, "4000 equal rows count as a few"
    assert by_best.gain > 1000.0 and abs(by_best.z[-1] - TRUTH) < 0.1
