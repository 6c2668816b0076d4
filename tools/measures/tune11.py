"""Tuned on the learned model, driven on the vehicle: errors over those of manual sets, on roads that nobody had seen.

Each seed is the search of `tunefree-hil tune BENCH --backend batch` as the bench file says. Its winner, the manual sets
of the paper's plain controller, and the manual sets of the same controller as the winner's are driven on the vehicle
over roads whose seed follows from the commit.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tools.measures._envelope import (
    ERRORS,
    BestSet,
    Progress,
    VehicleDrives,
    best_set,
    changed_files,
    drive_errors,
    drive_sets,
    envelope_files,
    error_ratios,
    head_commit,
    mean_errors,
    on_roads,
    seed_of_commit,
    spread,
    unseen_roads,
    vehicle_units,
    with_plain_controller,
    write_text,
)
from tools.measures._envelope_search import SearchRequest, Winner, find_winner, search_units
from tools.measures._ledger import FIGURES, FOLDER, Ledger
from tools.measures._rig import failed, replans
from tools.measures._summary import machine, rounded, summary
from tunefree_hil.bench import Bench, load
from tunefree_hil.grade.requirements.verdict import JudgedGains, decide_verdict
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors
from tunefree_hil.jobs.tune.verdict.text import verdict_reason

VALUE = "errors after the start, tuned / best manual set of the plain controller, vehicle, unseen roads, worse vehicle"
NAME = "tune11"
SEED_LABEL = "seed {}"


class ErrorAims(NamedTuple):
    """What the figures of the detail stand beside; ratios, the lower the better."""

    median: float = 0.20
    median_at_most: float = 0.30
    seed_at_most: float = 0.40
    single_at_most: float = 1.0  # one error of one seed
    improved_at_most: float = 0.60  # against the best manual set of the same controller
    score_at_most: float = 0.65
    oscillating_drives: int = 0


class StudyRequest(NamedTuple):
    """What is measured. trials: 0 is the bench file's number; road_seed: of the roads that no search has."""

    seeds: int
    trials: int
    roads: int
    road_seed: int
    folder: Path

    def ledger(self, bench: Bench) -> Ledger:
        """Where the studies and drives of a vehicle are kept."""
        return Ledger(self.folder / NAME, Path(bench.file).stem)

    def unseen(self, bench: Bench) -> Bench:
        """The bench on the roads that no search has."""
        return on_roads(bench, unseen_roads(bench, self.roads, self.road_seed))

    def search(self, bench: Bench, seed: int) -> SearchRequest:
        """The study of a seed."""
        return SearchRequest(bench.file, seed, self.trials)


class VehicleAnswers(NamedTuple):
    """One vehicle: manual sets by name, winners and their drives by seed, verdicts of the job on its own roads."""

    plain: dict[str, VehicleDrives]
    improved: dict[str, VehicleDrives]
    winners: list[Winner]
    tuned: list[VehicleDrives]
    verdicts: list[dict[str, str]]

    @property
    def best_plain(self) -> BestSet:
        """Of the plain controller's manual sets."""
        return best_set(self.plain)

    @property
    def ratios(self) -> list[dict[str, float]]:
        """By seed: the errors over those of the best manual set of the plain controller."""
        return [error_ratios(one.errors, self.plain[self.best_plain.name].errors) for one in self.tuned]


def measure(
    seeds: int = 5,
    trials: int = 0,
    roads: int = 20,
    road_seed: int = 0,
    benches: str = "",
    folder: str = FOLDER,
    figures: str = FIGURES,
) -> dict[str, Any]:
    """trials: 0 is the bench file's number. road_seed: of the unseen roads, 0 for the commit's. benches: files with
    commas between, '' for all of the whole envelope, one a vehicle. Goes on when called again. `<folder>/tune11/` gets
    answers.csv: every drive on the unseen roads, with errors, requirements and metrics.
    """
    before, request = machine(), make_request(seeds, trials, roads, road_seed, folder)
    loaded = {Path(file).stem: load(file) for file in envelope_files(benches)}
    progress = Progress(NAME, sum(work_units(bench, request) for bench in loaded.values()))
    found = {name: measure_vehicle(bench, request, progress) for name, bench in loaded.items()}
    table = write_text(request.folder / NAME / "answers.csv", answers_text(found))
    medians = {name: median_ratio(one) for name, one in found.items()}
    worse = max(medians, key=lambda name: medians[name])
    detail = {
        "machine": before,
        "commit": head_commit() if not road_seed else "",
        "changed_files": changed_files(),
        "road_seed": request.road_seed,
        "roads": roads,
        "worse_vehicle": worse,
        "aims": ErrorAims()._asdict(),
        "vehicles": {name: describe_vehicle(one) for name, one in found.items()},
        "answers": table,
        "figure": _draw(found, figures),
    }
    values = [ratio["geometric_mean"] for ratio in found[worse].ratios]
    return summary(values, "of the errors of the best plain manual set", rounded(detail))


def make_request(seeds: int, trials: int, roads: int, road_seed: int, folder: str) -> StudyRequest:
    """The options; a seed of 0 for the roads is that of the commit."""
    return StudyRequest(seeds, trials, roads, road_seed or seed_of_commit(head_commit()), Path(folder))


def work_units(bench: Bench, request: StudyRequest) -> float:
    """Work of one vehicle, in drives on a learned model."""
    plan = request.search(bench, 1).plan()
    searched, manual = len(bench.spec.scenarios), len(plan.vectors)
    on_vehicle = (2 * manual + request.seeds) * request.roads + (manual + request.seeds) * len(
        bench.spec.verify_scenarios
    )
    each = vehicle_units(bench) / max(searched, 1)
    return request.seeds * search_units(plan, searched) + each * on_vehicle


def find_winners(bench: Bench, request: StudyRequest, progress: Progress) -> list[Winner]:
    """The winner of each seed; those that are known are not searched again."""
    ledger = request.ledger(bench)
    return [find_winner(request.search(bench, seed), ledger, progress) for seed in range(1, request.seeds + 1)]


def measure_vehicle(bench: Bench, request: StudyRequest, progress: Progress) -> VehicleAnswers:
    """Search every seed, and drive winners and manual sets on the vehicle over the unseen roads."""
    ledger, unseen, plain = request.ledger(bench), request.unseen(bench), with_plain_controller(bench)
    winners = find_winners(bench, request, progress)
    tuned = {SEED_LABEL.format(winner["seed"]): winner["values"] for winner in winners}
    manual = compute_baseline_vectors(bench)
    of_plain = drive_sets(with_plain_controller(unseen), compute_baseline_vectors(plain), ledger, progress)
    of_improved = drive_sets(unseen, manual | tuned, ledger, progress)
    return VehicleAnswers(
        plain=of_plain,
        improved={name: of_improved[name] for name in manual},
        winners=winners,
        tuned=[of_improved[name] for name in tuned],
        verdicts=_judge_as_job(bench, manual, tuned, ledger, progress),
    )


def _judge_as_job(
    bench: Bench,
    manual: Mapping[str, Mapping[str, float]],
    tuned: Mapping[str, Mapping[str, float]],
    ledger: Ledger,
    progress: Progress,
) -> list[dict[str, str]]:
    """The verdict on each winner that `verify` gives, over the roads that the bench file verifies on."""
    own = on_roads(bench, [bench.scenarios[name] for name in bench.spec.verify_scenarios])
    found = drive_sets(own, {**manual, **tuned}, ledger, progress)
    judged = {name: JudgedGains(one.score, one.judgement) for name, one in found.items()}
    decided = [decide_verdict(judged[name], {other: judged[other] for other in manual}) for name in tuned]
    return [{"verdict": one.verdict.value, "reason": verdict_reason(one)} for one in decided]


def median_ratio(answers: VehicleAnswers) -> float:
    """Over the seeds, of the geometric mean of the three ratios."""
    return float(np.median([ratio["geometric_mean"] for ratio in answers.ratios]))


def describe_common_roads(answers: VehicleAnswers) -> dict[str, Any]:
    """The ratios over only those roads that the best plain manual set drives to the end without a re-plan.

    Where that set leaves the lane, any set that stays in it looks good; these ratios are without such roads.
    """
    plain = answers.plain[answers.best_plain.name].drives
    roads = [road for road, drive in plain.items() if not failed({road: drive}) and not replans({road: drive})]
    if not roads:
        return {"roads": 0}
    base = mean_errors({road: plain[road] for road in roads})
    ratios = [error_ratios(mean_errors({road: one.drives[road] for road in roads}), base) for one in answers.tuned]
    return {"roads": len(roads), **{name: float(np.median([one[name] for one in ratios])) for name in ratios[0]}}


def describe_vehicle(answers: VehicleAnswers) -> dict[str, Any]:
    """The detail of one vehicle."""
    plain, best, ratios = answers.best_plain, best_set(answers.improved), answers.ratios
    best_plain, best_improved = answers.plain[plain.name], answers.improved[best.name]
    to_improved = [error_ratios(one.errors, best_improved.errors) for one in answers.tuned]
    scores = [one.score / best_plain.score for one in answers.tuned]
    return {
        "median_ratio": median_ratio(answers),
        "where_plain_drives": describe_common_roads(answers),
        "largest_seed": max(ratio["geometric_mean"] for ratio in ratios),
        "largest_single_ratio": max(ratio[name] for ratio in ratios for name in ERRORS),
        "score_ratio": float(np.median(scores)),
        "improved_ratio": float(np.median([ratio["geometric_mean"] for ratio in to_improved])),
        "oscillating_drives": sum(one.n_oscillating for one in answers.tuned),
        "requirements_met": f"{sum(one.judgement.is_met for one in answers.tuned)} of {len(answers.tuned)}",
        "verdicts": answers.verdicts,
        "plain_manual": {**plain._asdict(), **best_plain.as_data()},
        "improved_manual": {**best._asdict(), **best_improved.as_data()},
        "seeds": [
            {**_describe_seed(winner, one, ratio), "score_ratio": score, "improved_ratio": improved["geometric_mean"]}
            for winner, one, ratio, score, improved in zip(
                answers.winners, answers.tuned, ratios, scores, to_improved, strict=True
            )
        ],
        "parameters": spread([winner["parameters"] for winner in answers.winners]),
        "manual_sets": {
            kind: {name: one.as_data() for name, one in sets.items()}
            for kind, sets in (("plain", answers.plain), ("improved", answers.improved))
        },
    }


def _describe_seed(winner: Winner, drives: VehicleDrives, ratio: Mapping[str, float]) -> dict[str, Any]:
    known = {name: winner[name] for name in ("seed", "trial", "trials", "violation", "parameters", "edges")}
    return {
        **known,
        "on_model": winner["score"],
        "ratios": dict(ratio),
        "on_vehicle": drives.as_data(),
    }


def answers_text(found: Mapping[str, VehicleAnswers]) -> str:
    """CSV: a line for each drive on the unseen roads."""
    rows = [row for name, answers in found.items() for row in _rows(name, answers)]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _rows(vehicle: str, answers: VehicleAnswers) -> Iterator[dict[str, Any]]:
    tuned = {SEED_LABEL.format(winner["seed"]): one for winner, one in zip(answers.winners, answers.tuned, strict=True)}
    for kind, sets in (("plain manual", answers.plain), ("improved manual", answers.improved), ("tuned", tuned)):
        for name, one in sets.items():
            for road, drive in one.drives.items():
                yield {"bench": vehicle, "kind": kind, "set": name, "road": road, **drive_row(drive)}


def drive_row(drive: Mapping[str, Any]) -> dict[str, Any]:
    """A drive as cells: how it went, errors, requirements, metrics."""
    numbers = {**drive_errors(drive), **(drive.get("requirements") or {}), **drive["metrics"]}
    return {
        "outcome": drive["outcome"],
        "replans": drive["replans"],
        "oscillates": int(bool(drive.get("oscillation"))),
        "score": f"{drive['score']:.5g}",
        **{name: "" if value is None else f"{value:.5g}" for name, value in numbers.items()},
    }


def _draw(found: Mapping[str, VehicleAnswers], figures: str) -> str:
    from tools.measures.figures.vehicle_errors import SetErrors, draw_errors
    from tunefree_hil.figures.style import save

    def errors_of(sets: Sequence[VehicleDrives], name: str) -> list[float]:
        return [getattr(one.errors, name) for one in sets]

    panels = {
        name: {
            vehicle.partition("_")[0]: SetErrors(
                errors_of([one.plain[one.best_plain.name]], name)[0],
                errors_of([one.improved[best_set(one.improved).name]], name)[0],
                errors_of(one.tuned, name),
            )
            for vehicle, one in found.items()
        }
        for name in ERRORS
    }
    ratios = {vehicle.partition("_")[0]: median_ratio(one) for vehicle, one in found.items()}
    return str(save(draw_errors(panels, ratios), Path(figures) / f"{NAME}.png"))
