"""The figure of margins: every vector, every changed car, and the numbers that it was given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.jobs.made_margins import made_margins
from tunefree_hil.figures.style import save
from tunefree_hil.figures.tuning.margins import draw_margins
from tunefree_hil.grade.margins import POINTS


def texts(margins: dict[str, Any]) -> list[str]:
    from matplotlib.text import Text

    return [text.get_text().strip() for text in draw_margins(margins, "tuned").findobj(Text) if text.get_text().strip()]


def test_it_shows_what_it_was_given() -> None:
    shown = texts(made_margins())
    assert "Delay margin of tuned: 60 ms, of manual: 110 ms; 0 of 30 drives fail within ±20 %" in shown
    assert "60 ms  u_turn: re-plan" in shown and "0 ms  u_turn: re-plan" in shown
    assert shown.count("2.00 ▸") == 3 and shown.count("0.70") == 3
    assert shown.count("1") == 3 and shown.count("·") == 3 * (sum(map(len, POINTS.values())) - 1)
    assert {"mass +30 %", "steer gain -40 %", "mass, times, friction +30 +40 -40 %"} <= set(shown)
    assert all(shown.count(name) >= 2 for name in ("tuned", "manual", "shipped"))


def test_it_is_readable_and_whole() -> None:
    """As tests/figures/test_pictures.py: 14 pixels where it is shown 1400 wide, nothing outside."""
    figure = draw_margins(made_margins(), "tuned")
    figure.canvas.draw()
    width, height = figure.bbox.width, figure.bbox.height
    shown = [text for axes in figure.axes for text in (axes.xaxis.label, *axes.texts) if text.get_text().strip()]
    for text in (*shown, *figure.axes[2].get_xticklabels()):
        box, size_pt = text.get_window_extent(), float(text.get_fontsize())
        assert size_pt / 72.0 * figure.dpi * min(1.0, 1400.0 / width) >= 14.0, text.get_text()
        assert box.x0 >= -2 and box.y0 >= -2 and box.x1 <= width + 2 and box.y1 <= height + 2, text.get_text()


def test_the_strip_has_the_20_per_cent_on_the_left() -> None:
    from matplotlib.figure import Figure

    figure = draw_margins(made_margins(), "tuned")
    assert isinstance(figure, Figure)
    strip = figure.axes[2]
    labels = [label.get_text() for label in strip.get_xticklabels()]
    (line,) = strip.get_lines()
    border = int(line.get_xdata()[0] + 0.5)  # type: ignore[index]
    assert all("30 %" not in one and "40 %" not in one for one in labels[:border])
    assert all("30 %" in one or "40" in one for one in labels[border:]) and len(labels) == border + 13


def test_without_a_manual_vector_to_compare_with(tmp_path: Path) -> None:
    margins = made_margins({"tuned": 0.06, "manual": 0.0})
    assert margins["against"] is None
    assert "Delay margin of tuned: 60 ms; 0 of 30 drives fail within ±20 %" in texts(margins)
    path = save(draw_margins(margins, "tuned"), tmp_path / "figures" / "margins.png")
    assert path.stat().st_size > 20_000 and list(path.parent.iterdir()) == [path]
