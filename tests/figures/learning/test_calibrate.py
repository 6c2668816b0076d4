"""The pictures of a calibration hold what was measured and what was fitted."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tunefree_hil.figures.learning.calibrate import ChannelFit, ChannelTrace, ErrorGrowth, draw_channels, draw_growth
from tunefree_hil.figures.style import save

TIME_S = np.arange(100) * 0.01


def stretch() -> ChannelTrace:
    output = np.where(np.arange(100) % 2, np.nan, 0.9)
    return ChannelTrace(TIME_S, np.ones(100), output, np.full(100, 0.95))


def growth() -> ErrorGrowth:
    return ErrorGrowth(
        TIME_S, {"speed_mps": TIME_S, "x_m": TIME_S}, {"speed_mps": 0.1 * TIME_S, "x_m": 0.2 * TIME_S}, 7
    )


def test_a_row_a_channel_with_reports_as_dots() -> None:
    figure = draw_channels(
        [ChannelFit("steer", "dead time", [stretch(), stretch()]), ChannelFit("brake", "", [])], "title"
    )
    assert len(figure.axes) == 2, "a channel without pairs has no row"
    dots = next(line for line in figure.axes[0].lines if line.get_label() == "output as reported")
    assert len(np.asarray(dots.get_xdata())) == 50, "only what came"
    assert figure.axes[0].get_title(loc="left") == "steer: dead time"
    assert "rad" in figure.axes[0].get_ylabel()


def test_without_any_pair_it_says_so() -> None:
    figure = draw_channels([ChannelFit("steer", "", [])], "title")
    assert "not recorded" in figure.axes[0].texts[0].get_text()


def test_a_panel_a_target_with_both_lines(tmp_path: Path) -> None:
    figure = draw_growth(growth(), "title")
    assert [axes.get_ylabel() for axes in figure.axes] == ["error of speed (m/s)", "error of x (m)"]
    assert [line.get_label() for line in figure.axes[0].lines] == ["data sheet", "fitted"]
    assert save(draw_growth(growth(), "title"), tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
