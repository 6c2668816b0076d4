"""A scaled model is the model with other numbers: the drive is that of a folder in which those numbers stand."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.bench.tiny import write_bench
from tests.house import ROOT
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, load, model_of, parameters_of
from tunefree_hil.bench.scaling import mass_of, model_numbers, own_times, scaled
from tunefree_hil.bench.simulator import Job, SimulatedDrive, Simulator
from tunefree_hil.config.schema import ActuatorSpec, Interval, value_of
from tunefree_hil.jobs.tune.margins import EFFECTS
from tunefree_hil.plant import reference


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return load(write_bench(tmp_path_factory.mktemp("scaling"), duration_s=1.5))


def folder_with(bench: Bench, model: str, name: str, factors: dict[str, float]) -> str:
    """A copy of a model folder beside the bench file in which some keys are multiplied; its name."""
    target = Path(bench.file).parent / "models" / name
    shutil.copytree(ROOT / "bench_configs" / "models" / model, target)
    text = (target / "model.toml").read_text()
    for key, factor in factors.items():
        text, count = re.subn(rf"(?m)^({key} = )([0-9.]+)", lambda m, f=factor: f"{m[1]}{float(m[2]) * f!r}", text)
        assert count
    (target / "model.toml").write_text(text)
    return name


def driven(bench: Bench, model: str, job: Job, extra: tuple[str, ...] = ()) -> SimulatedDrive:
    return Simulator(bench, model, extra).drive(job)


def same(first: SimulatedDrive, second: SimulatedDrive) -> bool:
    one, two = first.recording.columns, second.recording.columns
    return one.keys() == two.keys() and all(np.array_equal(one[key], two[key], equal_nan=True) for key in one)


def job_of(bench: Bench, **more: object) -> Job:
    return Job(parameters_of(bench), bench.scenarios["tiny"])._replace(**more)


@pytest.mark.parametrize(
    ("model", "scale", "keys"),
    [
        ("mkz_nominal", {"dead_time": 1.4, "lag": 0.6}, {"dead_time_s": 1.4, "lag_s": 0.6}),
        ("mkz_reference", {"dead_time": 0.6}, {f"{key}_dead_time_s": 0.6 for key in ("steer", "throttle", "brake")}),
        ("mkz_reference", {"lag": 1.2}, {key: 1.2 for key in reference.PLANT.lags}),
    ],
)
def test_scaled_in_memory_or_in_the_folder_is_one_car(
    bench: Bench, model: str, scale: dict[str, float], keys: dict[str, float]
) -> None:
    job = job_of(bench)
    name = folder_with(bench, model, f"{model}_{'_'.join(scale)}", keys)
    changed = driven(bench, model, job._replace(scale=scale))
    assert same(changed, driven(bench, name, job)) and not same(changed, driven(bench, model, job))


def test_extra_effects_and_a_scale_of_one_change_no_bit(bench: Bench) -> None:
    plain = driven(bench, "mkz_nominal", job_of(bench))
    assert same(plain, driven(bench, "mkz_nominal", job_of(bench), EFFECTS))
    assert same(plain, driven(bench, "mkz_nominal", job_of(bench, scale={"dead_time": 1.0, "lag": 1.0}), EFFECTS))
    neutral = {"steer_dead_time": {"delay_s": 0.0}, "steer_gain": {"gain_frac": 1.0}, "payload": {"mass_kg": 0.0},
               "friction": {"friction_frac": 1.0}}  # fmt: skip
    assert same(plain, driven(bench, "mkz_nominal", job_of(bench, effects=neutral), EFFECTS))


def test_one_simulator_keeps_changed_cars_apart(bench: Bench) -> None:
    simulator = Simulator(bench, "mkz_nominal", EFFECTS)
    jobs = [job_of(bench), job_of(bench, scale={"lag": 1.4}), job_of(bench, scale={"dead_time": 1.4}),
            job_of(bench, effects={"steer_dead_time": {"delay_s": 0.04}})]  # fmt: skip
    first, again = ([simulator.drive(job) for job in jobs] for _ in range(2))
    assert all(same(one, two) for one, two in zip(first, again, strict=True))
    assert not any(same(first[i], first[j]) for i in range(4) for j in range(i))


def test_steer_dead_time_on_top_is_a_model_with_so_much_more(bench: Bench) -> None:
    """0.1 s and 40 ms more for the steering are 0.14 s."""
    target = Path(bench.file).parent / "models" / "later"
    shutil.copytree(ROOT / "bench_configs" / "models" / "mkz_nominal", target)
    text = (target / "model.toml").read_text()
    (target / "model.toml").write_text(text.replace("dead_time_s = 0.1\n", "dead_time_s = 0.14\n"))
    late = driven(bench, "mkz_nominal", job_of(bench, effects={"steer_dead_time": {"delay_s": 0.04}}), EFFECTS)
    assert same(late, driven(bench, "later", job_of(bench)))


def test_intervals_and_second_order_are_scaled_too(bench: Bench) -> None:
    from msgspec.structs import replace

    model = model_of(bench, "mkz_nominal")
    spec = ActuatorSpec(dead_time_s=Interval(value=0.1, low=0.09, high=0.11), order=2, natural_hz=2.0, damping=0.7)
    one = scaled(replace(model, actuators={"steer": spec}), {"dead_time": 1.2, "lag": 1.25}).actuators["steer"]
    assert (one.dead_time_s, one.natural_hz, one.damping, one.order) == (pytest.approx(0.12), 1.6, 0.7, 2)


def test_what_cannot_be_scaled_is_named(bench: Bench) -> None:
    model = model_of(bench, "mkz_nominal")
    assert scaled(model, {}) is model and own_times(model) is None
    for wrong in ({"mass": 1.1}, {"lag": 0.0}, {"lag": float("nan")}, {"dead_time": -1.0}):
        with pytest.raises(InputError, match="scales nothing"):
            scaled(model, wrong)


def test_a_plant_of_ones_own_says_what_it_is_asked_for_or_is_named(bench: Bench, tmp_path: Path) -> None:
    from msgspec.structs import replace

    (tmp_path / "own.py").write_text(
        "from tunefree_hil.plant.reference import PLANT as full\n"
        "PLANT = full._replace(lags=(), defaults={})\n"
    )  # fmt: skip
    model = model_of(bench, "mkz_reference")
    own = replace(model, plant=replace(model.plant, kind=f"{tmp_path}/own.py:PLANT", params={}))
    with pytest.raises(InputError) as caught:
        scaled(own, {"lag": 1.1})
    assert "lag" in caught.value.message and "PLANT.lags" in caught.value.hint
    with pytest.raises(InputError, match="mass_kg"):
        mass_of(own)
    assert mass_of(model) == 1736.35 and mass_of(model_of(bench, "mkz_nominal")) == 2080.0


def test_single_numbers_of_a_model_have_factors_of_their_own(bench: Bench) -> None:
    model = model_of(bench, "mkz_learned")
    name = "brake_dead_band.half_width_frac"
    changed = scaled(model, {"steer.dead_time_s": 1.5, name: 0.5, "lag": 2.0})
    before, after = model.actuators["steer"], changed.actuators["steer"]
    assert after.dead_time_s == pytest.approx(1.5 * value_of(before.dead_time_s))
    assert after.natural_hz == pytest.approx(0.5 * value_of(before.natural_hz))
    assert changed.actuators["brake"].dead_time_s == value_of(model.actuators["brake"].dead_time_s)
    assert changed.effects[0].params["half_width_frac"] == 0.5 * model.effects[0].params["half_width_frac"]
    known = model_numbers(model)[name]
    assert isinstance(known, Interval) and known.low < known.value < known.high


@pytest.mark.parametrize("scale", [{"steer.mass": 1.1}, {"wings.lag_s": 1.1}, {"steer.gain": float("nan")}])
def test_a_number_that_the_model_does_not_have_is_refused(bench: Bench, scale: dict[str, float]) -> None:
    with pytest.raises(InputError) as caught:
        scaled(model_of(bench, "mkz_learned"), scale)
    assert caught.value.code == "bad_scale" and caught.value.key == next(iter(scale))
