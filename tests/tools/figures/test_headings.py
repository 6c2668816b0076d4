"""The picture of the headings says what its numbers say."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tools.measures.figures.headings import HeadingRun, draw_headings
from tunefree_hil.figures.style import save


def headings(**more: np.ndarray) -> HeadingRun:
    time_s = np.linspace(0.0, 20.0, 400)
    truth = 0.4 * np.sin(0.5 * time_s)
    kinds = {"lstm": truth + 0.01 * time_s, "hybrid": truth + 0.001 * time_s, "mlp": truth - 0.3 * time_s, **more}
    return HeadingRun(time_s, truth, kinds, "u_turn")


def test_headings_say_how_far_each_is_off_the_nearest_first(tmp_path: Path) -> None:
    figure = draw_headings(headings(physics=np.zeros(400)))
    above, below = figure.axes
    said = figure.get_suptitle()
    assert said.index("hybrid 0.57") < said.index("lstm 5.73") < said.index("mlp 172") and "physics" not in said
    assert len(above.lines) == 4 and len(below.lines) == 3
    assert max(np.abs(above.get_ylim())) < 60.0  # a net that spins does not flatten the others
    assert min(float(line.get_ydata().min()) for line in below.lines) >= 0.01
    assert save(draw_headings(headings()), tmp_path / "heading.png").stat().st_size > 20_000


def test_headings_of_other_kinds_are_shown_where_there_are_no_such(tmp_path: Path) -> None:
    own = headings()
    assert "physics" in draw_headings(own._replace(kinds={"physics": own.truth})).get_suptitle()
