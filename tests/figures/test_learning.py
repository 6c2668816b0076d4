"""The pictures of learned plants say what their numbers say."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tunefree_hil.figures.learning import Heading, draw_free_run, write_free_run, write_headings
from tunefree_hil.learn.free_run import Judged
from tunefree_hil.learn.free_run_table import table_of


def judged(kind: str, factor: float) -> Judged:
    rng = np.random.default_rng(1)
    growth = factor * rng.uniform(0.5, 1.5, (40, 4)) * np.array([0.1, 0.3, 2.0, 9.0])
    growth[30:, 3] = np.nan
    drives = tuple(f"drive {i % 8}" for i in range(40))
    hill = np.arange(40) % 4 == 0
    metres = np.full((40, 4), 50.0)
    return Judged(kind, (1.0, 3.0, 10.0, 30.0), drives, tuple(range(40)), hill, growth, growth * 0.01, growth * 0.1,
                  metres, 0.1, 0.01)  # fmt: skip


def test_free_run_says_by_how_much_the_hybrid_is_better(tmp_path: Path) -> None:
    tables = {
        kind: table_of(judged(kind, factor)) for kind, factor in (("physics", 1.0), ("hybrid", 0.5), ("paper", 8.0))
    }
    figure = draw_free_run(tables)
    assert "50 % less" in figure.get_suptitle()
    assert [axes.get_title(loc="left").split(":")[0] for axes in figure.axes] == ["Level ground", "Hills"]
    assert write_free_run(tmp_path / "free_run.png", tables).stat().st_size > 20_000


def test_free_run_with_nothing_to_compare(tmp_path: Path) -> None:
    table = table_of(judged("mlp", 1.0))
    table["hills"] = None
    assert write_free_run(tmp_path / "free_run.png", {"mlp": table}).is_file()


def test_headings_name_the_nearest(tmp_path: Path) -> None:
    time_s = np.linspace(0.0, 20.0, 400)
    truth = 0.4 * np.sin(0.5 * time_s)
    kinds = {"hybrid": truth + 0.001 * time_s, "lstm": truth + 0.01 * time_s, "mlp": truth - 0.03 * time_s}
    assert write_headings(tmp_path / "heading.png", Heading(time_s, truth, kinds, "u_turn")).stat().st_size > 20_000
