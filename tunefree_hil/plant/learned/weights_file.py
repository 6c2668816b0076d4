"""`plant.npz` of a learned plant: its content by kind, checked when it is written and when it is read.

Arrays of float64; H hidden units, I inputs, two outputs (rate of the forward speed in m/s2, yaw rate in rad/s):

    kind     one string: hybrid, lstm, mlp or paper
    inputs   names of the inputs, those of INPUTS[kind] in that order
    mean, scale   [I]: an input is scaled as (value - mean) / scale
    hybrid, lstm, paper: w_in [4H, I], w_rec [4H, H], bias [4H] (rows: input gate, forget gate, candidate, output gate),
             w_out [2, H], b_out [2]
    mlp:     w1 [H, I], b1 [H], w2 [2, H], b2 [2]
    bound    [2]: the output is bound * tanh(linear output); of paper the linear output, clipped to the bound

Pedal inputs are duty over rest, 0 for a released pedal; `steer_rad` is the steering wheel's angle.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.kernel import table
from tunefree_hil.plant.learned.lstm_cell import Cell, Layer, rows

Array = np.ndarray

PEDALS_AND_WHEEL = ("throttle_over_rest_frac", "brake_over_rest_frac", "steer_rad")
_STATELESS = ("speed_mps", *PEDALS_AND_WHEEL, "speed_rate_mps2", "yaw_rate_radps")
INPUTS: dict[str, tuple[str, ...]] = {
    "hybrid": ("speed_mps", "yaw_rate_radps", *PEDALS_AND_WHEEL, "physics_speed_rate_mps2", "physics_yaw_rate_radps"),
    "lstm": _STATELESS,
    "mlp": _STATELESS,
    "paper": (*PEDALS_AND_WHEEL, "speed_mps", "speed_rate_mps2"),
}
CELL_KINDS = ("hybrid", "lstm", "paper")
CELL_ARRAYS = ("w_in", "w_rec", "bias", "w_out", "b_out")
LAYER_ARRAYS = ("w1", "b1", "w2", "b2")
HINT = "write it again with `tunefree-hil learn`"


class PlantFile(NamedTuple):
    """Content of a plant.npz; `arrays` without kind and inputs."""

    kind: str
    inputs: tuple[str, ...]
    arrays: Mapping[str, Array]


def save_plant(path: Path, kind: str, arrays: Mapping[str, Array]) -> None:
    """Write a plant.npz atomically; the same arrays give the same bytes.

    arrays: those of the module docstring without kind and inputs. Raises InputError where they do not fit the kind,
    BenchError when the file cannot be written.
    """
    file = PlantFile(kind, INPUTS.get(kind, ()), {name: np.asarray(arrays[name], dtype=np.float64) for name in arrays})
    _refuse(file, str(path))
    entries = {"kind": np.array(kind), "inputs": np.array(file.inputs), **dict(sorted(file.arrays.items()))}
    part = path.with_name(path.name + ".part")
    try:
        with part.open("wb") as out:
            np.savez(out, allow_pickle=False, **entries)
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise BenchError(f"cannot write: {error.strerror}", code="disk", file=str(path), hint="make room") from error


def load_plant_file(path: Path, kind: str) -> PlantFile:
    """Read and check a plant.npz of a kind. Raises InputError that names the file and the array that does not fit."""
    if not path.is_file():
        raise InputError("no such file", code="no_plant_file", file=str(path), key="plant.file", hint=HINT)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(f"cannot be read: {error}", code="bad_plant_file", file=str(path), hint=HINT) from error
    kind_in_file = str(arrays.pop("kind", ""))
    if kind_in_file != kind:
        raise InputError(
            f"is of kind {kind_in_file or 'nothing'!r}, model.toml says {kind!r}",
            code="other_plant_kind",
            file=str(path),
            key="kind",
            hint="set [plant] kind to the file's, or name the file that belongs to the kind",
        )
    inputs = tuple(str(name) for name in np.atleast_1d(arrays.pop("inputs", np.array([], dtype=str))))
    plant = PlantFile(kind, inputs, arrays)
    _refuse(plant, str(path))
    return plant


def cell_of(file: PlantFile) -> Cell:
    """The cell of a checked file, for the kernels."""
    a = {name: value.tolist() for name, value in file.arrays.items()}
    weights = rows(a["w_in"], a["w_rec"], [[value] for value in a["bias"]])
    out = rows(a["w_out"], [[value] for value in a["b_out"]])
    return Cell(table(a["mean"]), table(1.0 / value for value in a["scale"]), weights, out, table(a["bound"]))


def layer_of(file: PlantFile) -> Layer:
    """The hidden layer of a checked file, for the kernels."""
    a = {name: value.tolist() for name, value in file.arrays.items()}
    weights, out = rows(a["w1"], [[value] for value in a["b1"]]), rows(a["w2"], [[value] for value in a["b2"]])
    return Layer(table(a["mean"]), table(1.0 / value for value in a["scale"]), weights, out, table(a["bound"]))


def _refuse(file: PlantFile, path: str) -> None:
    for key, message in _problems(file):
        raise InputError(message, code="bad_plant_file", file=path, key=key, hint=HINT)


def _problems(file: PlantFile) -> Iterator[tuple[str, str]]:
    if file.kind not in INPUTS:
        yield "kind", f"no learned plant is of kind {file.kind!r}; there are {', '.join(INPUTS)}"
        return
    wanted = INPUTS[file.kind]
    if file.inputs != wanted:
        has = ", ".join(file.inputs) or "none"
        yield "inputs", f"has the inputs {has}; kind {file.kind!r} is fed {', '.join(wanted)}"
    named = ("mean", "scale", *(CELL_ARRAYS if file.kind in CELL_KINDS else LAYER_ARRAYS), "bound")
    lacking = [name for name in named if name not in file.arrays]
    strange = sorted(set(file.arrays) - set(named))
    if lacking or strange:
        words = [f"lacks {', '.join(lacking)}"] * bool(lacking) + [f"holds {', '.join(strange)}"] * bool(strange)
        yield (lacking or strange)[0], f"{' and '.join(words)}; a plant of kind {file.kind!r} is {', '.join(named)}"
        return
    for name, shape in _shapes(file).items():
        array = file.arrays[name]
        if array.dtype != np.float64 or array.shape != shape:
            yield name, f"is {array.dtype} {list(array.shape)}, expected float64 {list(shape)}"
        elif not np.all(np.isfinite(array)):
            yield name, "holds a number that is not finite"
        elif name in ("scale", "bound") and not np.all(array > 0.0):
            yield name, "holds a number that is not above 0"


def _shapes(file: PlantFile) -> dict[str, tuple[int, ...]]:
    inputs = len(INPUTS[file.kind])
    base = {"mean": (inputs,), "scale": (inputs,), "bound": (2,)}
    if file.kind in CELL_KINDS:
        width = max(file.arrays["bias"].size // 4, 1)
        gates = 4 * width
        cell = {"w_in": (gates, inputs), "w_rec": (gates, width), "bias": (gates,)}
        return base | cell | {"w_out": (2, width), "b_out": (2,)}
    width = max(file.arrays["b1"].size, 1)
    return base | {"w1": (width, inputs), "b1": (width,), "w2": (2, width), "b2": (2,)}
