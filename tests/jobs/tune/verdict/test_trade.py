"""The trade as data, text and table; and the parts of a search by the score."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_weights
from tunefree_hil.grade.score import ScenarioGrade
from tunefree_hil.jobs.tune.verdict.trade import (
    TradedTrials,
    draw_trade,
    split_scores,
    trade_data,
    trade_table,
    trade_text,
)
from tunefree_hil.tune.pareto import with_trades
from tunefree_hil.tune.trial import Baseline, Trial

POINTS = [(0.17, 0.17), (0.28, 0.13), (0.6, 0.12), (0.5, 0.15)]
BASELINES = {"mrac_on": Baseline({}, 0.23, {}, 0.0, (0.32, 0.15)), "shipped": Baseline({}, 0.3, {}, 0.0, (0.4, 0.14))}
TRIALS = with_trades([Trial(i, i, {}, 0.2, {}, objectives=point) for i, point in enumerate(POINTS)], BASELINES)
TRADED = TradedTrials(("tracking", "comfort"), TRIALS, BASELINES)
DEFAULT = load_weights("default")


def test_the_data_have_the_front_and_its_ends() -> None:
    data = trade_data(TRADED, 1)
    assert [point["slot"] for point in data["front"]] == [0, 1, 2]
    assert {name: end["slot"] for name, end in data["ends"].items()} == {"tracking": 0, "comfort": 2}
    assert data["winner"]["on_front"] and data["winner"]["trade"] == TRIALS[1].trade
    assert data["manual"] == {"name": "mrac_on", "tracking": 0.32, "comfort": 0.15}


def test_the_text_says_what_the_winner_costs_against_both_ends() -> None:
    assert trade_text(trade_data(TRADED, 1)) == (
        "the trade: tracking cost 0.280 (-12 %) and comfort cost 0.130 (-13 %) against mrac_on; "
        "trial 1 has the lowest tracking cost, 0.170 (-39 %), and a comfort cost of 0.170 (+31 %) against the winner; "
        "trial 3 has the lowest comfort cost, 0.120 (-8 %), and a tracking cost of 0.600 (+114 %) against the winner"
    )
    assert "no trial has a lower tracking cost" in trade_text(trade_data(TRADED, 0))
    assert trade_text(trade_data(TRADED, 3)).endswith(
        "not on the front: the checks after the search rejected better trials"
    )


def test_the_table_has_the_winner_the_ends_and_the_manual_set() -> None:
    head, columns, *rows = trade_table(trade_data(TRADED, 1))
    assert head == "3 trials are on the front of tracking and comfort:" and "tracking cost  comfort cost" in columns
    assert [row.split("  ")[0] for row in rows] == [
        "trial 2, the winner", "trial 1, lowest tracking cost", "trial 3, lowest comfort cost", "mrac_on",
    ]  # fmt: skip
    assert rows[0].split()[-2:] == ["0.280", "0.130"]


def test_the_picture_is_written(tmp_path: Path) -> None:
    path = draw_trade(TRADED, trade_data(TRADED, 1), tmp_path / "figures" / "pareto.png")
    assert path.stat().st_size > 20_000 and list(path.parent.iterdir()) == [path]


def graded(tracking: float, comfort: float) -> dict[str, Any]:
    values = {name: tracking for name in DEFAULT.metrics} | {"steer_rate_rms": comfort, "pedal_rate_rms": comfort}
    others = dict.fromkeys(("lateral_jerk_rms", "longitudinal_jerk_rms", "pedal_alternation"), comfort)
    return {"bend": ScenarioGrade("bend", 0.2, {**values, **others}, 0, "finished", 100).as_data()}


def test_a_search_by_score_is_split_into_its_parts() -> None:
    trials = [Trial(i, i, {}, 0.2, graded(*point)) for i, point in enumerate(POINTS)]
    split = split_scores(trials, {"manual": Baseline({}, 0.2, graded(0.32, 0.15))}, DEFAULT)
    for trial, point in zip(split.trials, POINTS, strict=True):
        assert trial.objectives == pytest.approx(point)
    assert [point["slot"] for point in trade_data(split, 0)["front"]] == [0, 1, 2]
    with pytest.raises(InputError, match="no metric of comfort or effort"):
        split_scores(trials, {}, load_weights("paper"))
