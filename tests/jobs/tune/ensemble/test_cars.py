"""The cars of a bench file as jobs: ranges, intervals of the model, effects and scales."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from tests.bench.tiny import write_bench
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load, model_of, parameters_of
from tunefree_hil.bench.scaling import mass_of
from tunefree_hil.bench.simulator import Simulator
from tunefree_hil.config.schema import EffectSpec, Interval
from tunefree_hil.config.tuning.ensemble_schema import EnsembleSpec
from tunefree_hil.jobs.tune.ensemble.cars import EnsembleCars, car_ranges

ALIKE = EnsembleSpec(dead_time=[1.0, 1.0], lag=[1.0, 1.0], mass=[1.0, 1.0], friction=[1.0, 1.0], steer_gain=[1.0, 1.0])


def test_a_car_is_a_job_with_its_factors(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path))
    spec = EnsembleSpec(cars=4)
    cars = EnsembleCars(bench, spec, bench.spec.model, 1)
    road = bench.scenarios["tiny"]
    plain, *others = [cars.job({}, road, car) for car in cars.cars]
    assert (dict(plain.effects), dict(plain.scale), plain.seed) == ({}, {}, None)
    mass_kg = mass_of(model_of(bench, bench.spec.model))
    for job, car in zip(others, cars.cars[1:], strict=True):
        assert job.effects["payload"]["mass_kg"] == pytest.approx((car.variant.mass - 1.0) * mass_kg)
        assert job.effects["friction"] == {"friction_frac": car.variant.friction}
        assert job.effects["steer_gain"] == {"gain_frac": car.variant.steer_gain}
        assert {name: job.scale[name] for name in ("dead_time", "lag")} == {
            "dead_time": car.variant.dead_time,
            "lag": car.variant.lag,
        }
        assert set(job.effects) <= set(cars.effects)


def test_the_jobs_can_be_driven_and_differ(tmp_path: Path) -> None:
    """Interpreted, on the real plant."""
    bench = load(write_bench(tmp_path, duration_s=1.0))
    cars = EnsembleCars(bench, EnsembleSpec(cars=3), bench.spec.model, 1)
    simulator = Simulator(bench, extra_effects=cars.effects)
    errors = []
    for car in cars.cars:
        drive = simulator.drive(cars.job(parameters_of(bench), bench.scenarios["tiny"], car))
        assert not drive.error
        errors.append(float(drive.recording.columns["lateral_error_m"][-1]))
    assert len(set(errors)) == 3


def test_intervals_of_the_model_are_factors_on_its_numbers(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path))
    model = model_of(bench, bench.spec.model)
    steer = replace(
        model.actuators["steer"],
        dead_time_s=Interval(value=0.1, low=0.08, high=0.15),
        gain=Interval(value=1.0, low=0.9999, high=1.0001),
        rate_limit=Interval(value=8.0, low=7.0, high=float("inf")),
        offset=Interval(value=0.0, low=-0.1, high=0.1),
    )
    effect = EffectSpec(
        name="brake_dead_band", params={"half_width_frac": 0.05}, interval={"half_width_frac": [0.04, 0.07]}
    )
    stated = replace(model, actuators={**model.actuators, "steer": steer}, effects=[effect])
    numbers = car_ranges(ALIKE, stated).numbers
    assert set(numbers) == {"steer.dead_time_s", "brake_dead_band.half_width_frac"}
    assert numbers["steer.dead_time_s"] == pytest.approx((0.8, 1.5))
    assert numbers["brake_dead_band.half_width_frac"] == pytest.approx((0.8, 1.4))
    assert not car_ranges(EnsembleSpec(model_intervals=False), stated).numbers


def test_cars_that_would_all_be_the_same_are_refused(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path))
    model = model_of(bench, bench.spec.model)
    with pytest.raises(InputError) as caught:
        car_ranges(replace(ALIKE, model_intervals=False), model)
    assert caught.value.code == "bad_ensemble"
