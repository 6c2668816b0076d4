"""Which benches a batch cannot drive because their controller is not ours, whoever started it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bench.own_part import PART
from tests.bench.tiny import write_bench
from tunefree_hil.bench import load
from tunefree_hil.jobs.running.node_main import OURS
from tunefree_hil.jobs.tune.margins import find_batch_obstacle


@pytest.mark.parametrize(
    ("more", "joined", "words"),
    [
        ("", "pursuit", "only our controller, not pursuit, which was joined"),
        ("", "", "not the unnamed one, which was joined"),
        ('[controller.parameters]\n"mine.gain" = 0.5', None, "only our controller, which has no parameter mine.gain"),
        ("", OURS, ""),
        ('[controller]\nlateral = "mine.py:CONTROLLER"\n[controller.parameters]\n"mine.gain" = 0.5', None, ""),
    ],
)
def test_a_joined_controller_and_its_parameters_are_not_taken_for_ours(
    tmp_path: Path, more: str, joined: str | None, words: str
) -> None:
    (tmp_path / "mine.py").write_text(PART)
    reason = find_batch_obstacle(load(write_bench(tmp_path, more=more)), joined)
    assert words in reason and bool(words) == bool(reason)
