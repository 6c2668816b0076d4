"""The vehicle of a commission: the same car where it is collected from, verified on, and driven for `gap`."""

from __future__ import annotations

from pathlib import Path

from tests.bench.tiny import write_bench
from tests.jobs.made_chain import asked
from tunefree_hil.bench import load
from tunefree_hil.config.load import load_bench, load_model
from tunefree_hil.jobs.collect.plan import resolve_setup
from tunefree_hil.jobs.commission.plan import make_collect_options, make_plan
from tunefree_hil.jobs.commission.vehicle import VEHICLE, write_vehicle
from tunefree_hil.jobs.options.records import CommissionOptions

__all__ = ["asked"]  # a fixture
LATE = '[[effects]]\nname = "steer_lag"\nparams = { tau_s = 0.2 }\n'


def test_it_is_the_verify_model_with_the_effects_of_the_bench_behind_its_own(tmp_path: Path) -> None:
    spec = load_bench(write_bench(tmp_path, more=LATE))
    made, own = load_model(write_vehicle(tmp_path / "v", spec)), load_model(spec.verify_model)
    assert [(one.name, one.params) for one in made.effects] == [
        *((one.name, one.params) for one in own.effects), ("steer_lag", {"tau_s": 0.2}),
    ]  # fmt: skip
    assert (made.plant.params, made.actuators, made.noise) == (own.plant.params, own.actuators, own.noise)
    text = (tmp_path / "v" / "model.toml").read_bytes()
    assert (write_vehicle(tmp_path / "v", spec) / "model.toml").read_bytes() == text


def test_what_is_verified_on_is_what_was_collected_from(asked: CommissionOptions, tmp_path: Path) -> None:
    plan = make_plan(asked._replace(bench=write_bench(tmp_path, more=LATE)))
    plan.folder.mkdir()
    bench = load(plan.write_bench())
    verified = [(one.name, one.params) for one in load_model(bench.spec.verify_model).effects]
    _, model, effects = resolve_setup(make_collect_options(plan.options, Path(plan.template.path), None))
    collected = [(one.name, one.params) for one in load_model(model).effects]
    assert verified == [*collected, *((one["name"], one["params"]) for one in effects)] and verified
    assert bench.spec.effects == [], "the learned plant is tuned on without them"


def test_a_bench_without_effects_is_verified_on_its_own_vehicle(asked: CommissionOptions, tmp_path: Path) -> None:
    plan = make_plan(asked._replace(bench=write_bench(tmp_path)))
    plan.folder.mkdir()
    assert load(plan.write_bench()).spec.verify_model == "mkz_nominal" and not (plan.folder / VEHICLE).exists()
