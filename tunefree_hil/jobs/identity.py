"""What a run's numbers depend on: hashes of everything that was read, and the resolved bench file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, calibration_path, model_of, part_names
from tunefree_hil.config.dump import plain, to_toml
from tunefree_hil.config.find import find
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.jobs.running.foreign import program_hashes, program_of


def identity_of(bench: Bench, model: str, scenarios: Iterable[ScenarioSpec]) -> dict[str, Any]:
    """`hashes` of the files, and `identity`: one hash over all that a score depends on."""
    controller = {key: value for key, value in plain(bench.spec.controller).items() if key != "calibration"}
    disturbed = plain([bench.spec.effects, bench.spec.faults])
    hashes: dict[str, Any] = {
        "bench": sha256_of(Path(bench.file)),
        "vehicle": bench.vehicle.hash,
        "model": model_of(bench, model).hash,
        "calibration": sha256_of(calibration_path(bench)),
        "weights": sha256_of(Path(bench.weights.path)),
        "scenarios": {scenario.name: scenario.hash for scenario in scenarios},
    }
    if bench.spec.controller.command:
        hashes["controller"] = program_hashes(bench)
    if own := own_parts(bench, model):
        hashes["parts"] = own
    counted = [{key: value for key, value in hashes.items() if key != "bench"}, controller, disturbed]
    return {"hashes": hashes, "identity": _sha(json.dumps(counted, sort_keys=True).encode())}


def own_parts(bench: Bench, model: str) -> dict[str, str]:
    """SHA-256 by name of the user's own modules ('path/to/file.py:EXPORT') that control or simulate; one that is not
    there is refused where it is built.
    """
    kinds = (*part_names(bench), model_of(bench, model).plant.kind)
    paths = {Path(kind.rpartition(":")[0]) for kind in kinds if ":" in kind}
    return {path.name: sha256_of(path) for path in sorted(paths) if path.is_file()}


def resolved_toml(bench: Bench, scenarios: Iterable[ScenarioSpec] | None = None) -> str:
    """The bench file as it was understood, to be read from the run folder: defaults filled in, and absolute paths
    where a name is found only beside the bench file. `scenarios`: those to name instead of the file's own.
    """
    spec, data = bench.spec, plain(bench.spec)
    data.pop("path", None)
    for key in ("vehicle", "model", "verify_model", "weights"):
        if data.get(key):
            data[key] = _anywhere(key.removeprefix("verify_"), data[key], bench.file)
    for key, names in (("scenarios", spec.scenarios), ("verify_scenarios", spec.verify_scenarios)):
        data[key] = [_anywhere("scenario", name, bench.file) for name in names]
    if scenarios is not None:
        named = {scenario.hash: name for name, scenario in bench.scenarios.items()}
        data["scenarios"] = [_anywhere("scenario", named.get(one.hash, one.path), bench.file) for one in scenarios]
    data["controller"] |= part_names(bench)._asdict()
    if spec.controller.command:
        data["controller"]["command"] = program_of(bench)
    beside = Path(bench.file).parent / spec.controller.calibration
    if spec.controller.calibration and beside.is_file():
        data["controller"]["calibration"] = str(beside.resolve())
    return to_toml(data)


def _anywhere(kind: str, name: str, near: str) -> str:
    """`name` where it means the same file without the bench file, else that file's path."""
    path = find(kind, name, near)
    try:
        return name if find(kind, name) == path else str(path)
    except InputError:
        return str(path)


def sha256_of(path: Path) -> str:
    """Of a file's bytes, as run.json has it."""
    return _sha(path.read_bytes())


def _sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
