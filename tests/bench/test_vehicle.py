"""The simulated vehicle of a bench: plant, effects and driver by name; what does not fit is named."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from msgspec.structs import replace

from tests.bench.tiny import hash_of, write_bench
from tests.house import ROOT
from tunefree_hil.base.contracts import Port
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, VehicleFor, is_heavy, load
from tunefree_hil.bench.vehicle import driver_script, effects_of
from tunefree_hil.config.schema import EffectSpec, FaultSpec
from tunefree_hil.plant.actuation.bywire import ReceivedCommand
from tunefree_hil.plant.ecu import UnitInput
from tunefree_hil.plant.types import NO_DRIVER


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return load(write_bench(tmp_path))


def own_model(folder: Path, old: str, new: str) -> str:
    """A copy of the nominal model in `folder`, changed; its name."""
    target = folder / "models" / "own"
    shutil.copytree(ROOT / "bench_configs" / "models" / "mkz_nominal", target)
    text = (target / "model.toml").read_text()
    assert old in text
    (target / "model.toml").write_text(text.replace(old, new))
    return "own"


def test_an_assignment(bench: Bench, tmp_path: Path) -> None:
    car = VehicleFor(bench, "mkz_nominal")(hash_of(tmp_path), 3)
    assert (car.course.ticks, car.dt_s) == (200, 0.01)
    assert set(car.phases) == {one.name for one in (*bench.codec.telemetry, *bench.codec.commands)}
    assert car.driver(0) == NO_DRIVER


def test_only_the_seed_draws_the_noise(bench: Bench, tmp_path: Path) -> None:
    assign = VehicleFor(bench, "mkz_nominal")

    def seen_with(seed: int) -> list[str]:
        car = assign(hash_of(tmp_path), seed)
        params, state, said = car.unit.start(car.body, car.dt_s)
        seen = [said.measurement]
        for k in range(20):
            x = UnitInput(ReceivedCommand(), car.driver(k), car.course.road_at(k))
            state, said = car.unit.step(params, state, x, car.dt_s)
            seen.append(said.measurement)
        return [repr(one) for one in seen]

    assert seen_with(3) == seen_with(3) != seen_with(4)


def test_an_unknown_plant_kind_lists_those_there_are(bench: Bench, tmp_path: Path) -> None:
    name = own_model(tmp_path, 'kind = "physics"', 'kind = "fysics"')
    with pytest.raises(InputError) as caught:
        VehicleFor(bench, name)
    error = caught.value
    assert (error.code, error.key) == ("unknown_plant", "plant.kind")
    assert error.file == str(tmp_path / "models" / "own" / "model.toml")
    assert "physics, reference, hybrid" in error.message and error.hint


def test_a_plant_of_the_users_own_that_is_not_there(bench: Bench, tmp_path: Path) -> None:
    name = own_model(tmp_path, 'kind = "physics"', f'kind = "{tmp_path}/mine.py:PLANT"')
    with pytest.raises(InputError, match=r"mine\.py does not exist"):
        VehicleFor(bench, name)
    (tmp_path / "mine.py").write_text("OTHER = 1\n")
    with pytest.raises(InputError, match="has no PLANT"):
        VehicleFor(bench, name)


def test_a_plant_of_the_users_own(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("from tunefree_hil.plant.single_track import PLANT\n\nMINE = PLANT\n")
    name = own_model(tmp_path, 'kind = "physics"', f'kind = "{tmp_path}/mine.py:MINE"')
    assert VehicleFor(bench, name)(hash_of(tmp_path), 1).course.ticks == 200


def test_an_unknown_constant_of_the_plant(bench: Bench, tmp_path: Path) -> None:
    name = own_model(tmp_path, "mass_kg = 2080.0", "masss_kg = 2080.0")
    with pytest.raises(InputError, match="masss_kg") as caught:
        VehicleFor(bench, name)
    assert caught.value.file.endswith("models/own/model.toml")


def test_a_constant_that_no_car_has(bench: Bench, tmp_path: Path) -> None:
    name = own_model(tmp_path, "mass_kg = 2080.0", "mass_kg = -5.0")
    with pytest.raises(InputError, match="expected more than 0, got -5") as caught:
        VehicleFor(bench, name)
    assert caught.value.key == "plant.params.mass_kg" and caught.value.file.endswith("models/own/model.toml")


def test_heavy_plants_run_compiled(bench: Bench) -> None:
    assert is_heavy(bench, "mkz_reference") and not is_heavy(bench, "mkz_nominal")


def test_real_time_needs_a_tick_each_way(bench: Bench, tmp_path: Path) -> None:
    name = own_model(tmp_path, "report_ticks = 1", "report_ticks = 0")
    VehicleFor(bench, name)
    with pytest.raises(InputError) as caught:
        VehicleFor(bench, name, realtime=True)
    assert caught.value.key == "timing" and caught.value.file.endswith("model.toml")


def test_another_ins_point_cannot_be_simulated(bench: Bench) -> None:
    vehicle = replace(bench.vehicle, ins_frame=replace(bench.vehicle.ins_frame, point="antenna"))
    with pytest.raises(InputError, match="'antenna'") as caught:
        VehicleFor(Bench(bench.spec, vehicle, bench.codec, bench.weights, bench.scenarios, bench.dt_s), "mkz_nominal")
    assert caught.value.key == "ins_frame.point"


def effect(name: str, **params: float) -> list[EffectSpec]:
    return [EffectSpec(name=name, params=params)]


def test_effects_by_name() -> None:
    made = effects_of([*effect("steer_dead_time", delay_s=0.05), *effect("payload", mass_kg=200.0)], 0.15)
    assert [port for port, _ in made] == [Port.STEER_A, Port.BODY]


def test_an_unknown_effect_lists_those_there_are() -> None:
    with pytest.raises(InputError, match=r"steer_ded_time.*there are .*steer_dead_time"):
        effects_of(effect("steer_ded_time", delay_s=0.05), 0.15)


def test_a_parameter_that_an_effect_does_not_have() -> None:
    with pytest.raises(InputError, match="steer_dead_time has no parameter delay_ms") as caught:
        effects_of(effect("steer_dead_time", delay_ms=50.0), 0.15)
    assert "delay_s [s]" in caught.value.hint


@pytest.mark.parametrize(
    ("name", "params"),
    [("steer_dead_time", {"delay_s": -0.1}), ("steer_lag", {"tau_s": -1.0}), ("friction", {"friction_frac": 0.0})],
)
def test_a_value_that_an_effect_cannot_have(tmp_path: Path, name: str, params: dict[str, float]) -> None:
    text = ", ".join(f"{key} = {value}" for key, value in params.items())
    bench = load(write_bench(tmp_path, more=f'[[effects]]\nname = "{name}"\nparams = {{ {text} }}\n'))
    with pytest.raises(InputError) as caught:
        VehicleFor(bench, "mkz_nominal")
    assert caught.value.file == bench.file, "the bench file asked for it, not the model"
    assert name in str(caught.value) or next(iter(params)) in str(caught.value)


def fault(channel: str, first: int, after: int, value: float = 0.0, kind: str = "driver_override") -> FaultSpec:
    return FaultSpec(channel=channel, kind=kind, from_tick=first, to_tick=after, value=value)


def test_the_driver_by_script() -> None:
    driver = driver_script([fault("brake", 10, 20, 0.4), fault("steer", 15, 30, -3.0), fault("gear", 25, 26)])
    assert driver(9) == NO_DRIVER
    assert driver(10) == NO_DRIVER._replace(brake_frac=0.4)
    assert driver(19) == NO_DRIVER._replace(brake_frac=0.4, steer_torque_nm=-3.0)
    assert driver(25) == NO_DRIVER._replace(steer_torque_nm=-3.0, gear_override=1.0)
    assert driver(30) == NO_DRIVER


@pytest.mark.parametrize(
    ("channel", "kind", "key"),
    [("clutch", "driver_override", "faults[0].channel"), ("brake", "lost", "faults[0].kind")],
)
def test_a_fault_that_cannot_be_scripted_is_refused_at_the_start(
    tmp_path: Path, channel: str, kind: str, key: str
) -> None:
    """Not at the tick at which it begins, when the drive is under way."""
    text = f'[[faults]]\nchannel = "{channel}"\nkind = "{kind}"\nfrom_tick = 10\nto_tick = 20\n'
    file = write_bench(tmp_path, more=text)
    with pytest.raises(InputError) as caught:
        load(file)
    assert (caught.value.file, caught.value.key) == (str(file), key)
