"""The episode kernel, not compiled, against both nodes frame by frame: the same bits, whatever the vehicle.

tests/bench/test_batch.py holds the compiled one against the bus.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from tests.bench.test_every_vehicle import first_benches
from tools.measures._in_process import InProcess
from tools.measures.parity import compared, differing, parameter_sets
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, follower_of, load, parameters_of
from tunefree_hil.bench.parallel import Fleet
from tunefree_hil.bench.simulator import Job, Simulator, with_effects
from tunefree_hil.config.schema import EffectSpec, FaultSpec, ProfileSpec, ScenarioSpec, StartSpec
from tunefree_hil.episode.columns import columns_from_frames
from tunefree_hil.grade.score import ScenarioEnd, grade_drive, grade_vehicle_from_spec

STARTS = {
    "on_the_path": StartSpec(lateral_m=0.1, speed_mps=5.0),
    "a_replan": StartSpec(lateral_m=0.6, speed_mps=5.0),
    "leaves_the_lane": StartSpec(lateral_m=1.6, heading_rad=0.5, speed_mps=5.0),
    "diverges": StartSpec(heading_rad=1.62, speed_mps=5.0),
}
LAST = 8  # a drawn vector with all sixteen parameters
ENDS = {"leaves_the_lane": "left_lane", "diverges": "diverged"}


def bench_of(path: Path, start: StartSpec, duration_s: float = 1.2, **spec: object) -> Bench:
    """A bench whose one scenario is short, slow enough for any vehicle, and begins at `start`."""
    bench = load(path)
    bend = ProfileSpec(t_s=[0.0, duration_s], value=[0.0, 0.05 * duration_s])
    scenario = ScenarioSpec(
        schema="tunefree.scenario/1",
        name="short",
        noise_seed=5,
        start=start,
        speed=ProfileSpec(t_s=[0.0, duration_s], value=[5.0, 4.5]),
        curvature=bend,
        hash=hashlib.sha256(repr((start, duration_s)).encode()).hexdigest(),
    )
    return replace(bench, spec=msgspec.structs.replace(bench.spec, **spec), scenarios={"short": scenario}, courses={})


@pytest.mark.parametrize("case", STARTS)
@pytest.mark.parametrize("path", first_benches(), ids=lambda path: path.stem)
def test_a_drive_without_frames_is_the_drive_with_frames(path: Path, case: str) -> None:
    bench = bench_of(path, STARTS[case])
    scenario = bench.scenarios["short"]
    driver = InProcess(bench)
    fleet = Fleet(bench, "", (), 1)
    values = list(parameter_sets(bench, LAST).values())[-1]
    drive = driver.drive(scenario, values)
    follower = follower_of(bench, scenario, values)
    recording = columns_from_frames(drive.frames, bench.codec, follower, bench.dt_s, ticks=drive.ticks)
    course, vehicle = bench.course(scenario), grade_vehicle_from_spec(bench.vehicle)
    graded = grade_drive(recording, course, bench.weights, vehicle, ScenarioEnd("short", drive.error))
    [driven] = fleet.drive([Job(values, scenario)], columns=True)
    found = compared(recording, graded, driven)
    assert found["differing"] == 0, found
    assert (driven.error, driven.ticks) == (drive.error, drive.ticks)
    assert driven.error == ENDS.get(case, "")
    assert (driven.ticks < course.ticks) == bool(driven.error), "an episode that fails ends early"
    assert bool(graded.replans) == (case != "on_the_path")


@pytest.mark.parametrize("path", first_benches(), ids=lambda path: path.stem)
def test_the_verify_models_physics_too(path: Path) -> None:
    bench = bench_of(path, STARTS["a_replan"], 0.4)
    scenario, values, model = bench.scenarios["short"], parameters_of(bench), bench.spec.verify_model
    drive = InProcess(bench, model).drive(scenario, values)
    follower = follower_of(bench, scenario, values)
    recording = columns_from_frames(drive.frames, bench.codec, follower, bench.dt_s, ticks=drive.ticks)
    ours = Simulator(bench, model).drive(Job(values, scenario))
    assert differing(recording, ours.recording) == {}
    assert ours.ticks == bench.course(scenario).ticks and recording.columns["out_steer_rad"][-1] != 0.0


@pytest.mark.parametrize("path", first_benches(), ids=lambda path: path.stem)
def test_a_bank_and_a_side_wind_are_the_same_without_frames(path: Path) -> None:
    """On the verification's model; each of the two moves the vehicle."""
    bench = bench_of(path, STARTS["on_the_path"], 0.8)
    values, model = parameters_of(bench), bench.spec.verify_model
    bank = ProfileSpec(t_s=[0.0, 0.2, 0.4], value=[0.0, 0.05, 0.02])
    wind = ProfileSpec(t_s=[0.0, 0.1, 0.3], value=[0.0, 0.6, 0.1])
    level = bench.scenarios["short"]
    roads = {"level": level}
    for name, more in (
        ("bank", {"bank": bank}),
        ("wind", {"side_wind": wind}),
        ("both", {"bank": bank, "side_wind": wind}),
    ):
        digest = hashlib.sha256(name.encode()).hexdigest()
        roads[name] = msgspec.structs.replace(level, name=name, hash=digest, **more)
    bench = replace(bench, scenarios=roads, courses={})
    simulator = Simulator(bench, model)
    driven = {name: simulator.drive(Job(values, one)).recording for name, one in roads.items()}
    drive = InProcess(bench, model).drive(roads["both"], values)
    follower = follower_of(bench, roads["both"], values)
    recording = columns_from_frames(drive.frames, bench.codec, follower, bench.dt_s, ticks=drive.ticks)
    assert differing(recording, driven["both"]) == {}
    sides = {name: one.columns["y_m"][-1] for name, one in driven.items()}
    assert sides["bank"] < sides["level"] < sides["wind"] and sides["bank"] < sides["both"] < sides["wind"]


def test_a_driver_who_takes_over_does_so_without_frames_too() -> None:
    script = [FaultSpec(kind="driver_override", channel="steer", value=20.0, from_tick=40, to_tick=90)]
    bench = bench_of(first_benches()[0], STARTS["on_the_path"], faults=script)
    scenario, values = bench.scenarios["short"], parameters_of(bench)
    drive = InProcess(bench).drive(scenario, values)
    ours = Simulator(bench).drive(Job(values, scenario))
    assert (ours.error, ours.ticks) == (drive.error, drive.ticks)
    assert ours.error == "override"


def test_faults_of_frames_are_not_the_batchs() -> None:
    script = [FaultSpec(kind="peer_stop", channel="ecu", from_tick=40, to_tick=90)]
    with pytest.raises(InputError, match="peer_stop") as caught:
        Simulator(bench_of(first_benches()[0], STARTS["on_the_path"], faults=script))
    assert (caught.value.key, caught.value.code) == ("faults[0].kind", "not_in_batch")


def test_extra_effects_are_neutral_until_a_job_says_otherwise() -> None:
    bench = bench_of(first_benches()[0], STARTS["on_the_path"])
    scenario, values = bench.scenarios["short"], parameters_of(bench)
    plain = Simulator(bench).drive(Job(values, scenario)).recording.columns
    simulator = Simulator(bench, extra_effects=("steer_gain",))
    neutral = simulator.drive(Job(values, scenario)).recording.columns
    assert all((plain[name] == neutral[name]).all() for name in ("x_m", "cmd_steer_rad", "out_steer_rad"))
    bent = simulator.drive(Job(values, scenario, effects={"steer_gain": {"gain_frac": 0.5}})).recording.columns
    assert (bent["heading_rad"] != plain["heading_rad"]).any()
    with pytest.raises(InputError, match="friction"):
        simulator.drive(Job(values, scenario, effects={"friction": {}}))


def test_values_of_extra_effects_do_what_they_do_in_a_bench_file() -> None:
    """Delays among them, whose length is data; several jobs after one another share the structure."""
    bench = bench_of(first_benches()[0], STARTS["a_replan"])
    scenario, values = bench.scenarios["short"], parameters_of(bench)
    gain = {"gain_frac": 0.2}
    effects = {"steer_dead_time": {"delay_s": 0.07}, "friction": {"friction_frac": 0.5}, "steer_gain": gain}
    simulator = Simulator(bench, extra_effects=tuple(effects))
    simulator.drive(Job(values, scenario))
    for chosen in (effects, {**effects, "steer_dead_time": {"delay_s": 0.02}}):
        extra = [EffectSpec(name=name, params=params) for name, params in chosen.items()]
        nodes = with_effects(bench, extra)
        drive = InProcess(nodes).drive(scenario, values)
        follower = follower_of(bench, scenario, values)
        recording = columns_from_frames(drive.frames, bench.codec, follower, bench.dt_s, ticks=drive.ticks)
        ours = simulator.drive(Job(values, scenario, effects=chosen))
        assert differing(recording, ours.recording) == {}


def test_a_seed_of_its_own_changes_the_noise_only_as_the_nodes_would() -> None:
    bench = bench_of(first_benches()[0], STARTS["on_the_path"])
    scenario, values = bench.scenarios["short"], parameters_of(bench)
    other = msgspec.structs.replace(scenario, noise_seed=9)
    simulator = Simulator(bench)
    own = simulator.drive(Job(values, scenario)).recording.columns["x_m"]
    assert (simulator.drive(Job(values, scenario, seed=9)).recording.columns["x_m"] != own).any()
    seeded = Simulator(replace(bench, scenarios={"short": other})).drive(Job(values, other)).recording.columns["x_m"]
    assert (simulator.drive(Job(values, scenario, seed=9)).recording.columns["x_m"] == seeded).all()
