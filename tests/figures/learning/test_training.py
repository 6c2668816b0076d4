"""The pictures of learned plants say what their numbers say."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tunefree_hil.figures.learning.training import (
    HeadingRun,
    draw_free_run,
    draw_headings,
    kind_looks,
    write_free_run,
    write_headings,
)
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
    assert write_free_run(tmp_path / "free_run.png", tables).stat().st_size > 20_000


def test_free_run_with_nothing_to_compare(tmp_path: Path) -> None:
    table = table_from_errors(judged("mlp", 1.0))
    table["hills"] = None
    assert write_free_run(tmp_path / "free_run.png", {"mlp": table}).is_file()


def test_every_kind_has_a_look_of_its_own() -> None:
    kinds = ["physics", "hybrid", "lstm", "mlp", "rule_based", "paper", "paper at 0.05 s"]
    assert len({look.colour for look in kind_looks(kinds).values()}) == len(kinds)
    assert len(kind_looks([*kinds, "one more"])) == len(kinds) + 1


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
    assert write_headings(tmp_path / "heading.png", headings()).stat().st_size > 20_000


def test_headings_of_other_kinds_are_shown_where_there_are_no_such(tmp_path: Path) -> None:
    own = headings()
    assert "physics" in draw_headings(own._replace(kinds={"physics": own.truth})).get_suptitle()
