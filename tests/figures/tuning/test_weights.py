"""The figure of regressed weights shows every metric, every fold, and both kinds of margins."""

from __future__ import annotations

import numpy as np
from matplotlib.patches import Rectangle

from tunefree_hil.figures.tuning.weights import WeightsPicture, draw_weights


def test_the_panels_show_what_they_are_given() -> None:
    margins = np.linspace(-0.2, 0.6, 40)
    picture = WeightsPicture(
        base="default",
        metrics={"lateral_rms_after_start": 2.0, "steer_rate_rms": 30.0},
        base_metrics={"lateral_rms_after_start": 9.0, "steer_rate_rms": 22.0},
        fold_accuracies={"regressed": (0.9, 1.0, 0.8), "default": (0.5, 0.6, 0.7)},
        permuted=0.5,
        margins={"regressed": margins, "default": margins - 0.3},
        margin=0.05,
    )
    figure = draw_weights(picture)
    weights, folds, histogram = figure.axes
    assert [text.get_text() for text in weights.get_yticklabels()] == list(picture.metrics)
    assert sorted(bar.get_width() for bar in weights.patches if isinstance(bar, Rectangle)) == [2.0, 9.0, 22.0, 30.0]
    lines = {str(line.get_label()): np.asarray(line.get_ydata()).tolist() for line in folds.lines}
    assert lines["tuned: regressed"] == [90.0, 100.0, 80.0]
    assert lines["permuted labels"] == [50.0, 50.0]
    assert len(histogram.patches) == 2
    assert "75 % of 40 held-out pairs" in figure.get_suptitle()
