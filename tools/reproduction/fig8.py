"""Fig. 8: MRAC parameters found with several surrogates and settings (a), and the sample points of one search (b)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tools.reproduction.context import STEER_BENCH, Context
from tools.reproduction.figures.planes import WinnerPoint, draw_winners
from tools.reproduction.records import Claim, Method, Record, Value
from tools.reproduction.searches import SearchBench, SearchResult, SearchSetting, known_settings, trial_rows
from tunefree_hil.figures.tuning.scatter import ParameterBox, TrialPoints, draw_scatter
from tunefree_hil.tune.space import Space

NAMES = ("fig8a", "fig8b")
SET = "mrac"
SEARCHES = "searches"  # folder of the journals, shared by all parts
T_REF, ADAPTION = "mrac.t_ref_s", "mrac.p"
SHOWN_IN_B = "tpe_independent"
BEST_SHARE = 0.1  # of the trials: the good ones of Fig. 8b
PAPER_TRIALS = 200  # paper, Fig. 8b


class OptimumCriteria(NamedTuple):
    """When several searches count as ending at the same optimum."""

    max_spread_percent: float = 3.0  # percent of the best score; aim of this project, the paper has no number
    max_area_share: float = 0.25  # of the logarithmic box that holds the best tenth of the trials; chance: nearly 1


CRITERIA = OptimumCriteria()


def settings(seed: int, is_quick: bool = False) -> tuple[SearchSetting, ...]:
    """Surrogate, acquisition and number of trials; each setting has a seed of its own."""
    listed = (
        *(("gp_ei", 50), ("gp_ucb", 50), ("gp_me", 50), ("gp_ei", 100)),
        *(("tpe_independent", 100), (SHOWN_IN_B, PAPER_TRIALS), ("tpe_relative", 100), ("tpe_relative", PAPER_TRIALS)),
    )
    return tuple(
        SearchSetting(SET, sampler, max(trials // 10, 6) if is_quick else trials, seed + k)
        for k, (sampler, trials) in enumerate(listed)
    )


class Searched(NamedTuple):
    """The searches of Fig. 8a, the manual set, and the settings whose sampler is not there."""

    results: list[SearchResult]
    manual: dict[str, float]
    manual_score: float
    space: Space
    missing: list[SearchSetting]

    @property
    def spreads_percent(self) -> list[float]:
        """By search, how far the winner's score is above that of the best winner."""
        best = min(result.winner.score for result in self.results)
        return [100.0 * (result.winner.score / best - 1.0) for result in self.results]


def search_all(
    bench_file: str, folder: Path, listed: Sequence[SearchSetting], say: Callable[[float, str], None]
) -> Searched:
    """Run or continue the searches of the settings whose sampler is there."""
    known = known_settings(tuple(listed))
    total, done = sum(setting.trials for setting in known), 0
    results = []
    with SearchBench(bench_file, folder) as bench:
        for setting in known:
            before = done

            def report(trials: int, before: int = before, label: str = setting.label) -> None:
                say((before + trials) / total, f"{label}: {trials}")

            results.append(bench.search(setting, report))
            done += setting.trials
        return Searched(
            results,
            bench.manual(),
            bench.score_manual(),
            bench.space(SET),
            [setting for setting in listed if setting not in known],
        )


def trials_sum(searched: Searched) -> int:
    """Trials of all searches together."""
    return sum(len(result.trials) for result in searched.results)


def search_for(context: Context) -> Searched:
    """The searches of this run."""
    folder = context.folders.work / SEARCHES
    return search_all(STEER_BENCH, folder, settings(context.seed, context.is_quick), context.progress.update)


def reproduce_results(context: Context) -> Record:
    """Fig. 8a."""
    searched = search_for(context)
    spreads = searched.spreads_percent
    points = [
        WinnerPoint(
            result.setting.label,
            result.winner.parameters[T_REF],
            result.winner.parameters[ADAPTION],
            result.winner.score,
            result.setting.is_gaussian,
        )
        for result in searched.results
    ]
    manual = WinnerPoint("manual", searched.manual[T_REF], searched.manual[ADAPTION], searched.manual_score, False)
    boxes = parameter_boxes(searched.space)
    sentence = f"Winners of {len(points)} settings, scores within {max(spreads):.1f} % of the best"
    figure = draw_winners(points, manual, ((T_REF, boxes[T_REF]), (ADAPTION, boxes[ADAPTION])), sentence)
    largest = max(spreads)
    left_out = [setting.label for setting in searched.missing]
    return Record(
        name="fig8a",
        title="MRAC parameters found by GPR and TPE",
        paper="Fig. 8a: the two MRAC parameters found with GPR and TPE and several settings lie in one region around "
        "the manual ones, which are marked. A picture without numbers.",
        claim=Claim(
            f"All settings end at the same optimum: their scores differ by at most {CRITERIA.max_spread_percent:g} %.",
            largest <= CRITERIA.max_spread_percent,
        ),
        values=tuple(_winner_values(searched, largest)),
        method=_method(searched, len(points)),
        difference=_where_they_end(searched) + (f" Left out: {', '.join(left_out)}." if left_out else ""),
        figures=(context.save(figure, "fig8a"),),
        detail={"winners": [point._asdict() for point in points]},
    )


def _winner_values(searched: Searched, largest: float) -> Iterator[Value]:
    """Rows of Fig. 8a."""
    yield Value("largest distance of a winner's score from the best", largest, "percent")
    yield Value("manual set", _point_text(searched.manual, searched.manual_score))
    for result in searched.results:
        yield Value(result.setting.label, _point_text(result.winner.parameters, result.winner.score))


def _point_text(parameters: Mapping[str, float], score: float) -> str:
    return f"T_ref {parameters[T_REF]:.3f} s, p {parameters[ADAPTION]:.2g}, score {score:.4f}"


def reproduce_samples(context: Context) -> Record:
    """Fig. 8b: the trials of the longest search with TPE."""
    searched = search_for(context)
    result = next(one for one in reversed(searched.results) if one.setting.sampler == SHOWN_IN_B)
    trials = trial_rows(result)
    parameters = {name: [row[name] for row in trials] for name in (T_REF, ADAPTION)}
    scores = [row["score"] for row in trials]
    manual = {name: searched.manual[name] for name in parameters}
    figure = draw_scatter(TrialPoints(parameters, scores, parameter_boxes(searched.space), manual))
    share = best_area_share(trials, searched.space)
    return Record(
        name="fig8b",
        title=f"Sample points of a TPE search, {len(trials)} trials",
        paper="Fig. 8b: sample points of a search with TPE over 200 iterations, T_ref and p, with scores as colour; "
        "the good scores lie together. A picture without numbers.",
        claim=Claim(
            f"The best tenth of the trials lies in at most {100.0 * CRITERIA.max_area_share:g} % of the box.",
            share <= CRITERIA.max_area_share,
        ),
        values=(
            Value("part of the box that holds the best tenth of the trials", 100.0 * share, "percent"),
            Value("trials", len(trials), "", "200"),
            Value("best score", min(scores)),
            Value("score of the manual set", searched.manual_score),
        ),
        method=_method(searched, 1),
        difference="The search is on a logarithmic scale over the published box; the paper draws linear axes and does "
        "not give its scale.",
        figures=(context.save(figure, "fig8b"),),
    )


def parameter_boxes(space: Space) -> dict[str, ParameterBox]:
    """Ranges of the axes as the pictures take them."""
    units = {T_REF: "s"}
    return {axis.name: ParameterBox(axis.low, axis.high, axis.log, units.get(axis.name, "")) for axis in space.axes}


def best_area_share(trials: Sequence[dict[str, float]], space: Space) -> float:
    """Share of the box (on its scales) of the rectangle around the best trials."""
    count = max(round(BEST_SHARE * len(trials)), 2)
    best = sorted(trials, key=lambda row: row["score"])[:count]
    share = 1.0
    for axis in space.axes:
        values = np.array([row[axis.name] for row in best])
        ends = np.array([axis.low, axis.high])
        scaled, box = (np.log(values), np.log(ends)) if axis.log else (values, ends)
        share *= float(np.ptp(scaled) / np.ptp(box))
    return share


def _method(searched: Searched, count: int) -> Method:
    seeds = sorted(result.setting.seed for result in searched.results)
    return Method(
        f"{STEER_BENCH}, its seven scenarios on its plant, score alone",
        f"{count} of {len(searched.results)} searches, {trials_sum(searched)} trials in all of them",
        f"searches {seeds[0]} to {seeds[-1]}, one each",
        "Compiled batch, which gives the scores of the bus bit for bit; the manual set is no trial of a search. "
        "Searches with a Gaussian process try one point at a time, those with TPE eight.",
    )


def _where_they_end(searched: Searched) -> str:
    """How the winners lie to the manual set, from the numbers."""
    better = sum(result.winner.score < searched.manual_score for result in searched.results)
    ratios = [result.winner.parameters[T_REF] / searched.manual[T_REF] for result in searched.results]
    gains = [result.winner.parameters[ADAPTION] / searched.manual[ADAPTION] for result in searched.results]
    return (
        f"{better} of {len(searched.results)} winners score lower (better) than the manual set; their T_ref is "
        f"{min(ratios):.2g} to {max(ratios):.2g} times the manual one and their p {min(gains):.3g} to {max(gains):.3g} "
        "times. Plant, scenarios and weights are not the paper's."
    )
