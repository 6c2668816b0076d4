"""A tune over two links of the kernel and no hub: killed with signal 9 and started again, its trials are the same.

What they are the same as is the same tune over our hub that nobody disturbs.
"""

from __future__ import annotations

import signal

import pytest

from tests.jobs.command import finish, new_session, no_orphans, processes_of, start
from tests.vcan.peers import PATIENCE_S, Links, eventually
from tests.vcan.reference import EXACT, ORPHANS_S, Reference, Tuned, tune_words, tuned

pytestmark = [pytest.mark.vcan, pytest.mark.timeout(3000)]
FIRST_TRIAL, TRIALS = 5, 2  # episodes 0 ... 4 are the baselines
ENDED = (0, 130, -signal.SIGTERM)  # by itself, or as it was told to: no error of its own


@pytest.fixture(scope="module")
def killed(links: Links, _patient_and_lean: None, tmp_path_factory: pytest.TempPathFactory) -> Tuned:
    """Killed while the second trial is driven, and gone on with until its winner is written.

    The figures, which it would draw then, know no bus, and take an emulated machine longer than the trials.
    """
    out, session = tmp_path_factory.mktemp("killed"), new_session()
    with no_orphans(session, ORPHANS_S):  # nodes look once a second for their starter, on an emulated machine
        process = start(*tune_words(out, session, *links.addresses()))
        second = f"*/episodes/{FIRST_TRIAL + 1}/vehicle.log.part"
        eventually(lambda: process.poll() is not None or list(out.glob(second)), "the second trial", PATIENCE_S)
        process.send_signal(signal.SIGKILL)
        assert finish(process).status == -signal.SIGKILL
    again = new_session()
    with no_orphans(again, ORPHANS_S):
        process = start(*tune_words(out, again, *links.addresses()))
        eventually(lambda: process.poll() is not None or len(processes_of(again)) > 2, "the second start")
        assert "hub" not in [one.command for one in processes_of(again)], "both channels are on the kernel's links"
        eventually(lambda: process.poll() is not None or list(out.glob("*/best.toml")), "the winner", PATIENCE_S)
        process.terminate()
        ended = finish(process, PATIENCE_S)
        assert ended.status in ENDED and list(out.glob("*/best.toml")), ended.words
    return tuned(out)


def test_killed_and_resumed_over_the_kernels_links_it_ends_the_same(killed: Tuned, reference: Reference) -> None:
    calm = reference.tune
    assert len(calm.trials) == TRIALS and calm.failures == []
    assert [slot for slot, _, _ in killed.trials] == [slot for slot, _, _ in calm.trials]
    for mine, its in zip(killed.trials, calm.trials, strict=True):
        assert mine[1] == pytest.approx(its[1], rel=EXACT) and mine[2] == pytest.approx(its[2], rel=EXACT)
    assert killed.baselines == pytest.approx(calm.baselines, rel=EXACT)
    assert set(killed.failures) <= {"interrupted"}


def test_its_scores_are_not_all_failures(killed: Tuned) -> None:
    """Else equal scores would say little."""
    scores = {score for _, _, score in killed.trials}
    assert len(scores) > 1 and min(scores) < 1.0
