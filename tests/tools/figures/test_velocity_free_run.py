"""The figure of free runs beside what was measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tools.measures.figures.velocity_free_run import VelocityRun, draw_runs
from tunefree_hil.figures.style import save


def a_run(words: str) -> VelocityRun:
    time_s = np.arange(0.0, 5.0, 0.1)
    models = {"physics": time_s * 0.9, "keeps its speed": 0.0 * time_s}
    return VelocityRun(words, time_s, time_s, 0.1 * time_s, models, models)


def test_a_column_a_run_with_every_model_in_both_panels(tmp_path: Path) -> None:
    figure = draw_runs([a_run("one car"), a_run("another")], "Real cars")
    assert len(figure.axes) == 4
    assert all(len(axes.lines) == 3 for axes in figure.axes)
    assert {axes.get_title(loc="left") for axes in figure.axes} >= {"one car", "another"}
    assert save(draw_runs([a_run("one car")], "Real cars"), tmp_path / "a.png").stat().st_size > 5000


def test_nothing_to_show_is_said() -> None:
    assert draw_runs([], "Real cars").axes[0].texts
