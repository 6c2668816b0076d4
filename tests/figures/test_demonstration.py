"""The picture of a hidden effect says what its numbers say."""

from __future__ import annotations

from pathlib import Path

import pytest

from tunefree_hil.figures.demonstration import STAGES, Tuned, draw_demonstration, write_demonstration

SIGNALS = {
    "yaw_rate_radps": {"before": 0.2, "recalibrated": 0.15, "after": 0.02, "floor": 0.01},
    "speed_mps": {"before": 0.1, "recalibrated": 0.1, "after": 0.1, "floor": 0.05},
}
OLD = Tuned(3.4, {"u_turn": 3.0, "stop": 3.8}, 22, 1, 3.8)
REPAIRED = Tuned(0.2, {"u_turn": 0.1, "stop": 0.3}, 0, 0, 0.3)


def test_every_stage_of_every_signal_and_every_road_has_its_bar(tmp_path: Path) -> None:
    figure = draw_demonstration(SIGNALS, {"old": OLD, "repaired": REPAIRED}, "Hidden: a. Named: a")
    gap, drives = figure.axes
    assert len(gap.patches) == len(SIGNALS) * len(STAGES)
    shares = [bar.get_width() for bar in gap.patches]
    assert shares[:2] == [1.0, 1.0] and shares[4] == pytest.approx(0.1)
    assert [bar.get_width() for bar in drives.patches] == [3.0, 3.8, 0.1, 0.3]
    words = [text.get_text() for text in drives.get_legend().get_texts()]
    assert "22 re-plans, 1 not finished" in words[0] and "0 re-plans" in words[1] and "0.2" in words[1]
    assert figure.get_suptitle() == "Hidden: a. Named: a"
    path = write_demonstration(tmp_path / "demo.png", SIGNALS, {"old": OLD, "repaired": REPAIRED}, "Named: a")
    assert path.stat().st_size > 10_000


def test_where_nothing_was_repaired_there_is_the_old_winner_alone() -> None:
    drives = draw_demonstration(SIGNALS, {"old": OLD}, "Named: none_missing").axes[1]
    assert len(drives.patches) == len(OLD.by_scenario)
