"""Pictures of a gap: what they must show is in them, whatever is missing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tunefree_hil.figures.gap.gap_closed import SignalErrors, SignalTrace, draw_errors, draw_signature, draw_traces
from tunefree_hil.figures.gap.links import CandidateEvidence, RegionMisfit, draw_evidence, draw_regions
from tunefree_hil.figures.style import save

REGIONS = [
    RegionMisfit("speed (m/s) 0 to 8", 0.1, 3.0, 1.5, 6.0, True),
    RegionMisfit("speed (m/s) 8 to 16", 0.02, 1e-9, 0.0, 0.5, False),
]
STEPS = [CandidateEvidence("steer_lag", 900.0, 850.0, True), CandidateEvidence("aero_drag", -1.0, -0.5, False)]
TIME = np.linspace(0.0, 8.0, 801)
BARS = [
    SignalErrors("report.steer_rad", "rad", {"before": 0.09, "recalibrated": 0.08, "after": 0.001, "floor": 0.001}),
    SignalErrors("report.throttle_frac", "1", {"before": 0.0, "recalibrated": 0.0, "after": 0.0, "floor": 0.0}),
]


def made_run() -> SignalTrace:
    late = {"before": np.sin(TIME), "recalibrated": np.sin(TIME), "after": np.sin(TIME - 0.2)}
    return SignalTrace("report.steer_rad", "rad", TIME, np.sin(TIME - 0.2), late)


def words_of(axes: Any) -> list[str]:
    return [text.get_text() for text in axes.texts]


def test_regions_are_in_their_order_and_cut_at_the_edge() -> None:
    axes: Any = draw_regions(REGIONS, "rad", "Where").axes[0]
    assert [tick.get_text() for tick in axes.get_yticklabels()] == [one.label for one in REGIONS]
    assert words_of(axes)[0].startswith("0.1 rad") and axes.get_xlim() == (0.05, 20.0)
    assert min(bar.get_x() + min(bar.get_width(), 0.0) for bar in axes.patches) == pytest.approx(0.05)


def test_the_ladder_has_the_best_on_top_and_the_line_to_pass() -> None:
    axes: Any = draw_evidence(STEPS[::-1], 6.0, "Evidence").axes[0]
    assert [tick.get_text() for tick in axes.get_yticklabels()] == ["steer_lag", "aero_drag"]
    assert any(list(line.get_xdata()) == [6.0, 6.0] for line in axes.lines)


def test_recalibration_alone_is_always_a_bar() -> None:
    axes: Any = draw_errors(BARS, "Shrink").axes[0]
    labels = axes.get_legend_handles_labels()[1]
    assert labels == ["original model", "recalibration only", "repaired", "floor"]
    widths = [bar.get_width() for bar in axes.patches]
    assert max(widths) == 100.0 and min(widths) == 0.0 and " 0.08 rad" in words_of(axes)
    bare = [one._replace(errors={"before": 1.0, "recalibrated": 0.9, "floor": 0.1}) for one in BARS]
    assert "repaired" not in draw_errors(bare, "").axes[0].get_legend_handles_labels()[1]


def test_traces_and_signature_show_every_variant() -> None:
    axes = draw_traces([made_run()], "Traces").axes[0]
    assert {"measured", "original model", "recalibration only", "repaired"} <= {line.get_label() for line in axes.lines}
    left, right = draw_signature(made_run(), made_run(), "Signature").axes
    repaired = next(line for line in left.lines if line.get_label() == "repaired")
    assert np.abs(np.asarray(repaired.get_ydata())).max() == pytest.approx(0.0, abs=1e-12) and len(right.lines) == 3


def test_empty_ones_say_so_and_all_are_written(tmp_path: Path) -> None:
    for figure in (draw_regions([], "", ""), draw_evidence([], 6.0, ""), draw_errors([], ""), draw_traces([], "")):
        assert "not recorded" in figure.axes[0].texts[0].get_text()
    paths = [
        save(draw_regions(REGIONS, "rad", "a"), tmp_path / "where.png"),
        save(draw_evidence(STEPS, 6.0, "b"), tmp_path / "ladder.png"),
        save(draw_errors(BARS, "c"), tmp_path / "shrink.png"),
        save(draw_traces([made_run()], "d"), tmp_path / "runs.png"),
        save(draw_signature(made_run(), made_run(), "e"), tmp_path / "signature.png"),
    ]
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in paths)
