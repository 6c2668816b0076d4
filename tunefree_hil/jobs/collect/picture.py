"""Coverage as the panels of its picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tunefree_hil.collect.cells import PEDALS, STEERS, number_of
from tunefree_hil.collect.coverage import Coverage, groups


def draw_map(path: Path, coverage: Coverage, title: str) -> Path:
    """The picture of a coverage, a panel for each band of speed; its path."""
    from tunefree_hil.figures.learning.coverage import Panel, write_coverage

    panels = []
    for group in groups(coverage):
        across = range(len(STEERS))[::-1]  # left is to the left
        numbers = [[number_of(first._replace(steer=steer)) for steer in across] for first in group]
        have = np.array([[coverage.have_s(number) for number in row] for row in numbers])
        need = np.array([[coverage.counter.need[number] * coverage.dt_s for number in row] for row in numbers])
        panels.append(Panel(coverage.band_words(group[0]), have, need, PEDALS, STEERS[::-1]))
    return write_coverage(path, panels, coverage.quota_s, title)
