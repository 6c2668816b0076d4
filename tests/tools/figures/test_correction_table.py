"""The table of corrections: every ratio is written, and swings where there are any."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tools.measures.figures.correction_table import CorrectionCells, draw_corrections
from tunefree_hil.figures import style

CELLS = CorrectionCells([[0.5, 1.0, 2.0], [0.25, 1.01, math.nan]], [0, 3])


@pytest.mark.parametrize("count", [1, 5])
def test_every_number_is_there(tmp_path: Path, count: int) -> None:
    figure = draw_corrections({f"panel {i}": CELLS for i in range(count)}, ["map", "preview"])
    assert len(figure.axes) == count
    for axes in figure.axes:
        assert [text.get_text() for text in axes.texts] == ["0.50", "1.00", "2.00", "0.25", "1.01", "3"]
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["map", "preview"]
    assert style.save(figure, tmp_path / "table.png").stat().st_size > 5_000
