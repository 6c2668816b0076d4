"""The trade of a study between its objectives: the front and the winner as data, as text and as a picture.

A search by the score alone has a front too: the parts of its score follow from the stored grades.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.grade.objectives import OBJECTIVES, choose_objectives, measure_objectives
from tunefree_hil.tune.journal import slot_key
from tunefree_hil.tune.pareto import find_study_front, with_trades
from tunefree_hil.tune.trial import Baseline, ScoredStudy, Trial

AXIS_TEXT = {
    "tracking": "tracking cost: performance and safety (lower is better)",
    "comfort": "comfort cost: comfort and effort (lower is better)",
}
FIGURE = "pareto.png"  # in the figures of the run


class TradedTrials(NamedTuple):
    """The trials and baselines of a study with their objectives. names: of the objectives, in their order."""

    names: tuple[str, ...]
    trials: Sequence[Trial]
    baselines: Mapping[str, Baseline]


def read_traded(study: ScoredStudy) -> TradedTrials:
    """The trials of a study of several objectives."""
    return TradedTrials(study.settings.objectives, study.trials(), study.baselines())


def split_scores(trials: Sequence[Trial], baselines: Mapping[str, Baseline], weights: WeightsSpec) -> TradedTrials:
    """The trials of a search by the score, with the parts of their scores in the model as it is.

    Raises:
        InputError: The weights have no metric of an objective, or a drive of an earlier version lacks them.
    """
    names = choose_objectives(tuple(OBJECTIVES), weights, weights.path)

    def parts(scored: Trial | Baseline) -> tuple[float, ...]:
        return measure_objectives(scored.scenarios, weights, names)

    split = {name: baseline._replace(objectives=parts(baseline)) for name, baseline in baselines.items()}
    return TradedTrials(names, with_trades([trial._replace(objectives=parts(trial)) for trial in trials], split), split)


def trade_data(traded: TradedTrials, winner: int) -> dict[str, Any]:
    """Plain data for JSON: the front, its two ends, the winner and the best manual set.

    winner: Its slot.
    """
    front = find_study_front(traded.trials, traded.baselines)
    by_slot = {trial.slot: trial for trial in traded.trials}
    on_front = {trial.slot for trial in front.trials}
    return {
        "names": list(traded.names),
        "manual": {"name": front.manual, **dict(zip(traded.names, front.reference, strict=True))},
        "winner": {**_point_data(traded.names, by_slot[winner]), "on_front": winner in on_front},
        "ends": {name: _point_data(traded.names, front.extreme(i)) for i, name in enumerate(traded.names)},
        "front": [_point_data(traded.names, trial) for trial in front.trials],
    }


def _point_data(names: Sequence[str], trial: Trial) -> dict[str, Any]:
    values = dict(zip(names, trial.objectives, strict=True))
    return {"slot": trial.slot, "score": trial.score, "trade": trial.trade, **values}


def trade_text(data: Mapping[str, Any]) -> str:
    """What the winner gains on the best manual set, and what it leaves to both ends of the front."""
    names, manual, winner = data["names"], data["manual"], data["winner"]
    gains = " and ".join(f"{name} cost {_change(winner[name], manual[name])}" for name in names)
    parts = [f"the trade: {gains} against {manual['name']}"]
    for name in names:
        end = data["ends"][name]
        if end["slot"] == winner["slot"]:
            parts.append(f"no trial has a lower {name} cost")
            continue
        others = [f"a {other} cost of {_change(end[other], winner[other])}" for other in names if other != name]
        lowest = f"{slot_key(end['slot'])} has the lowest {name} cost, {_change(end[name], winner[name])}"
        parts.append(f"{lowest}, and {' and '.join(others)} against the winner")
    if not winner["on_front"]:
        parts.append("the winner is not on the front: the checks after the search rejected better trials")
    return "; ".join(parts)


def _change(value: float, before: float) -> str:
    """'0.283 (-11 %)'."""
    return f"{value:.3f} ({_percent_text(value, before)})"


def _percent_text(value: float, before: float) -> str:
    """'-11 %'; a cost of 0 has no shares."""
    return f"{100.0 * (value / before - 1.0):+.0f} %" if before > 0.0 else "from 0"


def trade_table(data: Mapping[str, Any]) -> list[str]:
    """Lines with the winner, the ends of the front and the best manual set."""
    names, winner = data["names"], data["winner"]
    rows = {f"{slot_key(winner['slot'])}, the winner": winner}
    rows |= {f"{slot_key(end['slot'])}, lowest {name} cost": end for name, end in data["ends"].items()}
    rows[data["manual"]["name"]] = data["manual"]
    width, columns = max(len(row) for row in rows), [len(f"{name} cost") for name in names]
    head = "  ".join(f"{name} cost" for name in names)
    lines = [f"{len(data['front'])} trials are on the front of {' and '.join(names)}:", f"{'':{width}}  {head}"]
    for row, values in rows.items():
        numbers = "  ".join(f"{values[name]:{size}.3f}" for name, size in zip(names, columns, strict=True))
        lines.append(f"{row:{width}}  {numbers}")
    return lines


def draw_trade(traded: TradedTrials, data: Mapping[str, Any], path: Path) -> Path:
    """Write the picture of all trials, the front, the manual sets and the winner. data: of `trade_data`."""
    from tunefree_hil.figures.style import save
    from tunefree_hil.figures.tuning.pareto import FrontPicture, draw_front

    x, y = data["names"]
    picture = FrontPicture(
        trials=[(trial.objectives[0], trial.objectives[1]) for trial in traded.trials],
        is_met=[trial.violation == 0.0 for trial in traded.trials],
        front=[(point[x], point[y]) for point in data["front"]],
        manual={name: (base.objectives[0], base.objectives[1]) for name, base in traded.baselines.items()},
        reference=data["manual"]["name"],
        winner=(data["winner"][x], data["winner"][y]),
    )
    return save(draw_front(picture, (AXIS_TEXT[x], AXIS_TEXT[y]), _headline(data)), path)


def _headline(data: Mapping[str, Any]) -> str:
    manual, winner = data["manual"], data["winner"]
    changes = [f"{name} cost {_percent_text(winner[name], manual[name])}" for name in data["names"]]
    return f"The winner against {manual['name']}: {', '.join(changes)}"
