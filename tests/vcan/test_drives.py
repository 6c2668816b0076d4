"""Whole episodes in one kernel: over vcan0 the same frames as over our hub, seen by candump, and trouble has a name.

One bench is driven through all scenarios, so the rows of this file share one start.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.vcan.peers import HERE, Candump, Links, eventually, ip, program
from tests.vcan.reference import EXACT, Reference
from tests.vcan.same_frames import same_frames
from tunefree_hil.base.errors import BenchError
from tunefree_hil.bench import load, parameters_of
from tunefree_hil.episode.candump import LogFrame, read_candump
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.running.episode_results import EpisodeResult
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession
from tunefree_hil.jobs.running.trial_driver import TrialDriver

pytestmark = [pytest.mark.vcan, pytest.mark.timeout(3000)]

BENCH = load(HERE / "bench.toml")
FAMILIES = BENCH.spec.scenarios
FLOODED = "turn_3s"
NOT_OURS = 0x7A5
UNDER_WAY = 10_000  # bytes of a vehicle.log that is being written


class Driven(NamedTuple):
    """A bench that has driven all scenarios, and is still there."""

    session: BenchSession
    track: TrialDriver
    run: RunFolder
    episodes: dict[str, EpisodeResult]

    def again(self, name: str, k: int) -> EpisodeResult:
        """One more drive, as episode `k`."""
        return self.track.drive_scenarios(parameters_of(BENCH), [BENCH.scenarios[name]], k)[name]

    def log(self, k: int) -> Path:
        """The vehicle's log of an episode; it has another name while it is written."""
        return self.run.episode(k) / "vehicle.log"


def drive(stack: ExitStack, bus: str, folder: Path) -> Driven:
    """Start a bench and drive every scenario over it."""
    run = RunFolder(folder, {})
    session = BenchSession(HERE / "bench.toml", run.node_output(), BenchLaunch(session=f"vcan-{folder.name}", bus=bus))
    track = TrialDriver(stack.enter_context(session), BENCH, run)
    stack.callback(track.close)
    scenarios = [BENCH.scenarios[name] for name in FAMILIES]
    return Driven(session, track, run, track.drive_scenarios(parameters_of(BENCH), scenarios, 0))


class Heard(NamedTuple):
    """The drives over a link of the kernel, and what candump heard of it."""

    vcan: Driven
    frames: list[LogFrame]


@pytest.fixture(scope="module")
def heard(links: Links, _patient_and_lean: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Heard]:
    folder = tmp_path_factory.mktemp("drives")
    candump = Candump(links.vehicle, folder / "candump.log")
    with ExitStack() as stack:
        stack.callback(candump.close)
        with ExitStack() as vcan_stack:
            vcan = drive(vcan_stack, f"socketcan:{links.vehicle}", folder / "vcan")
            yield Heard(vcan, candump.frames())


@pytest.mark.parametrize("name", FAMILIES)
def test_each_family_has_the_same_frames_over_hub_and_kernel(heard: Heard, reference: Reference, name: str) -> None:
    hub, vcan = reference.drives[name], heard.vcan.episodes[name]
    assert vcan.grade.outcome == hub.outcome == "finished"
    assert vcan.hash == hub.hash
    assert vcan.grade.score == pytest.approx(hub.score, rel=EXACT) and not vcan.foreign


def test_candump_of_our_bus_is_our_log(heard: Heard) -> None:
    """Six drives, frame by frame; nothing is on the link between them."""
    ours = [frame for k in range(len(FAMILIES)) for frame in read_candump(heard.vcan.log(k))]
    compared = same_frames(ours, heard.frames)
    assert compared.difference == ""
    assert compared.frames == len(heard.frames) > 5000
    assert heard.vcan.session.notes == []


def test_frames_of_others_change_nothing_and_are_named(heard: Heard, links: Links) -> None:
    """A steady foreign sender on an id that is not ours."""
    words = ["cangen", links.vehicle, "-g", "20", "-I", f"{NOT_OURS:X}", "-L", "8"]
    with program(words):
        noisy = heard.vcan.again(FLOODED, 6)
    assert noisy.hash == heard.vcan.episodes[FLOODED].hash
    assert noisy.foreign.keys() == {NOT_OURS} and noisy.foreign[NOT_OURS] > 10
    (note,) = heard.vcan.session.notes
    assert f"{noisy.foreign[NOT_OURS]} frames of other nodes on {links.vehicle} (0x{NOT_OURS:03X}" in note


def test_a_flood_is_counted_or_the_loss_named_with_its_number(heard: Heard, links: Links) -> None:
    """As fast as cangen goes: either every foreign frame is in the log and counted, or the drive says how many not."""
    words = ["cangen", links.vehicle, "-g", "0", "-i", "-I", f"{NOT_OURS:X}", "-L", "8"]
    with program(words):
        try:
            flooded = heard.vcan.again(FLOODED, 7)
        except BenchError as error:
            assert error.code == "rx_overflow", error
            assert int(error.message.split()[0]) > 0 and links.vehicle in error.message
            return
    assert flooded.hash == heard.vcan.episodes[FLOODED].hash
    logged = [frame for frame in read_candump(heard.vcan.log(7)) if frame.can_id == NOT_OURS]
    assert len(logged) == flooded.foreign[NOT_OURS] > 1000
    assert any(f"{len(logged)} frames of other nodes" in note for note in heard.vcan.session.notes)


def test_a_link_that_goes_down_in_a_drive_is_named(heard: Heard, links: Links, mended: None) -> None:
    folder = heard.vcan.run.episode(8)
    with ThreadPoolExecutor(1) as lane:
        drive = lane.submit(heard.vcan.again, FLOODED, 8)
        eventually(lambda: drive.done() or _written(folder) > UNDER_WAY, "a log that is being written")
        ip("link", "set", "down", links.vehicle)
        with pytest.raises(BenchError, match=f"{links.vehicle} went down") as caught:
            drive.result()
    assert caught.value.code == "link_down" and f"ip link set up {links.vehicle}" in caught.value.hint
    assert not (folder / "vehicle.log").exists(), "no log that looks whole"


def _written(folder: Path) -> int:
    """Bytes of the vehicle's log so far, under whatever name."""
    return sum(path.stat().st_size for path in folder.glob("*vehicle*")) if folder.is_dir() else 0
