"""The C controller of tools/ on links of the kernel: the frames that it drives over our hub, and no hub to end it."""

from __future__ import annotations

import shutil
import signal
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.vcan.peers import HERE, PATIENCE_S, PROGRAM, SCENARIO, Links, controller_of, eventually
from tests.vcan.reference import EXACT, Reference, compared
from tunefree_hil.bench import load, parameters_of
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.running.episode_results import EpisodeResult
from tunefree_hil.jobs.running.foreign import controller_program, with_controller_command
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession
from tunefree_hil.jobs.running.trial_driver import TrialDriver

pytestmark = [
    pytest.mark.vcan,
    pytest.mark.timeout(900),
    pytest.mark.skipif(
        shutil.which("cc") is None or shutil.which("make") is None, reason="needs make and a C compiler"
    ),
]


@pytest.fixture(scope="module")
def controller() -> Path:
    """The program."""
    found = controller_of()
    assert found is not None
    return found


class Driven(NamedTuple):
    """An episode with its bench channel's log, and what the bench noted."""

    episode: EpisodeResult
    bench_log: str
    told: str
    notes: list[str]


@pytest.fixture(scope="module")
def driven(controller: Path, links: Links, _patient_and_lean: None, tmp_path_factory: pytest.TempPathFactory) -> Driven:
    """One scenario of this folder's bench, driven by the C program over two links of the kernel."""
    bench = with_controller_command(load(HERE / "bench.toml"), PROGRAM.format(program=controller))
    run = RunFolder(tmp_path_factory.mktemp("foreign") / "run", {})
    with BenchSession(
        HERE / "bench.toml",
        run.node_output(),
        BenchLaunch(
            session="vcan-foreign",
            bus=f"socketcan:{links.vehicle}",
            bench_bus=f"socketcan:{links.bench}",
            controller_command=controller_program(bench),
        ),
    ) as session:
        track = TrialDriver(session, bench, run)
        try:
            episode = track.drive_scenarios(parameters_of(bench), [bench.scenarios[SCENARIO]], 0)[SCENARIO]
        finally:
            track.close()
        told = "\n".join(path.read_text() for path in run.node_output().glob("controller.txt"))
        return Driven(episode, (run.episode(0) / "bench.log").read_text(), told, session.notes)


def test_it_drives_a_scenario_over_two_links(driven: Driven) -> None:
    grade = driven.episode.grade
    assert (grade.outcome, grade.replans) == ("finished", 0) and grade.score < 1.0
    assert driven.bench_log.count(" 6E1#") == 2 * driven.bench_log.count(" 6E0#") > 500, "each tick has both DONE"
    assert driven.notes == [] and driven.told == ""


def test_its_frames_are_those_it_drives_over_the_hub(driven: Driven, reference: Reference) -> None:
    assert reference.foreign is not None
    mine = compared(driven.episode)
    assert mine._replace(score=0.0) == reference.foreign._replace(score=0.0)
    assert mine.score == pytest.approx(reference.foreign.score, rel=EXACT)


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
