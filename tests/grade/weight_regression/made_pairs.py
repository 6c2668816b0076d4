"""Pairs of invented drives, for the tests of the regression."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tunefree_hil.config.load import load_weights
from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.grade.weight_regression.pairs import DrivePair, DriverKind, PairTable, RankedDrive, make_pair_table

METRICS: tuple[str, ...] = ("lateral_rms_after_start", "station_rms_after_start", "steer_rate_rms", "pedal_rate_rms")


def base_weights(**metrics: float) -> WeightsSpec:
    """The rules of `default` with other metrics; without any: a weight of 10 for each of METRICS."""
    default = load_weights("default")
    fields = {name: getattr(default, name) for name in default.__struct_fields__}
    return WeightsSpec(**{**fields, "metrics": metrics or dict.fromkeys(METRICS, 10.0)})


def drive(name: str, values: Mapping[str, float | None] | Sequence[float], task: str = "road") -> RankedDrive:
    """A finished drive."""
    metrics: Mapping[str, float | None]
    metrics = values if isinstance(values, Mapping) else dict(zip(METRICS, values, strict=True))
    return RankedDrive(name, task, metrics)


def ruled_pairs(rule: Sequence[float], n_groups: int, seed: int, n_each: int = 8) -> list[DrivePair]:
    """Pairs of random drives of which the human one has the lower score by the weights `rule`."""
    chance, pairs = np.random.default_rng(seed), []
    for group in range(n_groups):
        task = f"road {group}"
        for number in range(n_each):
            values = chance.uniform(0.0, 1.0, (2, len(METRICS)))
            values = values[np.argsort(values @ np.asarray(rule))]
            human = drive(f"person {group} {number}", values[0].tolist(), task)
            pairs.append(
                DrivePair(human, drive(f"gains {group} {number}", values[1].tolist(), task), task, DriverKind.HUMAN)
            )
    return pairs


def table_of(pairs: Sequence[DrivePair]) -> PairTable:
    """Their table by equal base weights."""
    return make_pair_table(pairs, base_weights())
