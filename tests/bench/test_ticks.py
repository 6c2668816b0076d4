"""Vehicles whose tick is not 10 ms: the same times in seconds, in the nodes and in the batch."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from tests.house import ROOT
from tools.make_calibration import calibrate, write
from tools.measures._in_process import InProcess
from tunefree_hil.bench import Bench, follower_of, load, parameters_of
from tunefree_hil.bench.simulator import Job, Simulator
from tunefree_hil.bench.vehicle import bywire_params
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.config.schema import FaultSpec
from tunefree_hil.episode.columns import columns_from_frames
from tunefree_hil.grade.score import grade_drive, grade_vehicle_from_spec
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors
from tunefree_hil.nodes.handshake import limits_of

KART = ROOT / "tests" / "bench" / "kart"
TICKS_MS = (5, 10, 20)
STOPPED_S = 0.8  # when the controller falls silent


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "project"
    shutil.copytree(KART, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        write(calibrate("kart_nominal"), folder / "calibration.npz")
    return folder / "calibration.npz"


def bench_of(folder: Path, calibration: Path, tick_ms: int) -> Bench:
    """The kart on another tick, without time-outs of its own; its INS is as slow as a long tick."""
    shutil.copytree(KART, folder, dirs_exist_ok=True)
    shutil.copy(calibration, folder / "models" / "kart_nominal" / "calibration.npz")
    vehicle = folder / "dbc" / "kart" / "vehicle.toml"
    text = vehicle.read_text().replace("tick_ms = 10", f"tick_ms = {tick_ms}").replace("timeout_ms = 200\n", "")
    vehicle.write_text(text.replace("period_ms = 10\n", "period_ms = 20\n"))
    scenario = folder / "scenarios" / "bend.toml"
    scenario.write_text(scenario.read_text().replace("[0.0, 4.0]", "[0.0, 1.5]"))
    return load(folder / "kart.toml")


@pytest.mark.parametrize("tick_ms", TICKS_MS)
def test_it_drives_and_the_batch_drives_the_same(tmp_path: Path, calibration: Path, tick_ms: int) -> None:
    bench = bench_of(tmp_path, calibration, tick_ms)
    scenario, values = bench.scenarios["bend"], compute_baseline_vectors(bench)["rule_based"]
    drive, simulator = InProcess(bench).drive(scenario, values), Simulator(bench)
    batch = simulator.drive(Job(values, scenario))
    assert (drive.error, drive.ticks * tick_ms) == (batch.error, batch.ticks * tick_ms) == ("", 1500)
    follower = follower_of(bench, scenario, values)
    recording = columns_from_frames(drive.frames, bench.codec, follower, bench.dt_s, ticks=drive.ticks)
    assert recording.columns["cmd_steer_rad"].tolist() == batch.recording.columns["cmd_steer_rad"].tolist()
    graded = grade_drive(recording, bench.course(scenario), bench.weights, grade_vehicle_from_spec(bench.vehicle))
    assert (graded.outcome, graded.replans) == ("finished", 0)
    assert simulator._link.limits == limits_of(bench.dt_s)


@pytest.mark.parametrize("tick_ms", TICKS_MS)
def test_the_units_times_are_those_of_the_folder(tmp_path: Path, calibration: Path, tick_ms: int) -> None:
    """In seconds; what the folder does not say is 0.1 s of silence and 20 ms of a hand on the wheel."""
    bench = bench_of(tmp_path, calibration, tick_ms)
    unit, rules = bywire_params(bench), bench.vehicle.override
    for channel, driver_s, override_s in (
        (unit.throttle, rules.driver_s, rules.throttle_s),
        (unit.brake, rules.driver_s, rules.brake_s),
        (unit.steer, 0.02, rules.steer_s),
    ):
        times = (channel.timeout_ticks, channel.driver_ticks, channel.override_ticks)
        assert [one * bench.dt_s for one in times] == pytest.approx([0.1, driver_s, override_s])


@pytest.mark.parametrize("tick_ms", TICKS_MS)
def test_a_silent_controller_is_missed_after_0_1_s_on_every_tick(
    tmp_path: Path, calibration: Path, tick_ms: int
) -> None:
    bench = bench_of(tmp_path, calibration, tick_ms)
    first, never = round(1000.0 * STOPPED_S / tick_ms), 10**6
    gone = FaultSpec(kind="peer_stop", channel="controller", from_tick=first, to_tick=never)
    bench = replace(bench, spec=msgspec.structs.replace(bench.spec, faults=[gone]))
    drive = InProcess(bench).drive(bench.scenarios["bend"], parameters_of(bench))
    [noticed] = [one for one in drive.words if isinstance(one, bc.Fault) and one.index == bc.NOT_SCRIPTED]
    silent_s = noticed.tick * bench.dt_s - (STOPPED_S - 0.02)  # since the last command, 20 ms before
    assert 0.1 - 1e-9 <= silent_s <= 0.1 + 2.0 * bench.dt_s + 1e-9, "a command is used a tick later"
