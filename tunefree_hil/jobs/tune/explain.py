"""Explain a tune: why its winner beats the best manual gains, what matters, and where the box was too small."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bench.batch import Batch, Job
from tunefree_hil.control.parameters import BY_NAME
from tunefree_hil.grade.difference import Difference, difference
from tunefree_hil.grade.score import combine
from tunefree_hil.jobs.run_folder import JOINED, RunFolder, open_run, write_json
from tunefree_hil.jobs.tune.candidates import best_of
from tunefree_hil.jobs.tune.margins import why_not
from tunefree_hil.tune.compare import best_baseline
from tunefree_hil.tune.insight import Importance, edge_of, edges, importance, slice_points
from tunefree_hil.tune.space import Space
from tunefree_hil.tune.study import Baseline, Trial, read_study

SCHEMA = "tunefree.explain/1"
MOST_TERMS = 5  # named in words
LEAST_SAID = 5e-5  # of a score: what is less would be shown as 0
LEAST_GAIN = 0.005  # of the winner's score, by which a place of a slice is called better


class Findings(NamedTuple):
    """What a run's study says without driving anything."""

    space: Space
    winner: Trial
    manual_name: str
    manual: Baseline
    difference: Difference
    importance: dict[str, Importance]
    edges: list[str]


class Cut(NamedTuple):
    """A slice: values of one parameter and the score of the winner with each; None where the bench failed."""

    values: list[float]
    scores: list[float | None]


def explain(run: Any, *, points: int, slices: bool) -> Iterator[Event]:
    """Words on stdout, explain.json and figures in the run folder."""
    folder = open_run(run)
    if folder.record.get("command") != "tune":
        message = f"is a run of {folder.record.get('command')!r}: there is no winner in it to explain"
        hint = "give the run folder of a tune; `tunefree-hil compare RUN RUN` holds drives against each other"
        raise InputError(message, code="not_a_tune", file=str(run), hint=hint)
    bench = load(folder.bench_file())
    found = find(folder, bench)
    yield from (Event("line", line) for line in lines_of(found))
    cuts: dict[str, Cut] = {}
    reason = why_not(bench, folder.record.get(JOINED)) if slices else ""
    if reason:
        yield Event("warning", f"no slices through the winner: {reason}")
    elif slices:
        total = sum(len(slice_points(axis, points)) for axis in found.space.axes)
        drives = (total + 1) * len(bench.spec.scenarios)
        yield Event("note", f"slices through the winner: {total} sets of parameters, {drives} drives in the batch")
        cuts, again = cut_slices(bench, found.space, found.winner.parameters, points)
        yield from (Event("line", line) for line in slice_lines(cuts, found.winner.score))
        if again is not None and again != found.winner.score:
            yield Event("warning", f"the batch scores the winner {again!r}, the study has {found.winner.score!r}")
    figures = _figures(folder, found, cuts)
    data = _data(found, cuts)
    write_json(folder.path / "explain.json", {"schema": SCHEMA, **data})
    sentence = sentence_of(found) + _and_better(better_places(cuts, found.winner.score))
    yield Event("result", sentence, {"sentence": sentence, "run": str(folder.path), "figures": figures, **data})


def find(folder: RunFolder, bench: Bench) -> Findings:
    """The study's winner against its best baseline. Raises InputError for a study that is not finished."""
    path = folder.path / "study.db"
    slot = best_of(folder).get("slot")
    if not path.is_file():
        raise InputError(
            "has no study.db",
            code="no_study",
            file=str(folder.path),
            hint="its study is on a server: start the same tune again, a worker copies the study here as it ends",
        )
    with read_study(path) as study:
        trials, baselines, space = study.trials(), study.baselines(), study.settings.space
    winner = next((trial for trial in trials if trial.slot == slot), None)
    if winner is None:
        raise InputError(f"has no trial of slot {slot}, which best.toml names", code="no_winner", file=str(path))
    name = best_baseline(baselines).name
    manual = baselines[name]
    apart = difference(manual.scenarios, winner.scenarios, bench.weights)
    return Findings(space, winner, name, manual, apart, importance(space, trials), edges(space, winner.parameters))


def cut_slices(
    bench: Bench, space: Space, winner: Mapping[str, float], points: int
) -> tuple[dict[str, Cut], float | None]:
    """(slices by parameter, the winner's own score by the same way): every value with all others as the winner's."""
    values = {axis.name: slice_points(axis, points) for axis in space.axes}
    vectors = [dict(winner)] + [{**winner, name: value} for name, some in values.items() for value in some]
    scores = scores_of(bench, [parameters_of(bench, vector) for vector in vectors])
    cuts, at = {}, 1
    for name, some in values.items():
        cuts[name] = Cut(some, scores[at : at + len(some)])
        at += len(some)
    return cuts, scores[0]


def scores_of(bench: Bench, vectors: Sequence[Mapping[str, float]]) -> list[float | None]:
    """Eq. 7 of complete vectors over the bench's scenarios, driven in the batch; None where the bench failed one."""
    scenarios = [bench.scenarios[name] for name in bench.spec.scenarios]
    with Batch(bench, bench.spec.model) as batch:
        driven = batch.drive([Job(vector, scenario) for vector in vectors for scenario in scenarios])
    scores: list[float | None] = []
    for i in range(0, len(driven), len(scenarios)):
        grades = [one.grade for one in driven[i : i + len(scenarios)]]
        whole = [grade for grade in grades if grade is not None]
        scores.append(combine(whole) if len(whole) == len(grades) else None)
    return scores


def better_places(cuts: Mapping[str, Cut], best: float) -> list[tuple[str, float, float]]:
    """(parameter, value, score) of the lowest point of each slice that beats the winner, the lowest score first."""
    found = []
    for name, cut in cuts.items():
        known = [(score, value) for value, score in zip(cut.values, cut.scores, strict=True) if score is not None]
        score, value = min(known, default=(best, 0.0))
        if score < best * (1.0 - LEAST_GAIN):
            found.append((name, value, score))
    return sorted(found, key=lambda one: one[2])


def slice_lines(cuts: Mapping[str, Cut], best: float) -> list[str]:
    """For a person: how far each parameter alone moves the score, and whether it has a better place."""
    better = {name for name, _, _ in better_places(cuts, best)}
    lines = [f"slices through the winner (score {best:.4f}), one value changed, across its box:"]
    for name, cut in cuts.items():
        known = [(score, value) for value, score in zip(cut.values, cut.scores, strict=True) if score is not None]
        if not known:
            lines.append(f"  {name:<28}the bench failed everywhere")
            continue
        (low, at), (high, _) = min(known), max(known)
        said = "  better than the winner" if name in better else ""
        lines.append(f"  {name:<28}{low:9.4f} to {high:.4f}, lowest at {at:.4g}{said}")
    return lines


def _and_better(better: Sequence[tuple[str, float, float]]) -> str:
    if not better:
        return ""
    name, value, score = better[0]
    return f"; a slice has a better place: {name} = {value:.4g} scores {score:.4f}, more trials may find it"


def largest(apart: Difference) -> list[tuple[str, str, float]]:
    """(scenario, term, winner - manual), the largest first."""
    cells = [(name, term, value) for name, row in apart.terms.items() for term, value in row.items() if value != 0.0]
    return sorted(cells, key=lambda cell: -abs(cell[2]))


def by_term(apart: Difference) -> dict[str, float]:
    """Sums over the scenarios, the largest gain first."""
    terms = {term for row in apart.terms.values() for term in row}
    sums = {term: sum(row[term] for row in apart.terms.values()) for term in terms}
    return dict(sorted(sums.items(), key=lambda item: (item[1], item[0])))


def lines_of(found: Findings) -> list[str]:
    """For a person: where the difference comes from, what matters, what lies on an edge."""
    apart = found.difference
    lines = [
        f"score {found.manual.score:.4f} ({found.manual_name}) -> {found.winner.score:.4f} (winner): {apart.total:+.4f}"
    ]
    lines.append("by scenario:")
    lines += [f"  {name:<28}{value:+9.4f}" for name, value in sorted(apart.scenarios.items(), key=lambda one: one[1])]
    lines.append("by term, over all scenarios:")
    lines += [f"  {term:<28}{value:+9.4f}" for term, value in by_term(apart).items() if abs(value) >= LEAST_SAID]
    lines.append("largest cells:")
    lines += [f"  {name}, {term}: {value:+.4f}" for name, term, value in largest(apart)[:MOST_TERMS]]
    n = next(iter(found.importance.values())).n
    lines.append(f"importance of the parameters (PED-ANOVA and rank correlation, n = {n} trials):")
    for name, one in found.importance.items():
        share = "too few trials" if one.share is None else f"{100.0 * one.share:5.1f} %"
        lines.append(f"  {name:<28}{share:>9}  rank correlation {one.rank:+.2f}")
    lines += found.edges or ["no value of the winner sits on an edge of its box"]
    return lines


def sentence_of(found: Findings) -> str:
    """The whole in one line."""
    apart = found.difference
    words = f"the winner scores {apart.total:+.3f} against {found.manual_name}"
    if not largest(apart):
        words = f"the winner scores as {found.manual_name} does, in every term of every scenario"
    worse = apart.total > 0.0
    causes = [cell for cell in largest(apart) if (cell[2] > 0.0) == worse][:2]
    if causes:
        words += ", it is worse" if worse else ""
        words += ", most by " + " and ".join(f"{term} in {name} ({value:+.3f})" for name, term, value in causes)
    if found.edges:
        words += f"; {'; '.join(found.edges)}"
    return words


def _data(found: Findings, cuts: Mapping[str, Cut]) -> dict[str, Any]:
    return {
        "manual": {"name": found.manual_name, "score": found.manual.score},
        "winner": {"slot": found.winner.slot, "score": found.winner.score, "parameters": found.winner.parameters},
        "difference": found.difference._asdict(),
        "importance": {name: one._asdict() for name, one in found.importance.items()},
        "edges": found.edges,
        "slices": {name: cut._asdict() for name, cut in cuts.items()},
    }


def _figures(folder: RunFolder, found: Findings, cuts: Mapping[str, Cut]) -> list[str]:
    from tunefree_hil.figures.heat import write_heat
    from tunefree_hil.figures.tuning.importance import write_importance
    from tunefree_hil.figures.tuning.slices import Slice, write_slices

    figures, apart = folder.figures(), found.difference
    title = f"Winner against {found.manual_name}: score {found.manual.score:.3f} -> {found.winner.score:.3f}"
    written = [write_heat(figures / "difference.png", apart.terms, title)]
    written.append(write_importance(figures / "importance.png", found.importance))
    if cuts:
        panels = {
            axis.name: Slice(
                cuts[axis.name].values,
                cuts[axis.name].scores,
                found.winner.parameters[axis.name],
                axis.log,
                BY_NAME[axis.name].tunable.unit if axis.name in BY_NAME else "",
                _flag(edge_of(axis, found.winner.parameters[axis.name])),
            )
            for axis in found.space.axes
        }
        words = "One parameter at a time, the others as the winner has them"
        written.append(write_slices(figures / "slices.png", panels, found.winner.score, found.manual.score, words))
    return [str(path) for path in written]


def _flag(edge: str) -> str:
    return f"on the {edge} edge of its box" if edge else ""
