"""Figures of grade, compare and explain: whole, readable, and true to what they were given."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tunefree_hil.figures import heat, oscillation, profile, style
from tunefree_hil.figures.tuning import importance, slices
from tunefree_hil.grade.table import HIGHLIGHTED, TABLE
from tunefree_hil.tune.insight import Importance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VALUES = {
    "first": {name: 0.01 * i for i, name in enumerate(TABLE)},
    "second": {name: None if i % 5 == 0 else 0.011 * i for i, name in enumerate(TABLE)},
}
SCENARIOS = ("left_turn", "u_turn", "double_lane_change", "stop_and_go", "side_pass", "serpentine", "right_turn")


def terms(columns: int) -> dict[str, dict[str, float]]:
    chance = np.random.default_rng(columns)
    names = [*list(TABLE)[: columns - 1], "re-plans"]
    found = {one: {name: float(chance.normal(0.0, 0.003)) for name in names} for one in SCENARIOS}
    found["u_turn"]["re-plans"] = -0.14
    return found


def cuts(count: int) -> dict[str, slices.ParameterSlice]:
    points = np.geomspace(1e-4, 0.1, 9)
    scores: list[float | None] = [0.2 + 0.1 * abs(float(np.log10(value / 0.003))) for value in points]
    scores[2], scores[8] = None, 9.0
    one = slices.ParameterSlice(points.tolist(), scores, 0.003, True, "s")
    flagged = one._replace(winner=1e-4, flag="on the lower edge of its box")
    return {f"group.p{i}": flagged if i == 1 else one for i in range(count)}


def wheel(frequency_hz: float) -> oscillation.WheelPicture:
    t = np.arange(750) * 0.04
    swing = 29.0 * np.sin(2.0 * np.pi * frequency_hz * t)
    return oscillation.WheelPicture("rav4: steering wheel swings 58 deg", swing + 90.0, swing, 0.04, (3.2, 14.0))


FOUND = {f"group.p{i}": Importance(0.5 / (i + 1), 0.3 - 0.2 * i, 100) for i in range(4)}
DRAWN: dict[str, Callable[[], Figure]] = {
    "profile": lambda: profile.draw_profile(VALUES, "all metrics of two runs"),
    "one log": lambda: profile.draw_profile({"log": VALUES["second"]}, "all metrics of one log"),
    "highlights": lambda: profile.draw_highlights(VALUES, "highlighted metrics"),
    "heat": lambda: heat.draw_heat(terms(19), "winner against the best manual"),
    "narrow heat": lambda: heat.draw_heat(terms(3), "winner against manual"),
    "slices": lambda: slices.draw_slices(cuts(11), 0.19, 0.25, "one parameter at a time"),
    "two slices": lambda: slices.draw_slices(cuts(2), 0.19, 0.25, "one parameter at a time"),
    "oscillation": lambda: oscillation.draw_oscillation(wheel(1.7)),
    "importance": lambda: importance.draw_importance(FOUND),
}


def texts(figure: Figure) -> list[Any]:
    from matplotlib.text import Text

    return [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]


def words(figure: Figure) -> list[str]:
    return [text.get_text() for text in texts(figure)]


@pytest.mark.slow
@pytest.mark.parametrize("name", DRAWN)
def test_a_picture_is_readable_and_whole(name: str) -> None:
    """As tests/figures/test_pictures.py: 14 pixels where it is shown 1400 wide, nothing outside."""
    figure = DRAWN[name]()
    figure.canvas.draw()
    width, height = figure.bbox.width, figure.bbox.height
    for text in texts(figure):
        shown_px = text.get_fontsize() / 72.0 * figure.dpi * min(1.0, 1400.0 / width)
        assert shown_px >= 14.0, text.get_text()
    outer = [text for axes in figure.axes for text in (axes.xaxis.label, *axes.texts, axes.title)]
    for text in [figure._suptitle, *outer]:  # type: ignore[attr-defined]
        box = text.get_window_extent()
        assert box.x0 >= -2 and box.y0 >= -2 and box.x1 <= width + 2 and box.y1 <= height + 2, text.get_text()


def test_every_metric_has_its_bar_and_its_number() -> None:
    said = words(DRAWN["profile"]())
    assert set(TABLE) <= set(said)
    missing = sum(value is None for value in VALUES["second"].values())
    assert said.count(" not available") == missing
    assert f" {style.number(0.01 * (len(TABLE) - 1))}" in said
    assert set(HIGHLIGHTED) <= set(words(DRAWN["highlights"]()))


def test_the_table_adds_up_on_the_picture() -> None:
    data = terms(3)
    said = words(DRAWN["narrow heat"]())
    total = 1e3 * sum(sum(row.values()) for row in data.values())
    assert f"{total:+.0f}" in said or f"{total:+.1f}" in said
    assert {"sum", "re-plans", *SCENARIOS} <= set(said)


def test_a_term_that_is_0_everywhere_has_no_column() -> None:
    data = {name: {"a": 0.1, "failure or cap": 0.0} for name in SCENARIOS}
    said = words(heat.draw_heat(data, "winner against manual"))
    assert "a" in said and "failure or cap" not in said
    same = words(heat.draw_heat({"s": {"a": 0.0}}, "nothing differs"))
    assert "sum" in same and "no difference in any term" in same


def test_a_term_that_would_be_shown_as_0_is_counted_and_summed() -> None:
    figure = heat.draw_heat({"s": {"a": 0.0004, "b": 0.00004}, "t": {"a": 0.0, "b": 0.00003}}, "title")
    said = words(figure)
    assert "a" in said and "b" not in said
    assert any("1 terms differ by less than 0.05" in one for one in said)
    assert said.count("+0.4") == 3 and "+0.5" in said, "cells and the column's sum; the whole has b in it"


def test_slices_mark_winner_manual_edge_and_what_is_above() -> None:
    figure = DRAWN["two slices"]()
    first, second = figure.axes

    def marked(marker: str) -> list[list[float]]:
        lines = [line for line in first.get_lines() if line.get_marker() == marker]
        return [point for line in lines for point in np.asarray(line.get_xydata()).tolist()]

    assert marked("*") == [[0.003, 0.19]]
    assert marked("^") == [[pytest.approx(0.1), pytest.approx(0.75)]], "9.0 is cut at three times the manual score"
    assert len(marked("s")) == 7, "one failed, one above"
    assert second.get_title(loc="left") == "on the lower edge of its box"


def test_importance_says_n_and_sign() -> None:
    said = words(DRAWN["importance"]())
    assert "Importance of the parameters, from 100 trials" in said
    assert any("larger is worse" in one for one in said) and any("larger is better" in one for one in said)
    few = importance.draw_importance({"a": Importance(None, 0.5, 5)})
    assert any("no shares from these trials" in one for one in words(few))


@pytest.mark.slow
def test_files(tmp_path: Path) -> None:
    written = [
        style.save(profile.draw_profile(VALUES, "all metrics"), tmp_path / "a.png"),
        style.save(profile.draw_highlights(VALUES, "highlights"), tmp_path / "b.png"),
        style.save(heat.draw_heat(terms(3), "difference"), tmp_path / "c.png"),
        style.save(slices.draw_slices(cuts(2), 0.19, 0.25, "slices"), tmp_path / "d.png"),
        style.save(importance.draw_importance(FOUND), tmp_path / "e.png"),
    ]
    assert sorted(tmp_path.iterdir()) == written
    assert all(path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" for path in written)


@pytest.mark.parametrize("frequency_hz", [0.8, 1.7, 4.0])
def test_the_spectrum_peaks_where_the_wheel_swings(frequency_hz: float) -> None:
    picture = wheel(frequency_hz)
    frequencies_hz, density = oscillation.amplitude_density(picture.residual_deg, picture.dt_s)
    assert frequencies_hz[np.argmax(density)] == pytest.approx(frequency_hz, abs=0.1)
    mean_square = float(np.sum(density**2) * (frequencies_hz[1] - frequencies_hz[0]))
    assert mean_square == pytest.approx(0.5 * 29.0**2, rel=0.05), "its area is the signal's power"
