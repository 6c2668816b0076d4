"""The picture of errors on the vehicle has every set, and its title the ratios."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tools.measures.figures.vehicle_errors import LABELS, SetErrors, draw_errors
from tunefree_hil.figures import style

VEHICLES = {"one": SetErrors(0.2, 0.1, [0.05, 0.06, 0.04]), "other": SetErrors(0.3, 0.2, [0.5])}


def test_every_set_is_drawn_and_within_the_axis(tmp_path: Path) -> None:
    figure = draw_errors(dict.fromkeys(LABELS, VEHICLES), {"one": 0.25, "other": 1.5})
    assert figure.get_suptitle() == "Errors on the vehicle, tuned over plain manual: one 0.25, other 1.50"
    for axes, label in zip(figure.axes, LABELS.values(), strict=True):
        assert axes.get_ylabel() == label
        drawn = [list(np.asarray(line.get_ydata())) for line in axes.lines]
        assert drawn == [[0.2], [0.05, 0.06, 0.04], [0.1], [0.3], [0.5], [0.2]]
        assert axes.get_ylim()[0] == 0.0 and axes.get_ylim()[1] > 0.5
        assert [text.get_text() for text in axes.get_xticklabels()] == ["one", "other"]
    assert style.save(figure, tmp_path / "errors.png").stat().st_size > 10_000
