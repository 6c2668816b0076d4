"""Faults of a bench file against its vehicle, and drives with every kind of them: both nodes, bit for bit again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tools.measures._in_process import InProcess
from tools.measures.faults import VALUES, kinds_of, one_of_each_vehicle
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, ControllerFor, VehicleFor, load, parameters_of
from tunefree_hil.bench.faults import CONTROLLER, ECU, faults_of
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.config.fault_check import FAULT_KINDS
from tunefree_hil.config.schema import FaultSpec
from tunefree_hil.episode.frame_hash import frame_hash


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return load(write_bench(tmp_path_factory.mktemp("faults")))


def fault(kind: str, message: str = "", *, channel: str = "", value: float = 0.0, tick: int = 20) -> FaultSpec:
    return FaultSpec(kind=kind, message=message, channel=channel, value=value, from_tick=tick, to_tick=tick + 10)


def test_each_node_makes_the_faults_of_what_it_sends(bench: Bench) -> None:
    script = [
        fault("drop", "BRAKE_CMD"),
        fault("stale", "GYRO"),
        fault("peer_stop", channel="controller"),
        fault("driver_override", channel="brake", value=0.4),
        fault("delay", "MISC_CMD", value=2.0),
    ]
    of_controller, of_ecu = faults_of(bench, CONTROLLER, script), faults_of(bench, ECU, script)
    assert [one.index for one in of_controller] == [0, 2, 4] and [one.index for one in of_ecu] == [1, 3]
    assert [one.kind for one in of_ecu] == ["stale", "driver_override"]
    assert of_controller[2].value == 2 and of_controller[2].message is bench.codec.by_name["MISC_CMD"]
    assert all(FAULT_KINDS[one.code] == one.kind for one in (*of_controller, *of_ecu))


@pytest.mark.parametrize(
    ("script", "key", "code", "hint"),
    [
        ([fault("drop", "BRAKE_CMDS")], "faults[0].message", "unknown_message", "BRAKE_CMD"),
        ([fault("crc_freeze", "BRAKE_CMD")], "faults[0].kind", "no_crc", "no message"),
        ([fault("counter_freeze", "GYRO")], "faults[0].kind", "no_counter", "BRAKE_CMD, STEERING_CMD, THROTTLE_CMD"),
        ([fault("counter_value", "BRAKE_CMD", value=256.0)], "faults[0].value", "fault_value", "255"),
        ([fault("drop", "GYRO"), fault("counter_offset", "BRAKE_CMD", value=256.0)], "faults[1].value", "", "255"),
    ],
)
def test_a_fault_that_a_message_cannot_have_is_refused(
    bench: Bench, script: Sequence[FaultSpec], key: str, code: str, hint: str
) -> None:
    for role in (ECU, CONTROLLER):
        with pytest.raises(InputError) as caught:
            faults_of(bench, role, script)
        assert caught.value.key == key and hint in caught.value.hint and caught.value.file == bench.file
        assert code in caught.value.code


def test_a_bench_file_with_such_a_fault_is_refused_before_anything_starts(tmp_path: Path) -> None:
    text = '[[faults]]\nkind = "crc_value"\nmessage = "GYRO"\nfrom_tick = 1\nto_tick = 2\n'
    bench = load(write_bench(tmp_path, more=text))
    for build in (lambda: VehicleFor(bench, "mkz_nominal"), lambda: ControllerFor(bench)):
        with pytest.raises(InputError, match="GYRO has no CRC"):
            build()


BENCHES = one_of_each_vehicle()


@pytest.mark.parametrize("bench", BENCHES, ids=lambda bench: bench.vehicle.name)
def test_every_kind_replays_bit_for_bit(bench: Bench) -> None:
    """On one command and one report that can have it; each start is said on the bench channel."""
    rig, values, scenario = InProcess(bench), parameters_of(bench), next(iter(bench.scenarios.values()))
    commands = {message.key for message in bench.codec.commands}

    def drive(script: Sequence[FaultSpec]) -> tuple[str, list[bc.Fault], list[str]]:
        rig.script(script)
        done = rig.drive(scenario, values, until=45)
        hashed = frame_hash(done.frames, bench.dt_s, commands, bench.codec.by_id.keys())
        begun = [one for one in done.words if isinstance(one, bc.Fault) and one.index != bc.NOT_SCRIPTED]
        return hashed.hex, begun, done.said

    clean, different = drive([]), 0
    for message in (bench.codec.commands[0], bench.codec.telemetry[0]):
        for kind in kinds_of(message):
            script = [fault(kind, message.name, value=VALUES.get(kind, 0.0))]
            first = drive(script)
            assert drive(script) == first, f"{kind} of {message.name}"
            assert [(one.index, one.code, one.tick) for one in first[1]] == [(0, FAULT_KINDS.index(kind), 20)]
            assert first[0] != clean[0], f"{kind} of {message.name} changes no frame"
            different += 1
    assert different >= 6 + 10 and len(BENCHES) >= 2
    assert clean[1:] == ([], [])


def test_a_stopped_controller_is_named_by_the_vehicle_and_the_other_way_round(bench: Bench) -> None:
    rig, values = InProcess(bench), parameters_of(bench)
    for peer, words in (("controller", "watchdog"), ("ecu", "ins_missing")):
        rig.script([FaultSpec(kind="peer_stop", channel=peer, from_tick=50, to_tick=120)])
        done = rig.drive(bench.scenarios["tiny"], values)
        assert any(words in line for line in done.said), done.said
        vehicle = [one for one in done.frames if 0.5 <= one.time_s < 0.7]
        silent = {m.key for m in (bench.codec.commands if peer == "controller" else bench.codec.telemetry)}
        assert vehicle and not {one.can_id for one in vehicle} & silent


def test_what_the_unit_tells_is_in_its_frames(bench: Bench) -> None:
    """Watchdog with its source in both reports, brake lights, gear command (docs/reference/by_wire.md), as they go
    out."""
    rig, values, codec = InProcess(bench), parameters_of(bench), bench.codec

    def told(script: Sequence[FaultSpec], name: str, tick: int) -> dict[str, float]:
        rig.script(script)
        frames = rig.drive(bench.scenarios["tiny"], values, until=tick + 1).frames
        message = codec.by_name[name]
        last = [one for one in frames if one.can_id == message.key and one.time_s <= tick * bench.dt_s + 1e-9][-1]
        return dict(codec.decode(message, last.data))

    well = told([], "BRAKE_REPORT", 100)
    assert [well[name] for name in ("BI", "BC", "BO", "WDCBRK", "WDCSRC", "ENABLED")] == [0, 0, 0, 0, 0, 1]
    gear = told([], "GEAR_REPORT", 100)
    assert (gear["CMD"], gear["REJECT"], gear["OVERRIDE"]) == (4, 0, 0)

    stop = [FaultSpec(kind="peer_stop", channel="controller", from_tick=50, to_tick=100)]
    braking = told(stop, "BRAKE_REPORT", 100)
    assert braking["WDCSRC"] in (6, 10, 14), "a command's time-out"
    assert [braking[name] for name in ("BI", "BC", "BO", "WDCBRK", "ENABLED")] == [0, 1, 1, 1, 0]
    assert told(stop, "THROTTLE_REPORT", 100)["WDCSRC"] == braking["WDCSRC"]

    foot = [FaultSpec(kind="driver_override", channel="brake", value=0.4, from_tick=50, to_tick=100)]
    pressed = told(foot, "BRAKE_REPORT", 58)
    assert [pressed[name] for name in ("BI", "BC", "BO", "DRIVER", "WDCBRK", "WDCSRC")] == [1, 0, 1, 1, 0, 0]
    lever = [FaultSpec(kind="driver_override", channel="gear", value=0.0, from_tick=50, to_tick=100)]
    assert told(lever, "GEAR_REPORT", 58)["OVERRIDE"] == 1
