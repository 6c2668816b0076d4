"""How much better could gains be? Winners of the learned model against a long search on the vehicle itself.

The bound: a search with the vehicle as its model and the unseen roads as its search roads, which no user has. It keeps
the requirements as they are, without the reserve of a search, and the same controller with the same map of the vehicle.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tools.measures._envelope import (
    Progress,
    VehicleDrives,
    changed_files,
    drive_sets,
    envelope_files,
    error_ratios,
    spread,
    vehicle_units,
)
from tools.measures._envelope_search import SearchRequest, Winner, search_on_vehicle, search_units
from tools.measures._ledger import FOLDER, Ledger
from tools.measures._summary import machine, rounded, summary
from tools.measures.tune11 import SEED_LABEL, StudyRequest, find_winners, make_request
from tunefree_hil.bench import Bench, load

VALUE = "score of winners of the learned model / best of a long search on the vehicle, unseen roads, worse vehicle"
NAME = "ceiling"
BOUND_LABEL = "bound, seed {}"


class CeilingAims(NamedTuple):
    """What the figures of the detail stand beside."""

    median_at_most: float = 1.15


class BoundRequest(NamedTuple):
    """Searches on the vehicle."""

    seeds: int
    trials: int


class BoundAnswers(NamedTuple):
    """One vehicle: winners of the learned model, and of searches on the vehicle, with their drives."""

    winners: list[Winner]
    tuned: list[VehicleDrives]
    searches: list[Winner]
    bounds: list[VehicleDrives]

    @property
    def best(self) -> int:
        """Number of the best bound: requirements first, then the score."""
        return min(range(len(self.bounds)), key=lambda i: (self.bounds[i].judgement.violation, self.bounds[i].score))

    @property
    def ratios(self) -> list[float]:
        """Scores of the winners over that of the best bound, by seed."""
        return [one.score / self.bounds[self.best].score for one in self.tuned]


def measure(
    seeds: int = 2,
    trials: int = 800,
    winners: int = 5,
    winner_trials: int = 0,
    roads: int = 20,
    road_seed: int = 0,
    benches: str = "",
    folder: str = FOLDER,
) -> dict[str, Any]:
    """seeds, trials: of the searches on the vehicle. winners: how many seeds of `tune11`, which are searched where
    they are missing, with winner_trials as its `trials`. The other options are those of `tune11`. Goes on when called
    again.
    """
    before = machine()
    request, bound = make_request(winners, winner_trials, roads, road_seed, folder), BoundRequest(seeds, trials)
    loaded = {Path(file).stem: load(file) for file in envelope_files(benches)}
    progress = Progress(NAME, sum(work_units(bench, request, bound) for bench in loaded.values()))
    found = {name: measure_vehicle(bench, request, bound, progress) for name, bench in loaded.items()}
    medians = {name: float(np.median(one.ratios)) for name, one in found.items()}
    worse = max(medians, key=lambda name: medians[name])
    detail = {
        "machine": before,
        "changed_files": changed_files(),
        "road_seed": request.road_seed,
        "roads": roads,
        "trials": trials,
        "worse_vehicle": worse,
        "aims": CeilingAims()._asdict(),
        "vehicles": {name: describe_vehicle(one) for name, one in found.items()},
    }
    return summary(found[worse].ratios, "of the best score of a search on the vehicle", rounded(detail))


def work_units(bench: Bench, request: StudyRequest, bound: BoundRequest) -> float:
    """Work of one vehicle, in drives on a learned model."""
    plan = request.search(bench, 1).plan()
    searched = len(bench.spec.scenarios)
    each = vehicle_units(bench) / max(searched, 1)
    of_bounds = bound.seeds * search_units(plan._replace(trials=bound.trials), request.roads)
    on_vehicle = (request.seeds + bound.seeds) * request.roads
    return request.seeds * search_units(plan, searched) + each * (on_vehicle + of_bounds)


def measure_vehicle(bench: Bench, request: StudyRequest, bound: BoundRequest, progress: Progress) -> BoundAnswers:
    """Winners and bounds, driven on the vehicle over the unseen roads."""
    unseen, ledger = request.unseen(bench), Ledger(request.folder / NAME, Path(bench.file).stem)
    winners = find_winners(bench, request, progress)
    roads = [unseen.scenarios[name] for name in unseen.spec.scenarios]
    searches = [
        search_on_vehicle(SearchRequest(bench.file, seed, bound.trials), roads, ledger, progress)
        for seed in range(1, bound.seeds + 1)
    ]
    sets = {SEED_LABEL.format(one["seed"]): one["values"] for one in winners}
    tuned = drive_sets(unseen, sets, request.ledger(bench), progress)
    sets = {BOUND_LABEL.format(one["seed"]): one["values"] for one in searches}
    bounds = drive_sets(unseen, sets, ledger, progress)
    return BoundAnswers(winners, list(tuned.values()), searches, list(bounds.values()))


def describe_vehicle(answers: BoundAnswers) -> dict[str, Any]:
    """The detail of one vehicle."""
    best = answers.bounds[answers.best]
    errors = [error_ratios(one.errors, best.errors) for one in answers.tuned]
    return {
        "median_ratio": float(np.median(answers.ratios)),
        "ratios": answers.ratios,
        "median_error_ratio": float(np.median([one["geometric_mean"] for one in errors])),
        "error_ratios": errors,
        "winners": [
            {"seed": winner["seed"], **drives.as_data()}
            for winner, drives in zip(answers.winners, answers.tuned, strict=True)
        ],
        "bounds": [
            {
                "seed": found["seed"],
                "trial": found["trial"],
                "searched": found["score"],
                "edges": found["edges"],
                "parameters": found["parameters"],
                **drives.as_data(),
            }
            for found, drives in zip(answers.searches, answers.bounds, strict=True)
        ],
        "best_bound": answers.searches[answers.best]["seed"],
        "parameters_of_winners": spread([winner["parameters"] for winner in answers.winners]),
    }
