"""Do weights that are regressed from pairs rank drives that they were not made from as a human drives (paper, eq. 10)?

Two kinds of human: the driver model of this project on made roads (many pairs, but a model), and the manually driven
parts of recorded production cars (real persons, three metrics; _weights_recorded.py). Whole roads are held out.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tools.measures._ledger import ROOT
from tools.measures._summary import rounded
from tools.measures._weights_recorded import (
    COMPARED,
    ROADS_S,
    generated_metrics,
    human_metrics,
    read_human_drives,
    road_of,
)
from tools.measures.parity import bench_files
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, load
from tunefree_hil.bench.batch import Batch, Job
from tunefree_hil.config.load import load_weights
from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.grade.weight_regression.pairs import (
    DrivePair,
    DriverKind,
    PairTable,
    RankedDrive,
    make_pair_table,
    score_margins,
)
from tunefree_hil.grade.weight_regression.ranking import CRITERIA, accuracy_interval, margins_of_other_weights
from tunefree_hil.jobs.weights.driven_pairs import drive_pairs, task_of
from tunefree_hil.jobs.weights.gain_sets import make_gain_sets
from tunefree_hil.jobs.weights.options import WeightsOptions
from tunefree_hil.jobs.weights.weights import rank_pairs
from tunefree_hil.tune.weight_regression.cross_validation import Regression, regress

VALUE = "held-out pairs that regressed weights rank as a human (the driver model) drives, percent"


class RankedKind(NamedTuple):
    """The pairs of a kind of human on one vehicle, their table and the regression from them."""

    pairs: list[DrivePair]
    table: PairTable
    regression: Regression

    @property
    def groups(self) -> list[str]:
        """Group of each pair."""
        return [pair.group for pair in self.pairs]


def learned_bench_files() -> list[Path]:
    """The bench file on the learned plant of each vehicle, as tools/make_models.py names them."""
    return sorted((ROOT / "bench_configs").glob("*_learned.toml"))


def measure(
    roads: int = 30, sets: int = 20, seed: int = 4711, benches: str = "",
    recorded: int = 1,
) -> dict[str, Any]:  # fmt: skip
    """`sets` random sets of gains and the manual ones against three drivers on `roads` made roads of each vehicle.

    benches: bench files with commas between; default: the one on the learned plant of each vehicle.
    recorded: 0 without the recorded drives, which need the shared data.
    """
    base = load_weights("default")
    detail: dict[str, Any] = {}
    right: list[float] = []
    n_pairs = 0
    for path in bench_files(benches) if benches else learned_bench_files():
        bench = load(path)
        pairs, n_all = _model_pairs(Path(path), WeightsOptions(Path("none.toml"), roads=roads, sets=sets, seed=seed))
        ranked = _regress(pairs, base, seed)
        answer = {**_accuracies(ranked, base, seed), "n_all": n_all}
        if recorded:
            vectors = make_gain_sets(bench, sets, seed)
            answer["recorded"] = {
                f"road_{sigma_s:g}s": _recorded_accuracies(_recorded_pairs(bench, vectors, sigma_s), ranked, base, seed)
                for sigma_s in ROADS_S
            }
        detail[bench.vehicle.name] = answer
        right += [float(margin > 0.0) for margin in ranked.regression.held_out.margins]
        n_pairs += len(ranked.pairs)
    shares = [100.0 * answer["regressed"]["share"] for answer in detail.values()]
    value = 100.0 * float(np.mean(right))
    return {
        "value": value, "unit": "%", "n": n_pairs, "low": min(shares), "high": max(shares), "detail": rounded(detail),
    }  # fmt: skip


def _model_pairs(bench: Path, options: WeightsOptions) -> tuple[list[DrivePair], int]:
    """Pairs that weights decide, and the number of all."""
    with tempfile.TemporaryDirectory() as folder:
        steps = drive_pairs(options._replace(bench=bench), Path(folder))
        while True:
            try:
                print(next(steps).message)
            except StopIteration as end:
                pairs = end.value
                break
    ranked = rank_pairs(pairs, load_weights(options.base))
    return ranked.pairs, ranked.n_all


def _regress(pairs: list[DrivePair], base: WeightsSpec, seed: int) -> RankedKind:
    table = make_pair_table(pairs, base)
    steps = regress(table, [pair.group for pair in pairs], CRITERIA.margin, seed)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return RankedKind(pairs, table, end.value)


def _accuracies(ranked: RankedKind, base: WeightsSpec, seed: int) -> dict[str, Any]:
    """Accuracy by weights on the same pairs, and of the control."""
    margins = {
        "regressed": ranked.regression.held_out.margins,
        base.name: score_margins(ranked.table, np.ones(len(ranked.table.metrics))),
        "paper": margins_of_other_weights(ranked.pairs, "paper"),
    }
    answer: dict[str, Any] = {
        name: accuracy_interval(values, ranked.groups, seed)._asdict() for name, values in margins.items()
    }
    permuted = np.asarray(ranked.regression.permuted)
    answer["permuted"] = {"mean": float(permuted.mean()), "low": float(permuted.min()), "high": float(permuted.max())}
    multipliers = ranked.regression.fit.multipliers
    answer["multipliers"] = dict(zip(ranked.table.metrics, multipliers.tolist(), strict=True))
    return {**answer, "strength": ranked.regression.choice.strength, "n_groups": len(set(ranked.groups))}


def _recorded_accuracies(pairs: list[DrivePair], model: RankedKind, base: WeightsSpec, seed: int) -> dict[str, Any]:
    """Real drivers: weights from the model's pairs, weights from other real drives, base weights."""
    ranked = _regress(pairs, base, seed)
    transferred = score_margins(ranked.table, model.regression.fit.multipliers)
    answer = _accuracies(ranked, base, seed)
    answer["from_model_pairs"] = accuracy_interval(transferred, ranked.groups, seed)._asdict()
    answer["metrics_lower_in_human"] = {
        name: float(np.mean(ranked.table.differences[:, ranked.table.metrics.index(name)] < 0.0)) for name in COMPARED
    }
    return answer


def _recorded_pairs(bench: Bench, vectors: dict[str, dict[str, float]], sigma_s: float) -> list[DrivePair]:
    """Each real drive against all sets of gains that drove its road to the end without a re-plan."""
    nominal, rate_radps = bench.vehicle.nominal, bench.vehicle.limits.steer_rate_radps
    if nominal.wheelbase_m is None or nominal.steer_ratio is None:
        raise InputError("needs wheelbase and steering ratio", file=bench.file, key="vehicle")
    drives = read_human_drives(nominal.steer_ratio * nominal.wheelbase_m)
    pairs: list[DrivePair] = []
    with Batch(bench, bench.spec.verify_model) as batch:
        for drive in drives:
            road = road_of(drive, sigma_s)
            human = RankedDrive(f"person on {road.name}", task_of(road), human_metrics(drive, rate_radps))
            driven = _driven_metrics(batch, road, vectors, len(drive.speed_mps), rate_radps)
            pairs += [DrivePair(human, generated, road.name, DriverKind.HUMAN) for generated in driven]
    return pairs


def _driven_metrics(
    batch: Batch, road: Any, vectors: dict[str, dict[str, float]], n_rows: int, rate_radps: float
) -> Sequence[RankedDrive]:
    try:
        driven = batch.drive([Job(values, road) for values in vectors.values()], columns=True)
    except InputError as error:  # the bench's vehicle cannot drive what the person drove
        print(f"{road.name}: {error.message}")
        return []
    drives = []
    for name, result in zip(vectors, driven, strict=True):
        grade, recording = result.grade, result.recording
        if grade is None or recording is None:
            continue
        drive = RankedDrive(f"{name} on {road.name}", task_of(road), {}, grade.outcome, grade.replans)
        if drive.is_decided_by_weights:
            drives.append(drive._replace(metrics=generated_metrics(recording, n_rows, rate_radps)))
    return drives
