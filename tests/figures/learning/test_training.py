"""The pictures of learned plants say what their numbers say."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tunefree_hil.figures.learning.training import draw_free_run, kind_looks
from tunefree_hil.figures.style import save
from tunefree_hil.learn.evaluation.free_run import FreeRunErrors, table_from_errors


def judged(kind: str, factor: float) -> FreeRunErrors:
    rng = np.random.default_rng(1)
    growth = factor * rng.uniform(0.5, 1.5, (40, 4)) * np.array([0.1, 0.3, 2.0, 9.0])
    growth[30:, 3] = np.nan
    drives = tuple(f"drive {i % 8}" for i in range(40))
    hill = np.arange(40) % 4 == 0
    metres = np.full((40, 4), 50.0)
    return FreeRunErrors(kind, (1.0, 3.0, 10.0, 30.0), drives, hill, growth, growth * 0.01, growth * 0.1,
                  metres, 0.1, 0.01)  # fmt: skip


def test_free_run_says_by_how_much_the_hybrid_is_better(tmp_path: Path) -> None:
    tables = {
        kind: table_from_errors(judged(kind, factor))
        for kind, factor in (("physics", 1.0), ("hybrid", 0.5), ("paper", 8.0))
    }
    figure = draw_free_run(tables)
    assert "50 % less" in figure.get_suptitle()
    assert [axes.get_title(loc="left").split(":")[0] for axes in figure.axes] == ["Level ground", "Hills"]
    assert save(draw_free_run(tables), tmp_path / "free_run.png").stat().st_size > 20_000


def test_free_run_with_nothing_to_compare(tmp_path: Path) -> None:
    table = table_from_errors(judged("mlp", 1.0))
    table["hills"] = None
    assert save(draw_free_run({"mlp": table}), tmp_path / "free_run.png").is_file()


def test_every_kind_has_a_look_of_its_own() -> None:
    kinds = ["physics", "hybrid", "lstm", "mlp", "rule_based", "paper", "paper at 0.05 s"]
    assert len({look.colour for look in kind_looks(kinds).values()}) == len(kinds)
    assert len(kind_looks([*kinds, "one more"])) == len(kinds) + 1
