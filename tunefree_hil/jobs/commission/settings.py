"""Hashes of what the bench file of a commission has beside its options: a change makes stages out of date."""

from __future__ import annotations

from collections.abc import Iterable

from tunefree_hil.bench import Bench
from tunefree_hil.config.dump import plain
from tunefree_hil.jobs.identity import data_sha256, user_part_hashes
from tunefree_hil.jobs.running.foreign import program_hashes

OPTIONS = ("set", "trials")  # of [tune]: options of the commission, which are in its identity
LEARNED = "calibration"  # of [controller]: replaced by the learned map


def tuning_hash(bench: Bench) -> str:
    """Hash of what the search depends on: scenarios, weights, ranges, controller."""
    spec = bench.spec
    tune = {key: value for key, value in plain(spec.tune).items() if key not in OPTIONS}
    controller = {key: value for key, value in plain(spec.controller).items() if key != LEARNED}
    files = [program_hashes(bench), user_part_hashes(bench, spec.model), plain(bench.weights) | {"path": ""}]
    return data_sha256(
        [tune, controller, spec.seed, plain(spec.faults), files, _scenario_hashes(bench, spec.scenarios)]
    )


def verify_hash(bench: Bench) -> str:
    """Hash of the scenarios of the verification."""
    return data_sha256(_scenario_hashes(bench, bench.spec.verify_scenarios))


def _scenario_hashes(bench: Bench, names: Iterable[str]) -> list[str]:
    return [bench.scenarios[name].hash for name in names]
