"""The map's two pictures: every sample is there, and what no data back is dashed and hatched."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tunefree_hil.figures.learning.map import MapPicture, draw_map, draw_map_data
from tunefree_hil.figures.style import save

SPEEDS, COMMANDS = np.array([0.5, 2.0, 5.0, 10.0]), np.array([-0.4, -0.3, -0.2, 0.0, 0.2, 0.3, 0.5])


def picture(gaps: bool = True) -> MapPicture:
    rng = np.random.default_rng(1)
    command = np.concatenate([rng.uniform(-0.4, -0.16, 60), np.full(20, 0.15), rng.uniform(0.16, 0.5, 50)])
    speed = rng.uniform(0.5, 10.0, len(command))
    accel = np.outer(np.ones(4), [-5.0, -3.0, -0.3, -0.1, 0.3, 1.0, 2.0]) - 0.05 * SPEEDS[:, None]
    support = np.ones_like(accel)
    if gaps:
        support[3, 5:] = 0.0
        support[2, 1] = 0.5
    return MapPicture(speed, command, 4.0 * command, SPEEDS, COMMANDS, accel, support, 0.15)


def dashes(figure, axes: int) -> set[bool]:
    return {bool(line.is_dashed()) for line in figure.axes[axes].lines if len(line.get_xdata()) == 2}


def test_all_samples_are_drawn_on_the_side_of_their_pedal() -> None:
    figure = draw_map_data(picture())
    figure.canvas.draw()
    brake, throttle = figure.axes[:2]
    assert [len(axes.collections[0].get_offsets()) for axes in (brake, throttle)] == [80, 70]
    assert brake.get_title(loc="left") == "60 samples" and throttle.get_title(loc="left") == "50 samples"
    assert brake.xaxis_inverted() and not throttle.xaxis_inverted()
    assert "130 samples up to" in figure.get_suptitle()
    assert brake.get_ylabel() == "speed (m/s)" and "brake" in brake.get_xlabel()


def test_gaps_are_dashed_and_hatched() -> None:
    figure = draw_map(picture())
    figure.canvas.draw()
    assert dashes(figure, 0) == {True, False} and dashes(figure, 1) == {True, False}
    assert any(one.get_hatch() for one in figure.axes[3].collections) or figure.axes[3].collections[-1].hatches
    assert "89 % of it backed by data" in figure.get_suptitle()


def test_without_gaps_nothing_is_dashed() -> None:
    figure = draw_map(picture(gaps=False))
    figure.canvas.draw()
    assert dashes(figure, 0) == dashes(figure, 1) == {False}
    assert "100 %" in figure.get_suptitle()


@pytest.mark.parametrize("draw", [draw_map, draw_map_data])
def test_they_are_written_as_pictures(draw, tmp_path: Path) -> None:
    assert save(draw(picture()), tmp_path / "map.png").read_bytes()[:4] == b"\x89PNG"
