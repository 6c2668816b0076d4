"""Figure of a coverage."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tunefree_hil.collect.cells import PEDAL_BANDS, STEER_BANDS, cell_number
from tunefree_hil.collect.coverage import Coverage, speed_band_rows


def draw_map(path: Path, coverage: Coverage, title: str) -> Path:
    """Draw a coverage with a panel for each speed band. Returns the path."""
    from tunefree_hil.figures.learning.coverage import CoveragePanel, draw_coverage
    from tunefree_hil.figures.style import save

    panels = []
    for group in speed_band_rows(coverage):
        across = range(len(STEER_BANDS))[::-1]  # left is to the left
        numbers = [[cell_number(first._replace(steer=steer)) for steer in across] for first in group]
        have = np.array([[coverage.have_s(number) for number in row] for row in numbers])
        need = np.array([[coverage.counter.need[number] * coverage.dt_s for number in row] for row in numbers])
        panels.append(CoveragePanel(coverage.band_text(group[0]), have, need, PEDAL_BANDS, STEER_BANDS[::-1]))
    return save(draw_coverage(panels, coverage.quota_s, title), path)
