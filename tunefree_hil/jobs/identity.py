"""What a run's numbers depend on: hashes of everything that was read, and the resolved bench file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tunefree_hil.bench import Bench, model_of
from tunefree_hil.config.dump import plain, to_toml
from tunefree_hil.config.schema import ScenarioSpec


def identity_of(bench: Bench, model: str, scenarios: Iterable[ScenarioSpec]) -> dict[str, Any]:
    """`hashes` of the files, and `identity`: one hash over all that a score depends on."""
    controller = plain(bench.spec.controller)
    disturbed = plain([bench.spec.effects, bench.spec.faults])
    hashes = {
        "bench": _sha(Path(bench.file).read_bytes()),
        "vehicle": bench.vehicle.hash,
        "model": model_of(bench, model).hash,
        "weights": _sha(Path(bench.weights.path).read_bytes()),
        "scenarios": {scenario.name: scenario.hash for scenario in scenarios},
    }
    counted = [{key: value for key, value in hashes.items() if key != "bench"}, controller, disturbed]
    return {"hashes": hashes, "identity": _sha(json.dumps(counted, sort_keys=True).encode())}


def resolved_toml(bench: Bench) -> str:
    """The bench file as it was understood: defaults filled in, names made absolute where they were relative paths."""
    data = plain(bench.spec)
    data.pop("path", None)
    return to_toml(data)


def _sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
