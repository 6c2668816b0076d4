"""The picture of ranks on plant and vehicle says what its numbers say."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tools.measures.figures.transfer import TransferGrades, draw_transfer
from tunefree_hil.figures.style import save

GRADES = np.geomspace(0.1, 10.0, 60)


def test_it_names_the_worse_vehicle_and_draws_every_set(tmp_path: Path) -> None:
    noisy = GRADES * np.exp(np.random.default_rng(1).normal(0.0, 0.2, GRADES.size))
    vehicles = {
        "one": {"hybrid": TransferGrades(GRADES, noisy, 0.95), "physics": TransferGrades(GRADES, noisy[::-1], 0.1)},
        "other": {"hybrid": TransferGrades(GRADES, noisy, 0.91)},
    }
    figure = draw_transfer(vehicles)
    assert "0.91" in figure.get_suptitle() and "2" in figure.get_suptitle()
    drawn = [len(dots.get_offsets()) for axes in figure.axes for dots in axes.collections]
    assert drawn == [GRADES.size] * 3
    assert "physics 0.10" in figure.axes[0].get_title(loc="left")
    assert save(draw_transfer(vehicles), tmp_path / "transfer.png").stat().st_size > 20_000


def test_without_a_hybrid_it_claims_nothing() -> None:
    figure = draw_transfer({"one": {"lstm": TransferGrades(GRADES, GRADES, 1.0)}})
    assert "hybrid" not in figure.get_suptitle()
