"""Tools that play onto our bus: a foreign drive changes nothing, a foreign commander is named with id and count."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import Ended, finish, new_session, no_orphans, start
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.tfhub.address import session_dir
from tunefree_hil.bus.tfhub.owner import ForeignSender
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.jobs.running.foreign_frames import foreign_frame_error


@pytest.fixture(scope="module")
def codec() -> Codec:
    return Codec(load_vehicle("mkz_bywire"))


def test_nobody_is_nobody(codec: Codec) -> None:
    assert foreign_frame_error([], {message.key for message in codec.commands}) is None


def test_commanders_come_first_and_everyone_is_named() -> None:
    found = [ForeignSender("a", 11, 0x61, 500), ForeignSender("b", 12, 0x60, 1)]
    error = foreign_frame_error(found, {0x60})
    assert error is not None and error.code == "foreign_commander" and error.key == "b" and error.exit_status == 3
    commander, reporter = error.message.split("; ")
    assert commander == "foreign commander 0x060 from member b (pid 12), 1 frame"
    assert reporter == "foreign reporter 0x061 from member a (pid 11), 500 frames"


def test_who_only_reports_is_no_commander() -> None:
    error = foreign_frame_error([ForeignSender("a", 11, 0x61, 2)], {0x60})
    assert error is not None and error.code == "foreign_reporter"


LONG_S = 25.0
PLAYER = """
import contextlib, pathlib, sys, time
import can.player, tunefree_hil.bus
hub = pathlib.Path(sys.argv.pop(1))
while True:
    while not hub.is_file():
        time.sleep(0.005)
    with contextlib.suppress(Exception):
        can.player.main()
"""


@contextmanager
def playing(session: str, log: Path) -> Iterator[None]:
    """can.player as a member, some 2000 frames a second, again and again from the moment there is a hub.

    It has imported all it needs by then, and the episode is long beside what a busy machine keeps it waiting.
    """
    where = f"{session}/veh?role=member&listen=no&name=player"
    options = ["-i", "tfhub", "-c", where, "--ignore-timestamps", "-g", "0.0005", str(log)]
    command = [sys.executable, "-c", PLAYER, str(session_dir(session) / "hub.json"), *options]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def drive(folder: Path, session: str, out: str) -> Ended:
    return finish(start("drive", folder / "b.toml", "--session", session, "--out", folder / out, "--json"))


@pytest.mark.slow
def test_a_foreign_drive_on_our_bus_changes_neither_frames_nor_score(tmp_path: Path, shared_data: Path) -> None:
    log = shared_data / "comma2k19_rav4" / "drive.candump.log"
    write_bench(tmp_path, duration_s=LONG_S)
    quiet = drive(tmp_path, new_session(), "quiet")
    session = new_session()
    with no_orphans(session), playing(session, log):
        noisy = drive(tmp_path, session, "noisy")
    assert quiet.status == noisy.status == 0, quiet.words + noisy.words
    assert noisy.data["hashes"] == quiet.data["hashes"] and noisy.data["score"] == quiet.data["score"]
    foreign = noisy.data["foreign_frames"]
    assert set(foreign) <= {
        "0x24",
        "0x25",
        "0xaa",
        "0xb4",
        "0x1d2",
        "0x224",
        "0x260",
        "0x262",
        "0x2c1",
        "0x2e4",
        "0x343",
    }
    assert sum(foreign.values()) > 100, "it was played while the episode ran"


@pytest.mark.slow
def test_a_foreign_commander_fails_the_episode_by_name(tmp_path: Path, codec: Codec) -> None:
    write_bench(tmp_path, duration_s=LONG_S)
    command = codec.commands[0]
    log = tmp_path / "foreign.log"
    log.write_text(f"(0.000000) can0 {command.can_id:03X}#{'00' * command.length}\n" * 3000)
    session = new_session()
    with no_orphans(session), playing(session, log):
        ended = drive(tmp_path, session, "out")
    assert ended.status == 3
    (error,) = ended.errors
    assert error["code"] == "foreign_commander" and error["key"].startswith("player")
    assert f"foreign commander 0x{command.can_id:03X} from member player" in error["message"]
    assert "frame" in error["message"] and "pid" in error["message"]
