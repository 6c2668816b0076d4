"""A tune over two links of the kernel and no hub: killed with signal 9 and started again, its trials are the same.

What they are the same as is the same tune over our hub that nobody disturbs, in the same kernel, at the same time.
"""

from __future__ import annotations

import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.jobs.command import Ended, finish, new_session, no_orphans, processes_of, start
from tests.vcan.peers import HERE, PATIENCE_S, Links, eventually
from tunefree_hil.tune.study import read_study

pytestmark = [pytest.mark.vcan, pytest.mark.timeout(3000)]
ORPHANS_S = 60.0  # nodes look once a second for their starter, on an emulated machine
FIRST_TRIAL, TRIALS = 5, 3  # episodes 0 ... 4 are the baselines


class Tuned(NamedTuple):
    """What a tune left in its study, and how its last command ended."""

    ended: Ended
    baselines: dict[str, float]
    trials: list[tuple[int, dict[str, float], float]]
    failures: list[str]


def tune(out: Path, session: str, *bus: str) -> Any:
    """Start the command; the same words go on where an earlier one was cut off."""
    words = ("tune", HERE / "tune.toml", "--no-verify", "--out", out, "--session", session, "--json", *bus)
    return start(*words)


def tuned(ended: Ended, out: Path) -> Tuned:
    (run,) = out.glob("*")
    with read_study(run / "study.db") as study:
        trials = [(trial.slot, trial.parameters, trial.score) for trial in study.trials()]
        baselines = {name: one.score for name, one in study.baselines().items()}
        return Tuned(ended, baselines, trials, [failure.error for failure in study.failures()])


def undisturbed(out: Path) -> Tuned:
    session = new_session()
    with no_orphans(session, ORPHANS_S):
        return tuned(finish(tune(out, session, "--bus", "tfhub", "--benches", "1"), PATIENCE_S), out)


def killed_and_resumed(out: Path, links: Links) -> Tuned:
    """Killed while the second trial is driven."""
    session = new_session()
    with no_orphans(session, ORPHANS_S):
        process = tune(out, session, *links.addresses())
        second = f"*/episodes/{FIRST_TRIAL + 1}/vehicle.log.part"
        eventually(lambda: process.poll() is not None or list(out.glob(second)), "the second trial", PATIENCE_S)
        process.send_signal(signal.SIGKILL)
        assert finish(process).status == -signal.SIGKILL
    again = new_session()
    with no_orphans(again, ORPHANS_S):
        process = tune(out, again, *links.addresses())
        eventually(lambda: process.poll() is not None or len(processes_of(again)) > 2, "the second start")
        assert "hub" not in [one.command for one in processes_of(again)], "both channels are on the kernel's links"
        return tuned(finish(process, PATIENCE_S), out)


@pytest.fixture(scope="module")
def tunes(links: Links, _patient_and_lean: None, tmp_path_factory: pytest.TempPathFactory) -> tuple[Tuned, Tuned]:
    folder = tmp_path_factory.mktemp("tunes")
    with ThreadPoolExecutor(2) as lanes:
        calm = lanes.submit(undisturbed, folder / "calm")
        killed = lanes.submit(killed_and_resumed, folder / "killed", links)
        return calm.result(), killed.result()


def test_killed_and_resumed_over_the_kernels_links_it_ends_the_same(tunes: tuple[Tuned, Tuned]) -> None:
    calm, killed = tunes
    assert calm.ended.status == killed.ended.status == 0, calm.ended.words + killed.ended.words
    assert len(calm.trials) == TRIALS and calm.failures == []
    assert killed.trials == calm.trials
    assert killed.baselines == calm.baselines
    assert set(killed.failures) <= {"interrupted"}


def test_its_scores_are_not_all_failures(tunes: tuple[Tuned, Tuned]) -> None:
    """Else equal scores would say little."""
    scores = {score for _, _, score in tunes[0].trials}
    assert len(scores) > 1 and min(scores) < 1.0
