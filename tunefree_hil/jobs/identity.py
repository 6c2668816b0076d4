"""What a run's numbers depend on: hashes of everything that was read, and the resolved bench file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from tunefree_hil.bench import Bench, model_of
from tunefree_hil.config.schema import ScenarioSpec


def identity_of(bench: Bench, model: str, scenarios: Iterable[ScenarioSpec]) -> dict[str, Any]:
    """`hashes` (bench, vehicle, model, weights, scenarios) and `identity`, one hash over all that a score depends on."""
    controller = msgspec.to_builtins(bench.spec.controller)
    disturbed = msgspec.to_builtins([bench.spec.effects, bench.spec.faults])
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
    data = _without_none(msgspec.to_builtins(bench.spec))
    data.pop("path", None)
    return tomli_w.dumps(data)


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(one) for key, one in value.items() if one is not None and one != {}}
    if isinstance(value, list):
        return [_without_none(one) for one in value]
    return value


def _sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
