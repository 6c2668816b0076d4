"""The picture of a steering map: every speed with its samples, line and band; without samples it says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tunefree_hil.figures.learning.steering_map import SteeringCurve, draw_steering, write_steering_picture

POINTS = np.linspace(-0.02, 0.02, 21)


def curve(speed_mps: float) -> SteeringCurve:
    neutral = 45.0 * POINTS
    wheel = neutral + 0.064 * speed_mps**2 * POINTS
    samples = np.array([-0.015, 0.0, 0.01])
    measured = (45.0 + 0.064 * speed_mps**2) * samples
    return SteeringCurve(speed_mps, samples, measured, POINTS, wheel, wheel - 0.02, wheel + 0.02, neutral)


def test_all_speeds_lie_on_one_line_of_understeer() -> None:
    figure = draw_steering([curve(8.0), curve(16.0)], "title")
    figure.canvas.draw()
    whole, beyond = figure.axes
    assert len(whole.lines) == len(beyond.lines) == 2
    assert [text.get_text() for text in whole.get_legend().get_texts()] == ["8", "16"]
    for line in beyond.lines:
        slope = np.polyfit(np.asarray(line.get_xdata()), np.asarray(line.get_ydata()), 1)[0]
        assert slope == pytest.approx(0.064 * 180.0 / np.pi)
    dots = np.concatenate([np.asarray(one.get_offsets()) for one in beyond.collections if len(one.get_offsets()) == 3])
    assert dots[:, 1] == pytest.approx(0.064 * 180.0 / np.pi * dots[:, 0], abs=1e-6)
    assert "m/s²" in beyond.get_xlabel() and "deg" in whole.get_ylabel()


def test_without_samples_it_says_so(tmp_path: Path) -> None:
    figure = draw_steering([], "nothing")
    assert "not recorded" in figure.axes[0].texts[0].get_text()
    assert write_steering_picture(tmp_path / "a.png", [curve(8.0)], "title").read_bytes()[:4] == b"\x89PNG"
