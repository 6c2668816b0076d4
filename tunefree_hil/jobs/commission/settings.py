"""What the bench file of a commission says beside its options, as hashes: who edits it finds out what is now stale."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from typing import Any

from tunefree_hil.bench import Bench
from tunefree_hil.config.dump import plain
from tunefree_hil.jobs.identity import own_parts
from tunefree_hil.jobs.running.foreign import program_hashes

OPTIONS = ("set", "trials")  # of [tune]: options of the commission, which stand in its identity by themselves
LEARNED = "calibration"  # of [controller]: the commission puts its own map there


def tuning_hash(bench: Bench) -> str:
    """Of all that the search goes by: roads, weights, boxes, controller."""
    spec = bench.spec
    tune = {key: value for key, value in plain(spec.tune).items() if key not in OPTIONS}
    controller = {key: value for key, value in plain(spec.controller).items() if key != LEARNED}
    files = [program_hashes(bench), own_parts(bench, spec.model), plain(bench.weights) | {"path": ""}]
    return _hash([tune, controller, spec.seed, plain(spec.faults), files, _roads(bench, spec.scenarios)])


def verify_hash(bench: Bench) -> str:
    """Of the roads that the winner is verified on."""
    return _hash(_roads(bench, bench.spec.verify_scenarios))


def _roads(bench: Bench, names: Iterable[str]) -> list[str]:
    return [bench.scenarios[name].hash for name in names]


def _hash(data: Any) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
