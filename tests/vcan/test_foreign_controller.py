"""The C controller of tools/ on links of the kernel: the frames that it drives over our hub, and no hub to end it."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.house import ROOT
from tests.vcan.peers import HERE, PATIENCE_S, Links, eventually
from tunefree_hil.bench import load, parameters_of
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.running.foreign import program_of, with_command
from tunefree_hil.jobs.running.harvest import Episode
from tunefree_hil.jobs.running.session import Session
from tunefree_hil.jobs.running.track import Track

pytestmark = [
    pytest.mark.vcan,
    pytest.mark.timeout(900),
    pytest.mark.skipif(
        shutil.which("cc") is None or shutil.which("make") is None, reason="needs make and a C compiler"
    ),
]
SCENARIO = "turn_3s"
PROGRAM = "{program} {{bus}} {{bench}} {{paths}} {{token_file}}"


@pytest.fixture(scope="module")
def controller() -> Path:
    """The program of the checkout's build folder; made where it is not there yet, which takes long in a machine that
    is emulated."""
    words = ["make", "-C", str(ROOT / "tools" / "foreign_controller"), f"PYTHON={sys.executable}"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ROOT / "build" / "foreign_controller" / "controller"


class Driven(NamedTuple):
    """An episode with its bench channel's log, and what the bench noted."""

    episode: Episode
    bench_log: str
    told: str
    notes: list[str]


def drive(controller: Path, folder: Path, bus: str, bench_bus: str = "") -> Driven:
    """One scenario of this folder's bench, driven by the C program."""
    bench = with_command(load(HERE / "bench.toml"), PROGRAM.format(program=controller))
    run = RunFolder(folder, {})
    with Session(
        HERE / "bench.toml",
        run.words(),
        session=f"vcan-{folder.name}",
        bus=bus,
        bench_bus=bench_bus,
        controller_command=program_of(bench),
    ) as session:
        track = Track(session, bench, run)
        try:
            episode = track.drive_all(parameters_of(bench), [bench.scenarios[SCENARIO]], 0)[SCENARIO]
        finally:
            track.close()
        told = "\n".join(path.read_text() for path in run.words().glob("controller.txt"))
        return Driven(episode, (run.episode(0) / "bench.log").read_text(), told, session.notes)


@pytest.fixture(scope="module")
def driven(
    controller: Path, links: Links, _patient_and_lean: None, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Driven, Driven]]:
    """(over the hub's TCP, over two links of the kernel), at the same time."""
    folder = tmp_path_factory.mktemp("foreign")
    with ThreadPoolExecutor(2) as lanes:
        hub = lanes.submit(drive, controller, folder / "hub", "tfhub")
        where = f"socketcan:{links.vehicle}", f"socketcan:{links.bench}"
        vcan = lanes.submit(drive, controller, folder / "vcan", *where)
        yield hub.result(), vcan.result()


def test_it_drives_a_scenario_over_two_links(driven: tuple[Driven, Driven]) -> None:
    _, vcan = driven
    grade = vcan.episode.grade
    assert (grade.outcome, grade.replans) == ("finished", 0) and grade.score < 1.0
    assert vcan.bench_log.count(" 6E1#") == 2 * vcan.bench_log.count(" 6E0#") > 500, "each tick has the DONE of both"
    assert vcan.notes == [] and vcan.told == ""


def test_its_frames_are_those_it_drives_over_the_hub(driven: tuple[Driven, Driven]) -> None:
    hub, vcan = driven
    assert hub.episode.hash == vcan.episode.hash
    assert hub.episode.grade == vcan.episode.grade


def test_without_a_hub_it_ends_with_whoever_started_it(controller: Path, links: Links) -> None:
    where = f"socketcan:{links.vehicle} socketcan:{links.bench}"
    text = f"TUNEFREE_STARTER=$$ {controller} {where} . & echo $!; wait"
    words = ["sh", "-c", text]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as starter:
        assert starter.stdout is not None and starter.stderr is not None
        folder = Path("/proc") / starter.stdout.readline().strip()
        eventually(lambda: (folder / "exe").exists() and (folder / "exe").resolve() == controller, "the controller")
        starter.send_signal(signal.SIGKILL)
        eventually(lambda: not folder.exists(), "the end of the controller")
        assert "whoever started this is gone" in starter.stderr.read()
        assert starter.wait(PATIENCE_S) == -signal.SIGKILL
