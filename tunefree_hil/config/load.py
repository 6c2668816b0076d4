"""Loads the TOML files: a name or path in, a frozen spec out. Errors name file, key, what was expected, a way on."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.check import check_bench, check_model, check_scenario, check_weights
from tunefree_hil.config.check_vehicle import check_fields
from tunefree_hil.config.convert import SET_BY_LOADER, convert, read_toml
from tunefree_hil.config.find import find, nearest
from tunefree_hil.config.import_schema import ImportSpec, check_import
from tunefree_hil.config.key_meanings import WORDS
from tunefree_hil.config.learned.steering_map_schema import SteeringMapSpec
from tunefree_hil.config.problem import Problems
from tunefree_hil.config.schema import BenchSpec, ModelSpec, ScenarioSpec, Spec, VehicleSpec, WeightsSpec

SPECS: dict[str, type[Spec]] = {
    "vehicle": VehicleSpec,
    "model": ModelSpec,
    "scenario": ScenarioSpec,
    "weights": WeightsSpec,
    "bench": BenchSpec,
    "import": ImportSpec,
    "steering_map": SteeringMapSpec,
}
Name = str | Path


def load_vehicle(name: Name, near: Name | None = None, check: bool = True) -> VehicleSpec:
    """A vehicle folder. `hash`: SHA-256 over vehicle.toml and its DBC files.

    check=False skips the checks, for `doctor`, which lists their problems with those of the DBC.
    """
    path = find("vehicle", name, near)
    spec = convert(read_toml(path), VehicleSpec, path)
    dbc = [path.parent / file for file in spec.dbc]
    spec = replace(spec, folder=str(path.parent), hash=_hash([path, *dbc]))
    problems = check_fields(spec) if check else []
    if problems:
        raise _one_error(problems)
    return spec


def load_model(name: Name, near: Name | None = None) -> ModelSpec:
    """A model folder. `hash`: SHA-256 over model.toml and the folder's .npz files, in the order of their names."""
    path = find("model", name, near)
    spec = convert(read_toml(path), ModelSpec, path)
    _refuse(path, check_model(spec))
    return replace(spec, folder=str(path.parent), hash=_hash([path, *sorted(path.parent.glob("*.npz"))]))


def load_scenario(name: Name, near: Name | None = None) -> ScenarioSpec:
    """A scenario. `hash`: SHA-256 of the file's bytes, of which EPISODE carries the first 6."""
    path = find("scenario", name, near)
    spec = convert(read_toml(path), ScenarioSpec, path)
    _refuse(path, check_scenario(spec))
    return replace(spec, path=str(path), hash=_hash([path]))


def load_weights(name: Name, near: Name | None = None) -> WeightsSpec:
    """Metric weights and failure rules."""
    path = find("weights", name, near)
    spec = convert(read_toml(path), WeightsSpec, path)
    _refuse(path, check_weights(spec))
    return replace(spec, path=str(path))


def load_bench(name: Name, near: Name | None = None) -> BenchSpec:
    """A bench file; what it names is not loaded here, but found from its folder (`near`)."""
    path = find("bench", name, near)
    spec = convert(read_toml(path), BenchSpec, path)
    _refuse(path, check_bench(spec))
    return replace(spec, path=str(path))


def load_import(name: Name) -> ImportSpec:
    """A mapping file of `log import`, by its path. `hash`: SHA-256 of the file's bytes."""
    path = Path(name)
    spec = convert(read_toml(path), ImportSpec, path)
    _refuse(path, check_import(spec))
    return replace(spec, path=str(path), hash=_hash([path]))


def json_schema(name: str) -> dict[str, Any]:
    """The JSON Schema of a kind of file, one of SPECS. Every key is described."""
    if name not in SPECS:
        raise InputError(f"no schema {name!r}", code="unknown_schema", key="schema", hint=nearest(name, SPECS))
    schema = msgspec.json.schema(SPECS[name])
    definitions = schema["$defs"]
    for key in SET_BY_LOADER:
        definitions[SPECS[name].__name__]["properties"].pop(key, None)
    for kind, definition in definitions.items():
        for key, entry in definition.get("properties", {}).items():
            entry["description"] = WORDS[kind][key]
            if entry.get("default") == math.inf:  # JSON has no infinity
                del entry["default"]
    return schema


def _hash(paths: Iterable[Path]) -> str:
    """Hex SHA-256 over the files' bytes; a missing one counts as empty (its user reports it)."""
    digest = hashlib.sha256()
    for path in paths:
        if path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _refuse(path: Path, problems: Problems) -> None:
    errors = [
        InputError(message, code="does_not_fit", file=str(path), key=key, hint=hint) for key, message, hint in problems
    ]
    if errors:
        raise _one_error(errors)


def _one_error(problems: list[InputError]) -> InputError:
    """The only problem, or one error that lists all."""
    if len(problems) == 1:
        return problems[0]
    listed = "\n".join(f"  {problem.key}: {problem.message} ({problem.hint})" for problem in problems)
    first = problems[0]
    message = f"{len(problems)} things do not fit:\n{listed}"
    return InputError(message, code=first.code, file=first.file, key=first.key, hint="correct them all")
