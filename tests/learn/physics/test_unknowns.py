"""A car's shape is fitted where its free runs need it, and left alone where they do not."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import numpy as np
import pytest

from tests.learn.made_drives import REST, made_drive, whole
from tunefree_hil.base.contracts import make_effect
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.effects import powertrain_lag
from tunefree_hil.learn.compiled_process import CompiledProcess
from tunefree_hil.learn.data_sheet import ConstantPrior, make_constant_priors, make_fixed_params
from tunefree_hil.learn.physics import fit as fit_module
from tunefree_hil.learn.physics.fit import NOT_SIGNIFICANT, PhysicsFit, fit_physics, is_significant
from tunefree_hil.learn.physics.unknowns import (
    CRITERIA,
    NO_IMPROVEMENT,
    POWERTRAIN_LAG,
    SHAPE_CONSTANTS,
    PhysicsProblem,
    add_shape_constants,
    reduces_error,
    solve_problem,
)
from tunefree_hil.learn.physics.windows import (
    OutputCorrection,
    WindowSet,
    compute_errors,
    compute_target_rms,
    extract_windows,
)
from tunefree_hil.learn.robust_least_squares import RobustFit
from tunefree_hil.plant.actuation.acceleration_interface import linear
from tunefree_hil.plant.data_sheet import DEFAULTS

VEHICLE = load_vehicle("mkz_bywire")


def driven(truth: dict[str, float], lag_s: float = 0.0) -> WindowSet:
    """Two drives of a car, its push that much behind its throttle."""
    lag = powertrain_lag.EFFECT
    effects = ((lag.port, make_effect(lag, {"tau_s": lag_s}, rest=REST)),) if lag_s else ()
    parts = [whole(made_drive(110.0, seed=seed, params=truth, effects=effects)) for seed in (1, 2)]
    return extract_windows(parts, VEHICLE)


def fitted(some: WindowSet) -> PhysicsFit:
    """A fit of these windows."""
    with CompiledProcess() as worker:
        return worker.wait_for_result(
            fit_physics, some, make_fixed_params(VEHICLE), make_constant_priors(VEHICLE), 0.35
        )


def problem_of(some: WindowSet, known: dict[str, ConstantPrior] | None = None) -> PhysicsProblem:
    """The fit's unknowns, of the reference vehicle where nothing else is said."""
    return PhysicsProblem(some, make_fixed_params(VEHICLE), known or make_constant_priors(VEHICLE), 0.35)


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        ([1.0, 1.0, 1.0, 1.0], False),
        ([0.8, 0.7, 0.8, 0.9], True),
        ([1.0 - 0.9 * CRITERIA.min_error_reduction] * 4, False),
        ([1.6, 0.2, 1.4, 0.4], False),
        ([1.1, 1.2, 1.1, 1.2], False),
    ],
)
def test_what_pays_is_less_by_a_share_and_not_by_chance(after: list[float], expected: bool) -> None:
    assert reduces_error(np.ones(4), np.array(after)) is expected


def test_of_one_stretch_nobody_knows_what_chance_does() -> None:
    assert not reduces_error(np.ones(1), np.zeros(1))


def test_where_there_is_no_shape_to_try_nothing_is_solved_again() -> None:
    """Without pedals, or a car that is asked for an acceleration: the fit stands as it is."""
    some = extract_windows([whole(made_drive(20.0))], VEHICLE)._replace(has_pedals=False)
    problem = problem_of(some)
    assert not {*SHAPE_CONSTANTS} & {*problem.names}
    least = RobustFit(np.zeros(1), np.ones(1), 2.0, np.ones((1, 1)), np.zeros(1), 0.0)
    names, same = add_shape_constants(problem, ["steer_ratio"], least)
    assert names == ["steer_ratio"] and same is least


def test_a_car_that_is_asked_for_an_acceleration_has_the_lag_in_its_channel() -> None:
    some, known = extract_windows([whole(made_drive(20.0))], VEHICLE), make_constant_priors(VEHICLE)
    assert POWERTRAIN_LAG in problem_of(some).names
    asked = problem_of(some, {name: one for name, one in known.items() if name not in linear(1.0, 0.0)})
    assert POWERTRAIN_LAG not in asked.names and not {*SHAPE_CONSTANTS} & {*asked.names}


def test_only_of_what_was_tried_a_card_says_that_it_does_not_pay() -> None:
    some = extract_windows([whole(made_drive(12.0))], VEHICLE)._replace(has_pedals=False)
    with pytest.raises(StopIteration) as end:
        next(fit_physics(some, make_fixed_params(VEHICLE), make_constant_priors(VEHICLE), 0.35))
    for name in SHAPE_CONSTANTS:
        value = end.value.value.estimates[name]
        assert not value.known and value.why.startswith("the logs lack the outputs that it needs"), name
        assert value.is_needed


@pytest.mark.slow
def test_a_motor_that_holds_back_is_no_rolling_resistance() -> None:
    """Coasting alone cannot tell them; the last metres before standstill can, where the one fades and the other not."""
    found = fitted(driven({"overrun_force_n": 900.0, "drive_corner": 12.0, "brake_rise_per_frac": 0.8}))
    overrun, rolling = found.estimates["overrun_force_n"], found.estimates["rolling_frac"]
    assert overrun.known and overrun.low < 900.0 < overrun.high and overrun.high - overrun.low < 900.0
    assert rolling.low < DEFAULTS["rolling_frac"] < rolling.high
    rise, brake = found.estimates["brake_rise_per_frac"], found.estimates["brake_force_n_per_frac"]
    assert rise.known and rise.low < 0.8 < rise.high and rise.low > 0.0
    assert brake.low < DEFAULTS["brake_force_n_per_frac"] < brake.high
    assert found.rms_after["speed_mps"] < 0.05


@pytest.mark.slow
def test_a_plain_car_stays_plain() -> None:
    """What explains nothing lends no doubt to the others."""
    found = fitted(driven({}))
    for name in SHAPE_CONSTANTS:
        value = found.estimates[name]
        assert not value.known and value.value == DEFAULTS.get(name, 0.0) and value.why == NO_IMPROVEMENT
        assert not value.is_needed
        assert found.params.get(name, 0.0) == DEFAULTS.get(name, 0.0)
    assert (
        POWERTRAIN_LAG in SHAPE_CONSTANTS
        and POWERTRAIN_LAG not in found.params
        and found.output_correction().throttle_lag_s == 0.0
    )
    drive = found.estimates["drive_force_n"]
    assert drive.known and drive.high - drive.low < 0.2 * drive.value


@pytest.mark.slow
def test_a_car_that_pushes_late_is_no_rolling_resistance() -> None:
    """Without the lag resistance, drive and brake stand in for it, and the speed is missed all the same."""
    some = driven({}, lag_s=0.3)
    found = fitted(some)
    lag, rolling, truth = found.estimates[POWERTRAIN_LAG], found.estimates["rolling_frac"], DEFAULTS["rolling_frac"]
    assert is_significant(POWERTRAIN_LAG, lag) and lag.low < 0.3 < lag.high and lag.high - lag.low < 0.05
    assert rolling.low < truth < rolling.high and abs(rolling.value / truth - 1.0) < 0.1
    assert found.output_correction().throttle_lag_s == lag.value and found.rms_after["speed_mps"] < 0.05
    without, missed = fitted_without_lag(some)
    assert missed > 5.0 * found.rms_after["speed_mps"]
    assert abs(without["rolling_frac"] / truth - 1.0) > 0.1
    assert without["drive_force_n"] > 1.2 * DEFAULTS["drive_force_n"]
    assert found.estimates["drive_force_n"].value == pytest.approx(DEFAULTS["drive_force_n"], rel=0.03)


@pytest.mark.slow
def test_constants_are_not_fitted_beside_a_lag_that_stays_out_of_the_model() -> None:
    """The error that a card states is that of the model as it is written."""
    some = driven({}, lag_s=0.3)
    with CompiledProcess() as worker:
        words = some, make_fixed_params(VEHICLE), make_constant_priors(VEHICLE), 0.35
        found = worker.wait_for_result(fit_where_no_lag_is_clear, *words)
        written = worker.wait_for_result(
            compute_errors, found.params, found.output_correction(), problem_of(some).windows
        )
    assert not found.estimates[POWERTRAIN_LAG].known and found.output_correction().throttle_lag_s == 0.0
    assert found.estimates[POWERTRAIN_LAG].why == NOT_SIGNIFICANT, "it would have paid"
    assert found.estimates[POWERTRAIN_LAG].is_needed
    assert found.rms_after["speed_mps"] == pytest.approx(compute_target_rms(written)["speed_mps"], rel=0.02)
    assert found.rms_after["speed_mps"] > 0.05, "it is the worse for it, and says so"


def fit_where_no_lag_is_clear(*asked: Any) -> Generator[Any, None, PhysicsFit]:
    """For a process of its own."""
    fit_module.is_significant = lambda name, value: name != POWERTRAIN_LAG and is_significant(name, value)
    return (yield from fit_physics(*asked))


def fitted_without_lag(some: WindowSet) -> tuple[dict[str, float], float]:
    """(constants, missed speed in m/s) of the same free runs with everything fitted but the lag."""
    problem = problem_of(some)
    names = [name for name in problem.names if name != POWERTRAIN_LAG]
    with CompiledProcess() as worker:
        start = np.zeros(len(names))
        least = worker.wait_for_result(solve_problem, problem, names, start, 25)
        values = problem.constants_from_unknowns(names, least.x)
        misses = worker.wait_for_result(compute_errors, problem.params(values), OutputCorrection(), problem.windows)
    return values, compute_target_rms(misses)["speed_mps"]
