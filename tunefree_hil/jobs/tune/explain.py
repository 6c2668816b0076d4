"""Explanation of a tune: why the winner beats the best manual gains, importance of parameters, too small ranges."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bench.batch import Batch, Job
from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.grade.difference import ScoreDifference, score_difference
from tunefree_hil.grade.objectives import measure_objectives
from tunefree_hil.grade.requirements.judgement import judge_drives
from tunefree_hil.grade.score import combine_scores
from tunefree_hil.jobs.options.records import ExplainOptions
from tunefree_hil.jobs.run_folder import JOINED, RunFolder, open_run, write_json
from tunefree_hil.jobs.tune.candidates import TUNED, parameter_unit
from tunefree_hil.jobs.tune.margins import find_batch_obstacle
from tunefree_hil.jobs.tune.verdict.best_file import read_best
from tunefree_hil.jobs.tune.verdict.text import requirement_table
from tunefree_hil.jobs.tune.verdict.trade import (
    FIGURE,
    TradedTrials,
    draw_trade,
    read_traded,
    split_scores,
    trade_data,
    trade_table,
    trade_text,
)
from tunefree_hil.tune.compare import find_best_baseline
from tunefree_hil.tune.insight import (
    Edge,
    Importance,
    choose_slice_points,
    compute_importance,
    describe_edges,
    find_edge,
)
from tunefree_hil.tune.space import Axis, Space
from tunefree_hil.tune.study import Baseline, Trial, read_study

if TYPE_CHECKING:
    from tunefree_hil.figures.tuning.slices import ParameterSlice

SCHEMA = "tunefree.explain/1"
MAX_NAMED_TERMS = 5  # in the text
MIN_SHOWN_DIFFERENCE = 5e-5  # of a score; a smaller one would be shown as 0
MIN_GAIN_SHARE = 0.005  # of the winner's score: smallest gain of a better point


class StudyAnalysis(NamedTuple):
    """Analysis of the study of a run, without further drives. manual: the best baseline.

    judged: `RequirementJudgement.as_data` of winner and manual set, by the requirements of the study.
    objectives: Those of the study; empty where the score is the only one.
    objective_importance: Importance of the parameters by objective; empty without objectives.
    traded: The trials with their objectives, which are the parts of the score where the study has none; None where the
        stored grades do not tell them, for the reason `untold`.
    """

    space: Space
    winner: Trial
    manual_name: str
    manual: Baseline
    difference: ScoreDifference
    importance: dict[str, Importance]
    edges: list[str]
    judged: Mapping[str, Mapping[str, Any]]
    objectives: tuple[str, ...] = ()
    objective_importance: Mapping[str, dict[str, Importance]] = {}
    traded: TradedTrials | None = None
    untold: str = ""


class VectorScore(NamedTuple):
    """The score of a vector over all scenarios, and its objectives in a study of several."""

    score: float
    objectives: tuple[float, ...] = ()


class SliceScores(NamedTuple):
    """A slice: values of one parameter, and the score of the winner with each; None where the bench failed.

    objectives: The same for each objective by name, in a study of several. Stored under its field names.
    """

    values: list[float]
    scores: list[float | None]
    objectives: Mapping[str, list[float | None]] = {}

    def valid_points(self) -> list[tuple[float, float]]:
        """(score, value) of the points with a score."""
        return [(score, value) for value, score in zip(self.values, self.scores, strict=True) if score is not None]


class BetterPoint(NamedTuple):
    """A point of a slice that is better than the winner."""

    name: str
    value: float
    score: float


class TermDifference(NamedTuple):
    """Difference of one term of the score in one scenario, winner minus manual."""

    scenario: str
    term: str
    difference: float


def explain(options: ExplainOptions) -> Iterator[Event]:
    """Print an analysis, and write explain.json and figures into the run folder."""
    run, points = options.run, options.points
    folder = open_run(run)
    command = folder.record.get("command")
    if command != "tune":
        message = f"is a run of {command!r}, which has no winner to explain"
        hint = "give the run folder of a tune; `tunefree-hil compare RUN RUN` compares drives"
        raise InputError(message, code="not_a_tune", file=str(run), hint=hint)
    bench = load(folder.bench_file())
    analysis = analyse_study(folder, bench)
    winner = analysis.winner
    yield from (Event("line", line) for line in format_analysis(analysis))
    if analysis.untold:
        yield Event("note", f"no picture of tracking against comfort: {analysis.untold}")
    slice_scores: dict[str, SliceScores] = {}
    obstacle = find_batch_obstacle(bench, folder.record.get(JOINED)) if options.slices else ""
    if obstacle:
        yield Event("warning", f"no slices through the winner: {obstacle}")
    elif options.slices:
        total = sum(len(choose_slice_points(axis, points)) for axis in analysis.space.axes)
        drives = (total + 1) * len(bench.spec.scenarios)
        yield Event("note", f"slices through the winner: {total} sets of parameters, {drives} drives in the batch")
        slice_scores, batch_score = drive_slices(bench, analysis.space, winner.parameters, points, analysis.objectives)
        yield from (Event("line", line) for line in format_slices(slice_scores, winner.score))
        if batch_score is not None and batch_score != winner.score:
            yield Event("warning", f"the winner scores {batch_score!r} in the batch, {winner.score!r} in the study")
    figures = _write_figures(folder, analysis, slice_scores)
    data = _data(analysis, slice_scores)
    write_json(folder.path / "explain.json", {"schema": SCHEMA, **data})
    better = find_better_points(slice_scores, winner.score)
    sentence = summarise_analysis(analysis) + _better_point_text(better)
    yield Event("result", sentence, {"sentence": sentence, "run": str(folder.path), "figures": figures, **data})


def analyse_study(folder: RunFolder, bench: Bench) -> StudyAnalysis:
    """Compare the winner of a study with its best baseline. Raises InputError for an unfinished study."""
    path = folder.path / "study.db"
    slot = read_best(folder).get("slot")
    if not path.is_file():
        hint = "its study is on a server: run the same tune command again, which copies the study here at its end"
        raise InputError("has no study.db", code="no_study", file=str(folder.path), hint=hint)
    with read_study(path) as study:
        trials, baselines, space = study.trials(), study.baselines(), study.settings.space
        limits, objectives = study.settings.requirements, study.settings.objectives
        traded, untold = (read_traded(study), "") if objectives else _split(trials, baselines, bench.weights)
    winner = next((trial for trial in trials if trial.slot == slot), None)
    if winner is None:
        raise InputError(f"has no trial of slot {slot}, which best.toml names", code="no_winner", file=str(path))
    name = find_best_baseline(baselines).name
    manual = baselines[name]
    return StudyAnalysis(
        space=space,
        winner=winner,
        manual_name=name,
        manual=manual,
        difference=score_difference(manual.scenarios, winner.scenarios, bench.weights),
        importance=compute_importance(space, trials),
        edges=describe_edges(space, winner.parameters),
        judged={
            label: judge_drives(drives, limits).as_data()
            for label, drives in ((TUNED, winner.scenarios), (name, manual.scenarios))
        },
        objectives=objectives,
        objective_importance={
            objective: compute_importance(space, [trial._replace(score=trial.objectives[i]) for trial in trials])
            for i, objective in enumerate(objectives)
        },
        traded=traded,
        untold=untold,
    )


def _split(
    trials: Sequence[Trial], baselines: Mapping[str, Baseline], weights: WeightsSpec
) -> tuple[TradedTrials | None, str]:
    """The trials of a search by the score with the parts of it, or the reason why there are none."""
    try:
        return split_scores(trials, baselines, weights), ""
    except InputError as error:
        return None, error.message


def drive_slices(
    bench: Bench, space: Space, winner: Mapping[str, float], points: int, objectives: Sequence[str] = ()
) -> tuple[dict[str, SliceScores], float | None]:
    """Score the winner with one value changed, for all parameters and points of their slices.

    Args:
        bench: The bench of the search.
        space: Its parameters.
        winner: Values of the winner.
        points: Number of points of a slice.
        objectives: Names of the objectives of the study.

    Returns:
        The slices by parameter, and the score of the unchanged winner in the batch.
    """
    values = {axis.name: choose_slice_points(axis, points) for axis in space.axes}
    vectors = [dict(winner)]
    vectors += [{**winner, name: value} for name, slice_values in values.items() for value in slice_values]
    scored = score_vectors(bench, [parameters_of(bench, vector) for vector in vectors], objectives)
    slices, start = {}, 1
    for name, slice_values in values.items():
        chosen = scored[start : start + len(slice_values)]
        slices[name] = SliceScores(
            slice_values,
            [point and point.score for point in chosen],
            {objective: [point and point.objectives[i] for point in chosen] for i, objective in enumerate(objectives)},
        )
        start += len(slice_values)
    return slices, scored[0] and scored[0].score


def score_vectors(
    bench: Bench, vectors: Sequence[Mapping[str, float]], objectives: Sequence[str] = ()
) -> list[VectorScore | None]:
    """Scores (paper, eq. 7) of complete vectors in the batch, over all scenarios; None where the bench failed one."""
    scenarios = [bench.scenarios[name] for name in bench.spec.scenarios]
    with Batch(bench, bench.spec.model) as batch:
        drives = batch.drive([Job(vector, scenario) for vector in vectors for scenario in scenarios])
    scores: list[VectorScore | None] = []
    for i in range(0, len(drives), len(scenarios)):
        grades = [drive.grade for drive in drives[i : i + len(scenarios)]]
        valid = {grade.scenario: grade for grade in grades if grade is not None}
        if len(valid) < len(grades):
            scores.append(None)
            continue
        data = {name: grade._asdict() for name, grade in valid.items()}
        parts = measure_objectives(data, bench.weights, objectives)
        scores.append(VectorScore(combine_scores(list(valid.values())), parts))
    return scores


def find_better_points(slices: Mapping[str, SliceScores], best: float) -> list[BetterPoint]:
    """The lowest point of each slice that is better than the winner, the lowest score first."""
    better = []
    for name, slice_scores in slices.items():
        score, value = min(slice_scores.valid_points(), default=(best, 0.0))
        if score < best * (1.0 - MIN_GAIN_SHARE):
            better.append(BetterPoint(name, value, score))
    return sorted(better, key=lambda point: point.score)


def format_slices(slices: Mapping[str, SliceScores], best: float) -> list[str]:
    """Lines with the range of the score in each slice, and its lowest point."""
    better = {point.name for point in find_better_points(slices, best)}
    lines = [f"slices through the winner (score {best:.4f}), one value changed across its range:"]
    for name, slice_scores in slices.items():
        points = slice_scores.valid_points()
        if not points:
            lines.append(f"  {name:<28}the bench failed everywhere")
            continue
        (low, lowest_value), (high, _) = min(points), max(points)
        mark = "  better than the winner" if name in better else ""
        lines.append(f"  {name:<28}{low:9.4f} to {high:.4f}, lowest at {lowest_value:.4g}{mark}")
    return lines


def _better_point_text(better: Sequence[BetterPoint]) -> str:
    if not better:
        return ""
    name, value, score = better[0]
    return f"; a slice has a better point: {name} = {value:.4g} scores {score:.4f}, more trials may find it"


def sort_differences(difference: ScoreDifference) -> list[TermDifference]:
    """All differences that are not 0, the largest first."""
    terms = [
        TermDifference(scenario, term, value)
        for scenario, row in difference.terms.items()
        for term, value in row.items()
        if value != 0.0
    ]
    return sorted(terms, key=lambda term: -abs(term.difference))


def sum_by_term(difference: ScoreDifference) -> dict[str, float]:
    """Sums over the scenarios, the largest gain first."""
    terms = {term for row in difference.terms.values() for term in row}
    sums = {term: sum(row[term] for row in difference.terms.values()) for term in terms}
    return dict(sorted(sums.items(), key=lambda item: (item[1], item[0])))


def format_analysis(analysis: StudyAnalysis) -> list[str]:
    """Lines: differences by scenario and term, importance of the parameters, values on an edge."""
    difference, manual, winner = analysis.difference, analysis.manual, analysis.winner
    scores = f"score {manual.score:.4f} ({analysis.manual_name}) -> {winner.score:.4f} (winner)"
    lines = [f"{scores}: {difference.total:+.4f}", "by scenario:"]
    by_scenario = sorted(difference.scenarios.items(), key=lambda item: item[1])
    lines += [f"  {name:<28}{value:+9.4f}" for name, value in by_scenario]
    lines.append("by term, over all scenarios:")
    by_term = sum_by_term(difference).items()
    lines += [f"  {term:<28}{value:+9.4f}" for term, value in by_term if abs(value) >= MIN_SHOWN_DIFFERENCE]
    lines.append("largest differences:")
    for scenario, term, value in sort_differences(difference)[:MAX_NAMED_TERMS]:
        lines.append(f"  {scenario}, {term}: {value:+.4f}")
    lines += _importance_lines(analysis.importance, "")
    for objective, importance in analysis.objective_importance.items():
        lines += _importance_lines(importance, f" for {objective}")
    lines += analysis.edges or ["no value of the winner is on an edge of its range"]
    if analysis.traded is not None:
        lines += trade_table(trade_data(analysis.traded, winner.slot))
    return lines + requirement_table(analysis.judged)


def _importance_lines(importances: Mapping[str, Importance], purpose: str) -> list[str]:
    n = next(iter(importances.values())).n
    lines = [f"importance of the parameters{purpose} (PED-ANOVA and rank correlation, n = {n} trials):"]
    for name, importance in importances.items():
        share = "no share" if importance.share is None else f"{100.0 * importance.share:5.1f} %"
        lines.append(f"  {name:<28}{share:>9}  rank correlation {importance.rank:+.2f}")
    return lines


def summarise_analysis(analysis: StudyAnalysis) -> str:
    """The analysis in one sentence."""
    difference = analysis.difference
    terms = sort_differences(difference)
    text = f"the winner scores {difference.total:+.3f} against {analysis.manual_name}"
    if not terms:
        text = f"the winner has the scores of {analysis.manual_name} in every term of every scenario"
    is_worse = difference.total > 0.0
    causes = [term for term in terms if (term.difference > 0.0) == is_worse][:2]
    if causes:
        text += ", it is worse" if is_worse else ""
        text += ", mostly by "
        text += " and ".join(f"{cause.term} in {cause.scenario} ({cause.difference:+.3f})" for cause in causes)
    if analysis.objectives and analysis.traded is not None:
        text += f"; {trade_text(trade_data(analysis.traded, analysis.winner.slot))}"
    if analysis.edges:
        text += f"; {'; '.join(analysis.edges)}"
    return text


def _data(analysis: StudyAnalysis, slices: Mapping[str, SliceScores]) -> dict[str, Any]:
    by_objective = {
        objective: {name: importance._asdict() for name, importance in importances.items()}
        for objective, importances in analysis.objective_importance.items()
    }
    return {
        **({"objective_importance": by_objective} if by_objective else {}),
        **({} if analysis.traded is None else {"trade": trade_data(analysis.traded, analysis.winner.slot)}),
        "manual": {"name": analysis.manual_name, "score": analysis.manual.score},
        "winner": {
            "slot": analysis.winner.slot,
            "score": analysis.winner.score,
            "parameters": analysis.winner.parameters,
        },
        "difference": analysis.difference._asdict(),
        "importance": {name: importance._asdict() for name, importance in analysis.importance.items()},
        "edges": analysis.edges,
        "requirements": {label: dict(judged) for label, judged in analysis.judged.items()},
        "slices": {name: slice_scores._asdict() for name, slice_scores in slices.items()},
    }


def _write_figures(folder: RunFolder, analysis: StudyAnalysis, slices: Mapping[str, SliceScores]) -> list[str]:
    from tunefree_hil.figures.heat import draw_heat
    from tunefree_hil.figures.style import save
    from tunefree_hil.figures.tuning.importance import draw_importance
    from tunefree_hil.figures.tuning.slices import draw_slices

    figures = folder.figures()
    title = f"Winner against {analysis.manual_name}: score {analysis.manual.score:.3f} -> {analysis.winner.score:.3f}"
    written = [save(draw_heat(analysis.difference.terms, title), figures / "difference.png")]
    written.append(save(draw_importance(analysis.importance), figures / "importance.png"))
    for objective, importance in analysis.objective_importance.items():
        written.append(save(draw_importance(importance, objective), figures / f"importance_{objective}.png"))
    if analysis.traded is not None:
        data = trade_data(analysis.traded, analysis.winner.slot)
        written.append(draw_trade(analysis.traded, data, figures / FIGURE))
    heading = "One parameter changed at a time, the others as in the winner"
    for i, objective in enumerate(["score", *analysis.objectives] if slices else []):
        panels = {
            axis.name: _slice_panel(axis, _slice_of_objective(slices[axis.name], objective), analysis.winner)
            for axis in analysis.space.axes
        }
        best, manual = ((scored.score, *scored.objectives)[i] for scored in (analysis.winner, analysis.manual))
        name = "slices.png" if objective == "score" else f"slices_{objective}.png"
        label = objective if objective == "score" else f"{objective} cost"
        written.append(save(draw_slices(panels, best, manual, heading, label), figures / name))
    return [str(path) for path in written]


def _slice_of_objective(slice_scores: SliceScores, objective: str) -> SliceScores:
    """The slice with an objective as its scores."""
    if objective == "score":
        return slice_scores
    return SliceScores(slice_scores.values, slice_scores.objectives[objective])


def _slice_panel(axis: Axis, slice_scores: SliceScores, winner: Trial) -> ParameterSlice:
    from tunefree_hil.figures.tuning.slices import ParameterSlice

    value, edge = winner.parameters[axis.name], find_edge(axis, winner.parameters[axis.name])
    remark = "" if edge is Edge.NONE else f"on the {edge} edge of its range"
    return ParameterSlice(
        values=slice_scores.values,
        scores=slice_scores.scores,
        winner=value,
        log=axis.log,
        unit=parameter_unit(axis.name),
        flag=remark,
        choices=axis.choices,
    )
