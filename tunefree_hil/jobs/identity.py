"""Identity of a run: hashes of all its input files, and the resolved bench file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, calibration_path, model_of, part_names
from tunefree_hil.bench.identified import steering_map_path
from tunefree_hil.config.dump import plain, to_toml
from tunefree_hil.config.find import find
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.jobs.running.foreign import controller_program, program_hashes

FILE_KEYS = ("calibration", "steering_map")  # of [controller]: their content counts, wherever they lie


def compute_identity(bench: Bench, model: str, scenarios: Iterable[ScenarioSpec]) -> dict[str, Any]:
    """`hashes` of the files, and `identity`: one hash over everything that a score depends on."""
    controller = {key: value for key, value in plain(bench.spec.controller).items() if key not in FILE_KEYS}
    disturbed = plain([bench.spec.effects, bench.spec.faults])
    hashes: dict[str, Any] = {
        "bench": file_sha256(Path(bench.file)),
        "vehicle": bench.vehicle.hash,
        "model": model_of(bench, model).hash,
        "calibration": file_sha256(calibration_path(bench)),
        "weights": file_sha256(Path(bench.weights.path)),
        "scenarios": {scenario.name: scenario.hash for scenario in scenarios},
    }
    if steering := steering_map_hash(bench):
        hashes["steering_map"] = steering
    if bench.spec.ensemble is not None:
        hashes["ensemble"] = data_sha256([plain(bench.spec.ensemble), bench.spec.seed])  # the seed draws the cars
    if bench.spec.controller.command:
        hashes["controller"] = program_hashes(bench)
    if user_parts := user_part_hashes(bench, model):
        hashes["parts"] = user_parts
    counted = [{key: value for key, value in hashes.items() if key != "bench"}, controller, disturbed]
    return {"hashes": hashes, "identity": data_sha256(counted)}


def steering_map_hash(bench: Bench) -> str:
    """SHA-256 of the steering map's file, or the word of another choice; '' for what the model says of its axles."""
    path = steering_map_path(bench)
    return file_sha256(path) if path is not None and path.is_file() else bench.spec.controller.steering_map or ""


def user_part_hashes(bench: Bench, model: str) -> dict[str, str]:
    """SHA-256 of the user's modules ('path/to/file.py:EXPORT') for control and plant, by name; missing ones are left
    out, as building them fails.
    """
    kinds = (*part_names(bench), model_of(bench, model).plant.kind)
    paths = {Path(kind.rpartition(":")[0]) for kind in kinds if ":" in kind}
    return {path.name: file_sha256(path) for path in sorted(paths) if path.is_file()}


def resolved_toml(bench: Bench, scenarios: Iterable[ScenarioSpec] | None = None) -> str:
    """The bench file for the run folder: with defaults, and absolute paths for names that are found only beside it.

    scenarios: to name instead of the file's own. Made roads have no file: the table `roads` makes them again.
    """
    spec, data = bench.spec, plain(bench.spec)
    data.pop("path", None)
    for key in ("vehicle", "model", "verify_model", "weights"):
        if data.get(key):
            data[key] = _portable_name(key.removeprefix("verify_"), data[key], bench.file)
    for key, names in (("scenarios", spec.scenarios), ("verify_scenarios", spec.verify_scenarios)):
        data[key] = [_portable_name("scenario", name, bench.file) for name in names if not _is_made(bench, name)]
    if scenarios is not None:
        named = {scenario.hash: name for name, scenario in bench.scenarios.items()}
        files = [named.get(one.hash, one.path) for one in scenarios if one.path]
        data["scenarios"] = [_portable_name("scenario", name, bench.file) for name in files]
    data["controller"] |= part_names(bench)._asdict()
    if spec.controller.command:
        data["controller"]["command"] = controller_program(bench)
    for key in FILE_KEYS:
        beside = Path(bench.file).parent / (getattr(spec.controller, key) or "")
        if beside.is_file():
            data["controller"][key] = str(beside.resolve())
    return to_toml(data)


def _is_made(bench: Bench, name: str) -> bool:
    """Whether a scenario of the bench is a made road: it has no file."""
    return not bench.scenarios[name].path


def _portable_name(kind: str, name: str, near: str) -> str:
    """`name` where it finds the same file without the bench file, else the path of that file."""
    path = find(kind, name, near)
    try:
        return name if find(kind, name) == path else str(path)
    except InputError:
        return str(path)


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, as in run.json."""
    return _sha256(path.read_bytes())


def data_sha256(data: Any) -> str:
    """SHA-256 of plain data, as JSON with sorted keys."""
    return _sha256(json.dumps(data, sort_keys=True).encode())


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
