"""Fig. 10: the lateral weights Q1 and Q3 that searches with 6 and with 11 parameters find."""

from __future__ import annotations

from tools.reproduction.context import COMPLETE_BENCH, Context
from tools.reproduction.fig8 import SEARCHES
from tools.reproduction.figures.planes import WinnerPoint, draw_winners
from tools.reproduction.records import Claim, Method, Record, Value
from tools.reproduction.searches import SearchBench, SearchResult, SearchSetting
from tunefree_hil.figures.tuning.scatter import ParameterBox

NAME = "fig10"
FIRST, THIRD = "lqr.q1", "lqr.q3"
SAMPLER = "tpe_independent"
SIZES = (("lateral", 100), ("lateral", 200), ("lateral", 400), ("complete", 200), ("complete", 400), ("complete", 800))
COUNTS = {"lateral": 6, "complete": 11}  # parameters of a set


def settings(seed: int, is_quick: bool = False) -> tuple[SearchSetting, ...]:
    """Each with a seed of its own, so that no search is the beginning of another."""
    return tuple(
        SearchSetting(name, SAMPLER, max(trials // 20, 8) if is_quick else trials, seed + k)
        for k, (name, trials) in enumerate(SIZES)
    )


def complete_setting(context: Context) -> SearchSetting:
    """The longest search with all parameters."""
    return settings(context.seed, context.is_quick)[-1]


def search_all(context: Context, bench: SearchBench) -> list[SearchResult]:
    """Run or continue all searches."""
    listed = settings(context.seed, context.is_quick)
    total, done, results = sum(setting.trials for setting in listed), 0, []
    for setting in listed:
        before = done

        def report(trials: int, before: int = before, label: str = _label(setting)) -> None:
            context.progress.update((before + trials) / total, f"{label}: {trials}")

        results.append(bench.search(setting, report))
        done += setting.trials
    return results


def reproduce(context: Context) -> Record:
    """Search with both numbers of parameters and several numbers of trials."""
    with SearchBench(COMPLETE_BENCH, context.folders.work / SEARCHES) as bench:
        results = search_all(context, bench)
        manual, manual_score = bench.manual(), bench.score_manual()
        axes = {axis.name: axis for axis in bench.space("lateral").axes}
    boxes = {name: ParameterBox(axes[name].low, axes[name].high, axes[name].log) for name in (FIRST, THIRD)}
    points = [_point(result) for result in results]
    better = sum(point.score < manual_score for point in points)
    sentence = f"{better} of {len(points)} winners score better than the manual set"
    figure = draw_winners(
        points,
        WinnerPoint("manual", manual[FIRST], manual[THIRD], manual_score, False),
        ((FIRST, boxes[FIRST]), (THIRD, boxes[THIRD])),
        sentence,
    )
    return Record(
        name=NAME,
        title="Lateral weights Q1 and Q3, 6 and 11 parameters",
        paper="Fig. 10: Q1 and Q3 found with several numbers of parameters and iterations; some lie apart from the "
        "manual ones and drive better in simulation. A picture without numbers.",
        claim=Claim("The winners of all settings score better than the manual set.", better == len(points)),
        values=(
            Value("manual set", f"Q1 {manual[FIRST]:.3g}, Q3 {manual[THIRD]:.3g}, score {manual_score:.4f}"),
            *(Value(point.label, f"Q1 {point.x:.3g}, Q3 {point.y:.3g}, score {point.score:.4f}") for point in points),
        ),
        method=Method(
            f"{COMPLETE_BENCH}, its seven scenarios on its plant, score alone",
            f"{len(points)} searches",
            f"searches {context.seed} to {context.seed + len(points) - 1}, one each",
            f"Sampler {SAMPLER} in the compiled batch, eight trials at a time; 6 parameters are the four LQR weights "
            "and the two of MRAC, 11 these and the five longitudinal gains.",
        ),
        difference="Q2 and Q4, of which the manual set has 0, are searched from 0.001 on, so the manual set lies "
        "outside the published box.",
        figures=(context.save(figure, NAME),),
    )


def _label(setting: SearchSetting) -> str:
    return f"{COUNTS[setting.set_name]} parameters, {setting.trials} trials"


def _point(result: SearchResult) -> WinnerPoint:
    winner = result.winner
    is_small = result.setting.set_name == "lateral"
    return WinnerPoint(
        _label(result.setting), winner.parameters[FIRST], winner.parameters[THIRD], winner.score, is_small
    )
