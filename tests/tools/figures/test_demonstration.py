"""The picture of a hidden effect says what its numbers say."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.measures.figures.demonstration import STAGES, ParameterSetResult, draw_demonstration
from tunefree_hil.figures.style import save

SIGNALS = {
    "yaw_rate_radps": {"before": 0.2, "recalibrated": 0.15, "after": 0.02, "floor": 0.01},
    "speed_mps": {"before": 0.1, "recalibrated": 0.1, "after": 0.1, "floor": 0.05},
}
OLD = ParameterSetResult(3.4, {"u_turn": 3.0, "stop": 3.8}, 22, 1)
REPAIRED = ParameterSetResult(0.2, {"u_turn": 0.1, "stop": 0.3}, 1, 0)
HELD = ParameterSetResult(0.4, {"u_turn": 0.3, "stop": 0.5}, 0, 0)
MANUAL = ParameterSetResult(0.5, {"u_turn": 0.6, "stop": 0.4}, 0, 0)


def test_every_stage_of_every_signal_has_its_bar_and_every_road_its_discs(tmp_path: Path) -> None:
    tuned = {"old": [OLD], "repaired": [REPAIRED]}
    figure = draw_demonstration(SIGNALS, tuned, MANUAL, "Hidden: a. Named: a")
    gap, drives = figure.axes
    assert len(gap.patches) == len(SIGNALS) * len(STAGES)
    shares = [bar.get_width() for bar in gap.patches]
    assert shares[:2] == [1.0, 1.0] and shares[4] == pytest.approx(0.1)
    assert [list(line.get_xdata()) for line in drives.lines[:2]] == [[3.0, 3.8], [0.1, 0.3]]
    assert not drives.patches and drives.get_xscale() == "log"
    words = [text.get_text() for text in drives.get_legend().get_texts()]
    assert sorted(words) == [
        "best manual set: 0.5, 0 re-plans",
        "tuned on the old model: 3.4, 22 re-plans, 1 drive not finished",
        "tuned on the repaired model: 0.2, 1 re-plan",
    ]
    assert list(drives.lines[-1].get_xdata()) == [0.6, 0.4]
    assert figure.get_suptitle() == "Hidden: a. Named: a"
    path = save(draw_demonstration(SIGNALS, tuned, MANUAL, "Named: a"), tmp_path / "demo.png")
    assert path.stat().st_size > 10_000


def test_several_searches_are_a_disc_at_the_median_with_a_dot_for_each() -> None:
    drives = draw_demonstration(SIGNALS, {"old": [OLD, HELD, HELD]}, MANUAL, "Named: a").axes[1]
    assert list(drives.lines[0].get_xdata()) == [0.3, 0.5]
    assert sorted(drives.lines[1].get_xdata()) == [0.3, 0.3, 0.5, 0.5, 3.0, 3.8]
    words = [text.get_text() for text in drives.get_legend().get_texts()]
    assert "tuned on the old model: 0.4 (0.4 to 3.4), no failure in 2 of 3 searches" in words


def test_where_nothing_was_repaired_there_is_the_old_winner_alone() -> None:
    drives = draw_demonstration(SIGNALS, {"old": [OLD]}, MANUAL, "Named: none_missing").axes[1]
    assert [list(line.get_xdata()) for line in drives.lines] == [[3.0, 3.8], [0.6, 0.4]]
