"""Is there a better optimiser than the product's choice? Its samplers and optimisers of other projects, seed by seed.

Every method searches the score of a bench (eq. 7 of the paper) over its scenarios in the compiled batch: with 8 trials
in flight, as `tune --backend batch`, and one after the other, as `tune` over the bus, whose scores are the same bit for
bit (`parity`). All get the same first trial, the manual set that `tune` begins with.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tools.measures._envelope import Progress, changed_files
from tools.measures._ledger import FIGURES, FOLDER
from tools.measures._sampler_peers import PEERS
from tools.measures._sampler_runs import (
    Problem,
    Row,
    RunEnd,
    RunJob,
    SamplerRun,
    describe_objective,
    load_problem,
    make_peers_environment,
    path_of,
    run_search,
)
from tools.measures._side_by_side import side_by_side
from tools.measures._summary import machine, rounded, summary
from tunefree_hil.base.errors import InputError
from tunefree_hil.tune.sampling.automatic_choice import SearchTask, choose_sampler
from tunefree_hil.tune.sampling.records import AUTO, NSGA, SAMPLERS
from tunefree_hil.tune.store import exclusive_lock

VALUE = "best score so far of sampler 'auto' / of the best of all methods, medians of seeds, worst number of trials"
NAME = "samplers"
OWN = tuple(name for name in SAMPLERS if name != NSGA)  # nsga is for several objectives
ASK_FOR_BUDGET = ("smac", "nevergrad")  # they search otherwise when they are told another number of trials
# With 8 in flight NGOpt takes a meta model, in which nevergrad 1.0.12 hung (trial 136 of 200). So it searches one
# by one, where it takes COBYLA, and these rows stand in every comparison, to its advantage: it knows all scores before.
ONE_BY_ONE = ("nevergrad",)
# Processor time of a trial and of a suggestion in ms, for the time that is left only.
TRIAL_MS, SUGGESTION_MS = 35.0, {"gp_ei": 150.0, "gp_ucb": 400.0, "gp_me": 500.0, "optuna_gp": 200.0, "botorch": 450.0,
                                 "smac": 250.0}  # fmt: skip


class SamplerAims(NamedTuple):
    """What the value stands beside."""

    ratio_at_most: float = 1.02


class Request(NamedTuple):
    """The options."""

    bench: str
    parameters: str
    methods: tuple[str, ...]
    seeds: range
    budgets: tuple[int, ...]
    in_flight: tuple[int, ...]
    folder: Path

    def runs(self) -> Iterator[SamplerRun]:
        """All searches, seed by seed, so that whatever is done is balanced."""
        for seed in self.seeds:
            for in_flight in self.in_flight:
                for method in self.methods:
                    if method not in ONE_BY_ONE:
                        yield from self._runs_of(method, seed, in_flight)
            for method in self.methods:
                if method in ONE_BY_ONE:
                    yield from self._runs_of(method, seed, 1)

    def _runs_of(self, method: str, seed: int, in_flight: int) -> Iterator[SamplerRun]:
        for budget in self.budgets if method in ASK_FOR_BUDGET else (0,):
            yield SamplerRun(method, seed, in_flight, budget, budget or max(self.budgets))


class Cell(NamedTuple):
    """A comparison: trials in flight and number of trials."""

    in_flight: int
    budget: int

    @property
    def label(self) -> str:
        """For people, and in the detail."""
        return f"{self.budget} trials, {self.in_flight} in flight"


class Reading(NamedTuple):
    """A method in a cell.

    scores: Best score so far, by seed.
    cpu_ms: Processor time of a suggestion, mean of the trials between the budget before and this one, median of seeds.
    """

    scores: list[float]
    cpu_ms: float

    @property
    def median(self) -> float:
        """Of the scores."""
        return float(np.median(self.scores))


Readings = dict[Cell, dict[str, Reading]]


def measure(
    seeds: int = 5,
    budgets: str = "50,100,200,400",
    methods: str = "",
    in_flight: str = "8,1",
    minutes: float = 0.0,
    first_seed: int = 1,
    workers: int = 2,
    bench: str = "bench_configs/mkz_complete.toml",
    parameters: str = "complete",
    folder: str = FOLDER,
    figures: str = FIGURES,
) -> dict[str, Any]:
    """budgets, in_flight: numbers with commas between. methods: names with commas between, '' for all. minutes: no
    trial begins later, 0 for no limit; it compares what is done. `workers` searches run side by side, one a core. Goes
    on when called again: every trial is a row of a file in `<folder>/samplers/`.
    """
    before, until_s = machine(), time.monotonic() + 60.0 * minutes if minutes else float("inf")
    numbers = [tuple(sorted({int(word) for word in text.split(",")})) for text in (budgets, in_flight)]
    seed_range = range(first_seed, first_seed + seeds)
    asked = Request(bench, parameters, (), seed_range, numbers[0], numbers[1][::-1], Path(folder) / NAME)
    problem = load_problem(bench, parameters)
    request = asked._replace(methods=select_methods(methods, asked, problem))
    request.folder.mkdir(parents=True, exist_ok=True)
    with exclusive_lock(request.folder / NAME):  # two measures would write the same rows
        ends = search_all(request, problem, until_s, workers)
    readings = compare(request, problem, ends)
    if not readings:
        hint = f"give more --minutes, fewer --methods or smaller --budgets than {budgets}"
        raise InputError("no seed is searched by all methods yet", code="too_early", hint=hint)
    print(table_text(readings), file=sys.stderr, flush=True)
    worst = max(readings, key=lambda cell: ratio(readings[cell], AUTO))
    best = readings[worst][best_method(readings[worst])].median
    detail = {
        "machine": before,
        "changed_files": changed_files(),
        "aims": SamplerAims()._asdict(),
        "objective": f"score of {Path(bench).name}, {len(problem.space.axes)} parameters",
        "worst": worst.label,
        "cells": {cell.label: describe_cell(problem, cell, found) for cell, found in readings.items()},
        "figure": _draw(request, ends, readings, worst, figures),
    }
    values = [score / best for score in readings[worst][AUTO].scores]
    return summary(values, "of the best method's score", rounded(detail))


def select_methods(text: str, request: Request, problem: Problem) -> tuple[str, ...]:
    """The methods between commas, and those that `auto` chooses. Raises InputError for an unknown one."""
    known = (*OWN, *PEERS)
    words = [word for word in text.split(",") if word != AUTO] if text else list(known)
    unknown = [word for word in words if word not in known]
    if unknown:
        hint = f"use {', '.join((AUTO, *known))}"
        raise InputError(f"no method {unknown[0]!r}", code="unknown_method", hint=hint)
    chosen = [choose_auto(problem, Cell(*pair)) for pair in _pairs(request)]
    return tuple(name for name in known if name in words or name in chosen)


def choose_auto(problem: Problem, cell: Cell) -> str:
    """The sampler that `auto` is in such a search, without requirements; with several trials in flight in the batch."""
    task = SearchTask(cell.budget, len(problem.space.axes), is_batch=cell.in_flight > 1)
    return choose_sampler(task).sampler


def _pairs(request: Request) -> Iterator[tuple[int, int]]:
    return ((in_flight, budget) for in_flight in request.in_flight for budget in request.budgets)


def search_all(request: Request, problem: Problem, until_s: float, workers: int) -> list[RunEnd]:
    """Do all searches, or what fits into the time."""
    objective = describe_objective(problem)
    if any(method in PEERS for method in request.methods):
        make_peers_environment()
    jobs = [
        RunJob(run, request.bench, request.parameters, path_of(request.folder, run, objective), until_s)
        for run in request.runs()
    ]
    progress, ends = Progress(NAME, sum(units_of(job.run) for job in jobs)), []
    for end in side_by_side(run_search, jobs, workers):
        ends.append(end)
        if end.is_known and len(end.rows) < end.run.trials:
            continue  # the time is over
        text = f"{end.run.label}: {len(end.rows)} trials" + (f", best {end.rows[-1]['best']:.4f}" if end.rows else "")
        progress.finish(units_of(end.run), text, is_known=end.is_known)
    return ends


def units_of(run: SamplerRun) -> float:
    """Expected seconds of processor time."""
    return 1e-3 * run.trials * (TRIAL_MS + SUGGESTION_MS.get(run.method, 5.0))


def compare(request: Request, problem: Problem, ends: Sequence[RunEnd]) -> Readings:
    """All methods in each cell, over the seeds that all of them have searched so far; without one it is left out."""
    rows = {end.run: end.rows for end in ends}
    readings: Readings = {}
    for pair in _pairs(request):
        cell = Cell(*pair)
        courses = common_courses(request, rows, cell)
        if all(courses.values()):
            found = {name: _reading(request, cell, list(one.values())) for name, one in courses.items()}
            readings[cell] = {AUTO: found[choose_auto(problem, cell)], **found}
    return readings


def common_courses(
    request: Request, rows: Mapping[SamplerRun, Sequence[Row]], cell: Cell
) -> dict[str, dict[int, Sequence[Row]]]:
    """Rows by method and by those seeds that all methods have searched so far."""
    courses = {method: _courses(rows, method, cell) for method in request.methods}
    common = [seed for seed in request.seeds if all(seed in one for one in courses.values())]
    return {method: {seed: one[seed] for seed in common} for method, one in courses.items()}


def _courses(rows: Mapping[SamplerRun, Sequence[Row]], method: str, cell: Cell) -> dict[int, Sequence[Row]]:
    """Rows by seed, of the searches that were told of this number of trials or of none, and have reached it."""
    return {
        run.seed: found
        for run, found in rows.items()
        if run.method == method
        and run.in_flight == (1 if method in ONE_BY_ONE else cell.in_flight)
        and run.budget in (0, cell.budget)
        and len(found) >= cell.budget
    }


def _reading(request: Request, cell: Cell, courses: Sequence[Sequence[Row]]) -> Reading:
    start = max((budget for budget in request.budgets if budget < cell.budget), default=0)
    each_ms = [1e3 * np.mean([row["suggest_cpu_s"] for row in rows[start : cell.budget]]) for rows in courses]
    return Reading([rows[cell.budget - 1]["best"] for rows in courses], float(np.median(each_ms)))


def best_method(readings: Mapping[str, Reading]) -> str:
    """The method with the lowest median."""
    return min(readings, key=lambda name: readings[name].median)


def ratio(readings: Mapping[str, Reading], method: str) -> float:
    """The median of a method over the lowest one of all."""
    return readings[method].median / readings[best_method(readings)].median


def describe_cell(problem: Problem, cell: Cell, readings: Mapping[str, Reading]) -> dict[str, Any]:
    """The detail of one comparison, the best method first."""
    order = sorted(readings, key=lambda name: readings[name].median)
    return {
        "auto_is": choose_auto(problem, cell),
        "ratio": ratio(readings, AUTO),
        "seeds": len(readings[AUTO].scores),
        "methods": {
            name: {
                "median": readings[name].median,
                "min": min(readings[name].scores),
                "max": max(readings[name].scores),
                "ratio": ratio(readings, name),
                "cpu_ms_each": readings[name].cpu_ms,
            }
            for name in order
        },
    }


def table_text(readings: Readings) -> str:
    """For a person: median [min-max] of the best score so far, and the processor time of a suggestion."""
    lines = []
    for cell, found in readings.items():
        lines.append(f"{cell.label}, {len(found[AUTO].scores)} seeds:")
        for name in sorted(found, key=lambda name: found[name].median):
            low, high = min(found[name].scores), max(found[name].scores)
            lines.append(
                f"  {name:<16} {found[name].median:.4f} [{low:.4f}-{high:.4f}]  x{ratio(found, name):.3f}"
                f"  {found[name].cpu_ms:7.1f} ms"
            )
    return "\n".join(lines)


def _draw(request: Request, ends: Sequence[RunEnd], readings: Readings, worst: Cell, figures: str) -> str:
    from tools.measures.figures.sampler_courses import SamplerPanel, draw_courses
    from tunefree_hil.figures.style import save

    rows, panels = {end.run: end.rows for end in ends}, []
    for in_flight in request.in_flight:
        cells = [cell for cell in readings if cell.in_flight == in_flight]
        if cells:
            longest = max(cells, key=lambda cell: cell.budget)
            courses = {
                _course_name(method, longest): [
                    [row["best"] for row in course[: longest.budget]] for course in found.values()
                ]
                for method, found in common_courses(request, rows, longest).items()
            }
            panels.append(
                SamplerPanel(in_flight, courses, {cell.budget: readings[cell][AUTO].scores for cell in cells})
            )
    behind = 100.0 * (ratio(readings[worst], AUTO) - 1.0)
    sentence = f"auto is at most {behind:.1f} % behind the best ({worst.label})"
    peers = [_course_name(method, cell) for method in PEERS for cell in readings]
    return str(save(draw_courses(panels, peers, sentence), Path(figures) / f"{NAME}.png"))


def _course_name(method: str, cell: Cell) -> str:
    """A label: a method that asks for the budget searches otherwise with another one."""
    one_by_one = ", one by one" if method in ONE_BY_ONE and cell.in_flight > 1 else ""
    return f"{method} ({cell.budget} trials{one_by_one})" if method in ASK_FOR_BUDGET else method
