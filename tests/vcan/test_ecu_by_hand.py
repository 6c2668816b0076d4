"""cansend and canplayer drive our vehicle: `tunefree-hil ecu --scenario`, no hub, no runner, no controller of ours."""

from __future__ import annotations

import math
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.house import ROOT
from tests.jobs.command import Ended, finish, new_session, no_orphans, start
from tests.vcan.peers import HERE, PATIENCE_S, Candump, Links, eventually
from tunefree_hil.base.records import Command
from tunefree_hil.bench import Bench, load
from tunefree_hil.bus.dbc.codec import Codec, Snapshot
from tunefree_hil.episode.candump import LogFrame

pytestmark = [pytest.mark.vcan, pytest.mark.timeout(3000)]

SCENARIO = "turn_3s"
BY_LOG_RAD, BY_HAND_RAD = -1.0, 1.0
PERIOD_S, CYCLES = 0.02, 60  # of the log: 1.2 s
SENDS = 25  # cycles by hand, as fast as a shell starts programs
PLAYED_ON = "can7"


class Moved(NamedTuple):
    """How the ECU ended, and the frames on its link."""

    ecu: Ended
    bench: Bench
    frames: list[LogFrame]


def patient_bench(folder: Path) -> Path:
    """The bench of this folder with a vehicle that waits 2 s for a command, not 0.1 s.

    A time-out stays until the next power-up, and an emulated machine that does something else for 0.1 s proves nothing.
    """
    vehicle = folder / "patient_mkz"
    shutil.copytree(ROOT / "dbc" / "mkz_bywire", vehicle)
    text = (vehicle / "vehicle.toml").read_text()
    assert "timeout_ms = 100\n" in text
    (vehicle / "vehicle.toml").write_text(text.replace("timeout_ms = 100\n", "timeout_ms = 2000\n"))
    bench = folder / "bench.toml"
    bench.write_text((HERE / "bench.toml").read_text().replace('"mkz_bywire"', f'"{vehicle}"'))
    shutil.copytree(HERE / "scenarios", folder / "scenarios")
    return bench


def commands(codec: Codec, steer_rad: float, count: int) -> list[str]:
    """The command frames of cycle `count` as can-utils write them: 064#0011..."""
    command = Command(throttle_frac=0.2, brake_frac=0.15, steer_rad=steer_rad, gear=4.0)
    found = []
    for message in codec.commands:
        signals = {message.enable: 1.0} if message.enable else {}
        if message.counter:
            signals[message.counter] = float(count % 256)
        found.append(f"{message.can_id:03X}#{codec.encode(message, {'command': command}, signals).hex().upper()}")
    return found


def script(codec: Codec, link: str, log: Path) -> str:
    """canplayer plays a log that was recorded on another link, then a shell calls cansend again and again."""
    lines = [
        f"({count * PERIOD_S:.6f}) {PLAYED_ON} {text}\n"
        for count in range(CYCLES)
        for text in commands(codec, BY_LOG_RAD, count)
    ]
    log.write_text("".join(lines))
    by_hand = [
        f"cansend {link} {text}" for count in range(SENDS) for text in commands(codec, BY_HAND_RAD, CYCLES + count)
    ]
    return "\n".join(["set -e", f"canplayer -I {log} {link}={PLAYED_ON}", *by_hand])


@pytest.fixture(scope="module")
def moved(links: Links, _patient_and_lean: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Moved]:
    folder = tmp_path_factory.mktemp("by_hand")
    file = patient_bench(folder)
    bench, session = load(file), new_session()
    play = script(bench.codec, links.vehicle, folder / "played.log")
    candump = Candump(links.vehicle, folder / "candump.log")
    with no_orphans(session, 60.0):
        words = ("ecu", file, "--bus", f"socketcan:{links.vehicle}", "--scenario", SCENARIO, "--session", session)
        ecu = start(*words, "--json")
        eventually(lambda: ecu.poll() is not None or candump.file.stat().st_size > 0, "the vehicle's first report")
        done = subprocess.run(["sh", "-c", play], capture_output=True, text=True, timeout=PATIENCE_S)
        assert done.returncode == 0, done.stderr
        ended = finish(ecu, PATIENCE_S)
    yield Moved(ended, bench, candump.frames())


def steering(moved: Moved) -> list[float]:
    """Every steer angle (rad) that the vehicle reported."""
    codec = moved.bench.codec
    snapshot, found = Snapshot(codec), []
    reports = {message.can_id for message in codec.telemetry}
    for frame in moved.frames:
        if frame.can_id in reports:
            snapshot.take(codec.by_id[frame.can_id], frame.data)
            steer_rad = snapshot.report().steer_rad
            if not math.isnan(steer_rad):  # before the first steering report
                found.append(steer_rad)
    return found


def test_canplayer_drives_our_vehicle(moved: Moved) -> None:
    """The steering wheel went where the log says, and nowhere else before."""
    angles = steering(moved)
    assert len(angles) > 400 and abs(angles[0]) < 0.1
    turned = next(i for i, angle in enumerate(angles) if angle < 0.5 * BY_LOG_RAD)
    assert max(angles[:turned]) < 0.1


def test_cansend_drives_our_vehicle(moved: Moved) -> None:
    """It came back, as far as the frames that were sent by hand took it."""
    angles = steering(moved)
    lowest = min(range(len(angles)), key=angles.__getitem__)
    assert angles[lowest] < 0.5 * BY_LOG_RAD
    assert max(angles[lowest:]) > angles[lowest] + 0.3


def test_the_vehicle_heard_each_frame_and_says_so(moved: Moved) -> None:
    assert moved.ecu.status == 0, moved.ecu.words
    commanded = {message.can_id for message in moved.bench.codec.commands}
    played = [frame for frame in moved.frames if frame.can_id in commanded]
    assert len(played) == (CYCLES + SENDS) * len(commanded)
    heard = moved.ecu.data["heard"]
    assert 0.9 * CYCLES * len(commanded) <= heard <= len(played)
