"""The files of a bench as plain data, so that another machine drives the same without a copy of them.

A pack has the vehicle folder, the models that are driven and that the controller knows, weights, and maps. It holds
data only: a bench with modules of the user's own is not packed.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath

import tunefree_hil
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, calibration_path, model_of, part_names
from tunefree_hil.bench.identified import steering_map_path
from tunefree_hil.config.convert import read_toml
from tunefree_hil.config.dump import to_toml
from tunefree_hil.jobs.identity import FILE_KEYS

BENCH_FILE = "bench.toml"
SUFFIXES = (".toml", ".npz", ".json", ".dbc")  # of data; nothing else is packed
# Folders of the package that decide a drive; the others only read its result.
CODE = "version or modules of tunefree_hil"  # in the hashes of a sweep
DRIVING_FOLDERS = ("base", "batch", "bench", "bus", "config", "control", "effects", "episode", "grade", "nodes")
DRIVING_FOLDERS += ("plant", "roads", "tune", "jobs/robustness", "jobs/tune/ensemble")

Pack = Mapping[str, bytes]  # content of a file by its path in the pack


def pack_bench(bench: Bench, model: str) -> Pack:
    """The files with which `model` is driven.

    Raises:
        InputError: A part of the controller or a plant is a module of the user's own.
    """
    tuned, driven = model_of(bench, bench.spec.model), model_of(bench, model)
    _refuse_user_parts(bench, (*part_names(bench), driven.plant.kind))
    files: dict[str, bytes] = {}
    for name, folder in (("vehicle", bench.vehicle.folder), ("tuned_model", tuned.folder), ("model", driven.folder)):
        files |= _read_folder(name, Path(folder))
    files["weights.toml"] = Path(bench.weights.path).read_bytes()
    spec = read_toml(Path(bench.file))
    spec |= {"vehicle": "vehicle", "model": "tuned_model", "verify_model": "model", "weights": "weights"}
    # The roads of a sweep are made from its order; a bench file must name roads all the same.
    spec |= {"scenarios": [], "verify_scenarios": [], "roads": {"search": "families:1"}}
    for key, path in zip(FILE_KEYS, (calibration_path(bench), steering_map_path(bench)), strict=True):
        if spec.get("controller", {}).get(key) and path is not None and path.is_file():
            files[f"{key}{path.suffix}"] = path.read_bytes()
            spec["controller"][key] = f"{key}{path.suffix}"
    return {**files, BENCH_FILE: to_toml(spec).encode()}


def unpack_bench(pack: Pack, folder: Path) -> Path:
    """Write the files of a pack into a folder, and nowhere else. Returns the bench file."""
    for name, content in pack.items():
        parts = PurePosixPath(name)
        if parts.is_absolute() or ".." in parts.parts or parts.suffix not in SUFFIXES:
            raise InputError(
                f"a pack may not hold {name!r}", code="bad_pack", hint="use the same tunefree_hil everywhere"
            )
        path = folder / parts
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return folder / BENCH_FILE


@functools.cache
def hash_code() -> str:
    """SHA-256 over the modules of the package that decide a drive."""
    root, digest = Path(tunefree_hil.__file__).parent, hashlib.sha256()
    for path in sorted(path for folder in DRIVING_FOLDERS for path in (root / folder).rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def describe_code() -> str:
    """Version and modules that drive, for the hashes of a sweep."""
    return f"{tunefree_hil.__version__} {hash_code()}"


def _read_folder(name: str, folder: Path) -> dict[str, bytes]:
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.suffix in SUFFIXES]
    return {f"{name}/{path.relative_to(folder).as_posix()}": path.read_bytes() for path in paths}


def _refuse_user_parts(bench: Bench, kinds: Iterable[str]) -> None:
    own = sorted({kind for kind in kinds if ":" in kind})
    if own:
        raise InputError(
            f"{', '.join(own)} is a program of yours, and only data are sent to other machines",
            code="not_on_cluster",
            file=bench.file,
            key="--scheduler",
            hint="leave out --scheduler: the threads of this machine drive it",
        )
