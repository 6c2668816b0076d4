"""The prior of the recalibrated parameters from a model's own logs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from tests.gap.estimation.test_intervals import ALL, BLOCKS, ROWS
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.gap.estimation.calibration_priors import (
    NO_PRIOR,
    CalibrationPrior,
    _posterior_from_blocks,
    apply_calibration_prior,
    card_entry_from_prior,
    prior_from_fit,
    read_calibration_prior,
)
from tunefree_hil.gap.estimation.least_squares import Fit, NormalEquations
from tunefree_hil.gap.estimation.noise import NoiseModel
from tunefree_hil.gap.estimation.nuisance import Nuisance, prior_correlation
from tunefree_hil.gap.validation.repair import apply_own_numbers
from tunefree_hil.learn.model_folder import model_toml_from_spec
from tunefree_hil.plant.data_sheet import DEFAULTS

Array = np.ndarray
FORCE, KNEE, WIND = "plant.drive_force_n", "plant.drive_knee_frac", "side_wind.force_n"


def drifting(force: float, knee: float, drift: float) -> list[Nuisance]:
    """Two parameters of the car with these doubts of its calibration, and one of the day."""
    return [
        Nuisance(FORCE, 0.0, float(np.hypot(force, drift)), force, "drive_force_n", 1.0, drift),
        Nuisance(WIND, 0.0, 8.0, 0.0, "", 1.0, 8.0),
        Nuisance(KNEE, 0.0, float(np.hypot(knee, drift)), knee, "drive_knee_frac", 1.0, drift),
    ]


def together(some: list[Nuisance], r: float) -> Array:
    return prior_correlation(some, {"drive_force_n": {"drive_knee_frac": r}, "drive_knee_frac": {"drive_force_n": r}})


def at_once(some: list[Nuisance], r: float, left: float, z: Array) -> tuple[Array, Array]:
    """(mean, covariance) of a later day's two numbers where the own day's posterior is at z with `left` of its prior:
    by the joint normal of both days and a measurement that would leave just that.
    """
    told, drift = np.array([some[0].calibration_sigma, some[2].calibration_sigma]), some[0].drift_sigma
    car = np.array([[1.0, r], [r, 1.0]]) * np.outer(told, told)
    day = car + drift**2 * np.eye(2)
    noise = day * left / (1.0 - left)
    measured = z * np.sqrt(np.diag(day)) / (1.0 - left)
    gain = np.linalg.solve(day + noise, car).T
    return gain @ measured, day - gain @ car


def null(some: list[Nuisance], r: float, curve: Array, z: Array, differ: float | Array = 0.0) -> Fit:
    """Own logs that know two numbers by a curvature [2, 2]. differ: by how many deviations their blocks disagree; or
    the covariance [2, 2] of the scores that they sum up to.
    """
    pulls = np.random.default_rng(2).standard_normal((BLOCKS, 2))
    pulls -= pulls.mean(axis=0)
    if np.ndim(differ):
        white = np.linalg.solve(np.linalg.cholesky(pulls.T @ pulls), pulls.T).T
        pulls = white @ np.linalg.cholesky(differ).T * np.sqrt((BLOCKS - 1) / BLOCKS)
    else:
        pulls = differ * np.sqrt(np.diag(curve) / BLOCKS) * pulls / pulls.std(axis=0)
    curves = np.tile(curve / BLOCKS, (BLOCKS, 1, 1))
    sums = NormalEquations(np.array([0, 2]), np.ones(BLOCKS), pulls, curves, np.full(BLOCKS, ROWS),
                NoiseModel(np.array([1.0]), 1.0, 1.0))  # fmt: skip
    keys = tuple(one.key for one in some)
    prior = np.linalg.inv(together(some, r))
    return Fit("", keys, np.array([z[0], 0.3, z[1]]), (), {}, prior, {"speed": sums}, {})


def both(some: list[Nuisance], correlated: Array) -> Array:
    """Covariance of the car's two parameters, shape (2, 2)."""
    sigma = np.array([one.sigma for one in some])[[0, 2]]
    return correlated[np.ix_([0, 2], [0, 2])] * np.outer(sigma, sigma)


@given(
    st.floats(0.005, 0.1), st.floats(0.005, 0.1), st.floats(0.001, 0.02), st.floats(-0.95, 0.95), st.floats(0.05, 0.8),
    st.floats(-2.0, 2.0), st.floats(-2.0, 2.0),
)  # fmt: skip
def test_a_later_day_has_the_posterior_of_the_joint_normal_of_both_days(
    force: float, knee: float, drift: float, r: float, left: float, a: float, b: float
) -> None:
    some, z = drifting(force, knee, drift), np.array([a, b])
    inner = np.linalg.inv(together(some, r)[np.ix_([0, 2], [0, 2])])
    own = prior_from_fit(null(some, r, inner * (1.0 - left) / left, z), some, ALL)
    mean, covariance = at_once(some, r, left, z)
    assert list(own.offset) == pytest.approx(list(mean), rel=1e-6, abs=1e-12)
    found, correlated = apply_calibration_prior(some, together(some, r), own)
    assert both(found, correlated) == pytest.approx(covariance, rel=1e-6, abs=1e-12)
    assert found[1] == some[1] and correlated[1, 0] == 0.0, "an effect of the day is unchanged"
    for one, was in zip(found, some, strict=True):
        assert not was.calibration_sigma or drift * (1.0 - 1e-9) <= one.sigma <= was.sigma * (1.0 + 1e-9)
        assert (
            one.sigma == pytest.approx(np.hypot(one.calibration_sigma, one.drift_sigma)) and one.neutral == was.neutral
        )


def test_logs_without_information_change_nothing() -> None:
    some = drifting(0.03, 0.05, 0.004)
    prior = together(some, 0.9)
    silent = prior_from_fit(null(some, 0.9, np.zeros((2, 2)), np.zeros(2)), some, ALL)
    for own in (NO_PRIOR, silent, CalibrationPrior(("plant.what_it_had_once",), np.ones(1), np.ones((1, 1)))):
        found, correlated = apply_calibration_prior(some, prior, own)
        assert [one.sigma for one in found] == pytest.approx([one.sigma for one in some])
        assert correlated == pytest.approx(prior)
    assert silent.offset == pytest.approx([0.0, 0.0])


def test_the_joint_effect_of_two_parameters_is_known_though_neither_is() -> None:
    """A tenth of the drive force is no recalibration where the own logs know force and knee along one line only."""
    some = drifting(0.08, 0.08, 0.004)
    across = np.array([1.0, -1.0]) / 2.0**0.5
    own = prior_from_fit(null(some, 0.0, 0.08**2 / 0.002**2 * np.outer(across, across), np.zeros(2)), some, ALL)
    found, correlated = apply_calibration_prior(some, np.eye(3), own)
    assert min(found[0].sigma, found[2].sigma) > 0.05
    assert across @ both(found, correlated) @ across == pytest.approx(3.6e-5, rel=0.02), "both days' drift, and 0.002"


def test_own_logs_count_as_far_as_their_blocks_agree() -> None:
    some = drifting(0.03, 0.03, 0.004)
    curve, z = np.diag([100.0, 0.0]), np.array([0.7, 0.0])
    sure, unsure, nobody = (prior_from_fit(null(some, 0.0, curve, z, by), some, ALL) for by in (0.0, 5.0, 50.0))
    assert sure.keys == (FORCE, KNEE) and sure.offset[0] == pytest.approx(0.7 * some[0].sigma, rel=0.02)
    believed = 1.0 / (1.0 + 5.0**2 * BLOCKS / (BLOCKS - 1))  # of what they know, in the only direction that they know
    by = [(one.covariance[0, 0] - some[0].drift_sigma ** 2) / some[0].sigma ** 2 for one in (sure, unsure)]
    assert by == pytest.approx([1.0 / 101.0, 1.0 / (1.0 + 100.0 * believed)], rel=0.1)
    measure_sensitivity = 101.0 * believed / (1.0 + 100.0 * believed)  # by the same measurement, that much weaker
    assert unsure.offset[0] == pytest.approx(measure_sensitivity * sure.offset[0], rel=0.01)
    assert abs(nobody.offset[0]) < 0.05 * abs(sure.offset[0]), (
        "blocks that disagree as much as that say next to nothing"
    )


@pytest.mark.parametrize("leans", [-0.07, 0.07])
def test_a_known_parameter_is_not_moved_by_one_with_little_information(leans: float) -> None:
    """It does not turn round, and goes hardly farther: a third, as the noise of both leans the one way, that of the
    second against it.
    """
    some = drifting(0.03, 0.03, 1e-6)
    known, blurred, z = np.diag([1.0 / 1.9, 1.0 / 1.01]), np.array([[0.3, leans], [leans, 0.02]]), np.array([0.3, 0.1])
    sharp = np.linalg.inv(known)
    own = prior_from_fit(null(some, 0.0, sharp - np.eye(2), z, sharp @ blurred @ sharp), some, ALL)
    assert 0.0 < own.offset[0] / 0.03 < 1.5 * z[0] and abs(own.offset[1]) / 0.03 < z[1]


@given(*(st.floats(low, high) for low, high in ((0.0, 50.0), (0.0, 5.0), (-0.9, 0.9)) * 2))
def test_no_other_weight_of_inconsistent_blocks_has_a_smaller_error(
    a: float, b: float, r: float, c: float, d: float, q: float
) -> None:
    """theta of the prior, a score J theta + e of covariance J + M: the mean square of what is left is what is stated,
    and not more than the fit leaves that trusts its noise.
    """
    some = drifting(0.03, 0.03, 1e-6)
    j, m = (np.array([[x, k * (x * y) ** 0.5], [k * (x * y) ** 0.5, y]]) for x, y, k in ((a, b, r), (c, d, q)))
    j, m, trusts = j + 0.01 * np.eye(2), m + 0.01 * np.eye(2), np.linalg.inv(j + 1.01 * np.eye(2))

    def left(by: Array) -> float:
        return float(np.trace((by @ j - np.eye(2)) @ (by @ j - np.eye(2)).T + by @ (j + m) @ by.T))

    each = [prior_from_fit(null(some, 0.0, j, trusts @ score, m), some, ALL) for score in np.eye(2)]
    share = 2.0 / (BLOCKS + 1.0)  # what is drawn to the average of both
    m = (1.0 - share) * m + share * float(np.trace(np.linalg.solve(j, m))) / 2.0 * j
    mine = np.stack([one.offset for one in each], axis=1) / 0.03
    assert left(mine) <= left(trusts) * (1.0 + 1e-6)
    assert float(np.trace(each[0].covariance)) / 0.03**2 == pytest.approx(left(mine), rel=1e-4)


@pytest.mark.parametrize(("judged", "drifts"), [(6, 0.0), (6, 1.0), (9, 1.0), (30, 1.0)])
def test_with_fewer_blocks_than_parameters_the_posterior_is_not_too_narrow(judged: int, drifts: float) -> None:
    """Sixteen numbers; of a minute there are six blocks, each of which tells five directions, each otherwise."""
    chance, size, squares, turned = np.random.default_rng(1), 16, list[Array](), list[Array]()
    for _ in range(100):
        roots = [chance.standard_normal((size, 5)) * 10.0 ** chance.uniform(0.0, 0.5) for _ in range(judged)]
        theta = chance.standard_normal(size)
        each = [theta + drifts * chance.standard_normal(size) for _ in roots]
        scores = np.array(
            [root @ (root.T @ one + chance.standard_normal(5)) for root, one in zip(roots, each, strict=True)]
        )
        pulls = scores - scores.mean(axis=0)
        sharp = np.linalg.inv(sum(root @ root.T for root in roots) + np.eye(size))
        mean, blurred = sharp @ scores.sum(axis=0), sharp @ (judged / (judged - 1.0) * pulls.T @ pulls) @ sharp
        found, known = _posterior_from_blocks(np.eye(size), sharp, blurred, mean, judged)
        squares.append((found - theta) ** 2 / np.diag(known))
        turned.append((found * mean < 0.0) & (np.minimum(np.abs(mean), np.abs(found)) > 0.3))
    assert np.mean(squares) < 1.3 and np.mean(turned) < 0.015


def carded(folder: Path, card: dict[str, Any]) -> ModelSpec:
    model = load_model("mkz_nominal")
    (folder / "card.json").write_text(json.dumps(card))
    return replace(model, folder=str(folder), plant=replace(model.plant, card="card.json"))


def test_a_prior_is_read_from_a_card_as_it_was_written(tmp_path: Path) -> None:
    some = drifting(0.03, 0.03, 0.004)
    own = prior_from_fit(null(some, 0.0, np.diag([100.0, 0.0]), np.array([0.7, 0.0])), some, ALL)
    back = read_calibration_prior(carded(tmp_path, {"seed": 1, **card_entry_from_prior(own)}))
    assert back.keys == own.keys and (back.offset == own.offset).all() and (back.covariance == own.covariance).all()
    assert read_calibration_prior(carded(tmp_path, {"seed": 1, **card_entry_from_prior(NO_PRIOR)})) is NO_PRIOR


def test_a_model_is_moved_to_the_values_of_its_own_logs(tmp_path: Path) -> None:
    keys = ("brake_gain.gain_frac", FORCE, "friction.friction_frac", "linkage.bend")
    own = CalibrationPrior(keys, np.array([-0.02, 0.08, 0.2, 0.01]), np.eye(4))
    model, vehicle = carded(tmp_path, card_entry_from_prior(own)), load_vehicle("mkz_bywire")
    there = apply_own_numbers(model, vehicle)
    before, after = ({**DEFAULTS, **one.plant.params} for one in (model, there))
    assert after["brake_force_n_per_frac"] == pytest.approx(0.98 * before["brake_force_n_per_frac"])
    assert after["drive_force_n"] == pytest.approx(np.exp(0.08) * before["drive_force_n"])
    assert after["linkage_bend"] == pytest.approx(before["linkage_bend"] + 0.01)
    assert [(one.name, one.params, one.provenance) for one in there.effects[len(model.effects) :]] == [
        ("friction", {"friction_frac": pytest.approx(1.2)}, {"by": "recalibration"})
    ]
    assert (there.hash, there.folder) == (model.hash, model.folder) and model_toml_from_spec(there)
    plain = carded(tmp_path, {"seed": 1})
    assert apply_own_numbers(plain, vehicle) is plain


@pytest.mark.parametrize(
    "said",
    [3, {"keys": [], "off": [], "covariance": []}, {"keys": ["a"]},
     {"keys": ["a"], "off": [0.1, 0.2], "covariance": [[1.0]]},
     {"keys": ["a"], "off": [float("nan")], "covariance": [[1.0]]},
     {"keys": ["a"], "off": [0.1], "covariance": [[-1.0]]},
     {"keys": ["a"], "off": ["much"], "covariance": [[1.0]]}],
)  # fmt: skip
def test_an_invalid_card_is_an_input_error(tmp_path: Path, said: object) -> None:
    with pytest.raises(InputError) as refused:
        read_calibration_prior(carded(tmp_path, {"own_numbers": said}))
    assert refused.value.code == "bad_card" and "own_numbers" in refused.value.message
