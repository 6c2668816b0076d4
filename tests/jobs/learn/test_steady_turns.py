"""Steady turns: within every vehicle's limits; the fit finds what slow circles on the same plant show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import pytest

from tests import other_vehicle
from tests.house import ROOT
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GEAR_DRIVE, NAN, Command, Disturbance
from tunefree_hil.bench import Bench, VehicleFor
from tunefree_hil.bench.simulator import Job, Simulator
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.control.steering_map import steady_road_wheel_rad, wheel_rad
from tunefree_hil.episode.recording import Recording
from tunefree_hil.jobs.learn.steady_turns import CRITERIA, drive_steady_turns, make_turn_bench, make_turns
from tunefree_hil.jobs.learn.steering import base_map
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.steering_map.fit import SteeringFit, fit_steering_map, locate_turns
from tunefree_hil.learn.steering_map.samples import collect_steady_samples, sample_drive
from tunefree_hil.plant.types import BodyInput, Driver
from tunefree_hil.plant.vehicle import first_output, for_episode

DT_S = 0.01
MODELS = ROOT / "bench_configs" / "models"
FIRST = MODELS / "mkz_nominal"
NOMINALS = (FIRST, other_vehicle.NOMINAL)
REFERENCES = {  # understeer that slow steady circles at small lateral acceleration show, s2/m; the data sheet's
    FIRST: (0.0037, 0.0041, 0.0),
    other_vehicle.NOMINAL: (0.0044, 0.0050, 0.0023),
}


def turn_bench(folder: Path, speeds: Sequence[int] = range(CRITERIA.speeds)) -> Bench:
    """The bench of some of the turns."""
    model = load_model(folder)
    bench = make_turn_bench(model, load_vehicle(model.vehicle))
    chosen = [list(bench.scenarios.values())[i] for i in speeds]
    return replace(bench, scenarios={scenario.name: scenario for scenario in chosen})


def reference_bench(nominal: Path) -> Bench:
    """The turns of the reference plant, which stands for the vehicle and has no map of its own."""
    bench = turn_bench(Path(str(nominal).replace("_nominal", "_reference")))
    controller = msgspec.structs.replace(bench.spec.controller, calibration=str(nominal / "calibration.npz"))
    return replace(bench, spec=msgspec.structs.replace(bench.spec, controller=controller))


def fitted(drives: Sequence[Drive], bench: Bench) -> SteeringFit:
    return fit_steering_map(collect_steady_samples(drives, bench.vehicle), base_map(bench.vehicle, None), "data sheet")


@pytest.mark.parametrize("folder", NOMINALS, ids=lambda path: path.name)
def test_every_turn_can_be_driven(folder: Path) -> None:
    bench = turn_bench(folder)
    assert len(bench.scenarios) == CRITERIA.speeds
    for scenario in bench.scenarios.values():
        bench.course(scenario)  # refuses what is beyond the vehicle's limits
        assert scenario.curvature.value[2] == -scenario.curvature.value[4] > 0.0
    speeds = [scenario.speed.value[0] for scenario in bench.scenarios.values()]
    assert speeds[0] == CRITERIA.low_mps and speeds == sorted(speeds) and speeds[-1] > 20.0


def test_turns_stay_in_the_region_that_a_learned_plant_knows() -> None:
    model = load_model(MODELS / "mkz_learned")
    vehicle = load_vehicle(model.vehicle)
    turns = list(make_turns(model, vehicle))
    assert model.valid.speed_mps is not None and model.valid.lateral_accel_mps2 is not None
    for turn in turns:
        speed, curvature = turn.speed.value[0], max(turn.curvature.value)
        assert speed < model.valid.speed_mps[1]
        assert speed * speed * curvature < min(-model.valid.lateral_accel_mps2[0], model.valid.lateral_accel_mps2[1])
    assert len({turn.hash for turn in turns}) == len(turns)


@pytest.mark.slow
def test_one_turn_of_a_model_is_nearly_all_steady() -> None:
    bench = turn_bench(FIRST, [3])
    simulator = Simulator(bench)

    def drive(jobs: Sequence[Job]) -> list[Recording]:
        return [simulator.drive(job).recording for job in jobs]

    [turn] = drive_steady_turns(bench, drive)
    samples = sample_drive(turn, bench.vehicle)
    assert len(samples.block) > 0.08 * turn.n_rows  # one in ten rows, less the ends
    assert samples.yaw_rate_radps.max() > 0.1 and samples.yaw_rate_radps.min() < -0.1
    assert np.isfinite(samples.rear_slip_rad).all()


def test_a_model_that_ends_at_once_is_named() -> None:
    bench = turn_bench(FIRST, [0])
    with pytest.raises(InputError) as caught:
        drive_steady_turns(bench, lambda jobs: [None for _ in jobs])
    assert caught.value.code == "no_steady_turns" and caught.value.hint


@pytest.mark.compiled
@pytest.mark.timeout(600)
@pytest.mark.parametrize("nominal", NOMINALS, ids=lambda path: path.name)
def test_the_understeer_is_that_of_steady_circles(nominal: Path) -> None:
    low, high, data_sheet = REFERENCES[nominal]
    bench = reference_bench(nominal)
    drives = drive_steady_turns(bench)
    ticks = [bench.course(scenario).ticks for scenario in bench.scenarios.values()]
    assert [drive.n_rows for drive in drives] == ticks, "no turn is more than the controller's bound on the wheel"
    fit = fitted(drives, bench)
    assert fit.estimates["understeer_s2pm"].known and low < fit.steering.understeer_s2pm < high
    assert base_map(bench.vehicle, None).understeer_s2pm == pytest.approx(data_sheet, abs=1e-4)
    wheel = 0.5 if data_sheet == 0.0 else 0.7
    for circle in held_circles(bench, wheel, speed_mps=12.0):
        assert 0.8 < circle.speed_mps * circle.yaw_rate_radps < 2.0
        assert fitted_wheel_rad(fit, circle) == pytest.approx(wheel, rel=0.01)


class Circle(NamedTuple):
    """Motion on a held circle."""

    speed_mps: float
    yaw_rate_radps: float


def fitted_wheel_rad(fit: SteeringFit, circle: Circle) -> float:
    """Wheel angle of the map for a circle, without the offset, which is that of the gyro."""
    samples = fit.samples.select(np.array([0]))._replace(
        speed_mps=np.array([circle.speed_mps]), yaw_rate_radps=np.array([circle.yaw_rate_radps])
    )
    curvature = float(locate_turns(samples, fit.steering).curvature_1pm[0])
    steering = fit.steering._replace(offset_rad=0.0)
    return wheel_rad(steering, steady_road_wheel_rad(steering, circle.speed_mps, curvature))


def held_circles(bench: Bench, held_rad: float, speed_mps: float) -> Iterator[Circle]:
    """True motion of the plant with a held wheel, open loop: a hand on the throttle, no controller, no sensors."""
    body = VehicleFor(bench, bench.spec.model).body
    rest = bench.vehicle.nominal.rest_pedal_frac
    body = for_episode(body, Start(speed_mps=speed_mps))
    state, _ = first_output(body, DT_S)
    throttle = rest
    for k in range(round(8.0 / DT_S)):
        command = Command(throttle, rest, held_rad * min(k * DT_S / 2.0, 1.0), GEAR_DRIVE, NAN, NAN)
        x = BodyInput(command, Driver(rest, rest), Disturbance())
        state, out = body.block.step(body.block.params, state, x, DT_S)
        throttle = rest + min(max(0.12 + 0.1 * (speed_mps - out.motion.speed_mps), 0.0), 0.3)
        if k * DT_S in (6.0, 7.0):
            yield Circle(out.motion.speed_mps, out.motion.yaw_rate_radps)
    yield Circle(out.motion.speed_mps, out.motion.yaw_rate_radps)
