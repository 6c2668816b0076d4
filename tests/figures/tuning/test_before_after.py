"""The figure of manual and tuned gains: its numbers are those of the columns, and nothing is cut off."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from matplotlib.text import Text

from tunefree_hil.figures.scenario import DrivePicture
from tunefree_hil.figures.tuning.before_after import (
    START_S,
    RoadPair,
    draw_before_after,
    mean_errors,
    rms_after_start,
)

TIME_S = np.arange(0.0, 10.0, 0.01)


def drive(label: str, size: float, **changed: Any) -> DrivePicture:
    """Errors whose RMS, as in the metrics, is `size` from START_S on, and ten times as large before."""
    count = np.count_nonzero(TIME_S >= START_S)
    error = np.where(TIME_S < START_S, 10.0 * size, size) * math.sqrt((count - 1) / count)
    columns = {"t_s": TIME_S, "lateral_error_m": error, "station_error_m": -2.0 * error, "speed_error_mps": 3.0 * error}
    columns |= {"cmd_steer_rad": error, "accel_mps2": error, "ref_accel_mps2": 0.0 * error}
    return DrivePicture(label, {**columns, **changed})


def pair(road: str, manual: float, tuned: float) -> RoadPair:
    return RoadPair(road, drive("manual (mrac_on)", manual), drive("tuned", tuned))


def texts(pairs: list[RoadPair]) -> list[str]:
    return [text.get_text().strip() for text in draw_before_after(pairs).findobj(Text) if text.get_text().strip()]


def test_the_start_does_not_count() -> None:
    assert rms_after_start(drive("tuned", 0.1), "lateral_error_m") == pytest.approx(0.1)
    assert math.isnan(rms_after_start(drive("tuned", 0.1), "yaw_rate_radps"))


def test_a_column_that_some_drives_lack_is_the_mean_of_the_others() -> None:
    lacking = DrivePicture("tuned", {"t_s": TIME_S})
    assert mean_errors([drive("tuned", 0.1), drive("tuned", 0.3), lacking])["speed_error_mps"] == pytest.approx(0.6)
    assert math.isnan(mean_errors([lacking])["speed_error_mps"])


def test_it_says_the_means_and_shows_the_road_that_differs_most() -> None:
    shown = texts([pair("turn", 0.2, 0.1), pair("hills", 0.4, 0.1), pair("straight", 0.3, 0.4)])
    headline = "RMS errors, mean of 3 unseen roads: lateral 0.3 -> 0.2 m, station 0.6 -> 0.4 m, speed 0.9 -> 0.6 m/s"
    assert headline in shown
    assert "largest difference:\nhills" in shown
    assert {"turn", "hills", "straight", "manual (mrac_on)", "tuned"} <= set(shown)


def test_a_drive_without_errors_is_said() -> None:
    lacking = DrivePicture("tuned", {"t_s": TIME_S})
    shown = texts([RoadPair("turn", lacking._replace(label="manual"), lacking)])
    assert "RMS errors, mean of 1 unseen roads: not recorded" in shown
    assert any("not recorded" in text and "lateral" in text for text in shown)


def test_nothing_is_cut_off() -> None:
    figure = draw_before_after([pair(f"double_lane_change_26mps_s10001_{k}", 0.3, 0.1) for k in range(20)])
    figure.canvas.draw()
    width, height = figure.bbox.width, figure.bbox.height
    words = [text for text in figure.findobj(Text) if any(letter.isalpha() for letter in text.get_text())]
    assert len(words) > 25
    for text in words:  # numbers of ticks outside the range are not drawn
        box = text.get_window_extent()
        assert box.x0 >= -2 and box.y0 >= -2 and box.x1 <= width + 2 and box.y1 <= height + 2, text.get_text()
