"""Small learned plants with drawn weights, that the tests share: arrays, files, plants, whole model folders."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from tests.house import ROOT
from tunefree_hil.plant import hybrid, lstm, mlp, paper, rule_based
from tunefree_hil.plant.learned.weights_file import INPUTS, save_plant
from tunefree_hil.plant.types import Plant

NETS = ("hybrid", "lstm", "mlp", "paper")
KINDS = (*NETS, "rule_based")
MODULES = {"hybrid": hybrid, "lstm": lstm, "mlp": mlp, "paper": paper, "rule_based": rule_based}
NOMINAL = ROOT / "bench_configs" / "models" / "mkz_nominal"
TYPICAL = {  # what an input goes through in an ordinary drive: mean, scale
    "speed_mps": (8.0, 5.0),
    "yaw_rate_radps": (0.0, 0.2),
    "throttle_over_rest_frac": (0.05, 0.1),
    "brake_over_rest_frac": (0.02, 0.05),
    "steer_rad": (0.0, 2.0),
    "speed_rate_mps2": (0.0, 1.0),
    "physics_speed_rate_mps2": (0.0, 1.0),
    "physics_yaw_rate_radps": (0.0, 0.2),
}
BOUND = {"hybrid": [1.0, 0.1], "lstm": [6.0, 1.2], "mlp": [6.0, 1.2], "paper": [6.0, 0.5]}


def arrays_of(kind: str, seed: int = 1, *, width: int = 8, size: float = 0.4) -> dict[str, np.ndarray]:
    """Arrays of a plant.npz; weights are Gaussian of standard deviation `size`."""
    chance, inputs = np.random.default_rng(seed), len(INPUTS[kind])

    def drawn(*shape: int) -> np.ndarray:
        return size * chance.standard_normal(shape)

    mean, scale = np.array([TYPICAL[name] for name in INPUTS[kind]]).T
    base = {"mean": mean.copy(), "scale": scale.copy(), "bound": np.array(BOUND[kind])}
    if kind == "mlp":
        return base | {"w1": drawn(width, inputs), "b1": drawn(width), "w2": drawn(2, width), "b2": drawn(2)}
    gates = 4 * width
    cell = {"w_in": drawn(gates, inputs), "w_rec": drawn(gates, width), "bias": drawn(gates)}
    return base | cell | {"w_out": drawn(2, width), "b_out": drawn(2)}


def without_way_out(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same with an output layer of 0."""
    out = {"w_out", "b_out", "w2", "b2"} & set(arrays)
    return arrays | {name: np.zeros_like(arrays[name]) for name in out}


def file_of(folder: Path, kind: str, seed: int = 1, **more: Any) -> Path:
    """A plant's file in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    if kind == "rule_based":
        return Path(shutil.copy(NOMINAL / "calibration.npz", folder / "calibration.npz"))
    save_plant(folder / "plant.npz", kind, arrays_of(kind, seed, **more))
    return folder / "plant.npz"


def plant_of(folder: Path, kind: str, seed: int = 1, **more: Any) -> Plant:
    """A plant with drawn weights; its file is written to `folder`."""
    path = file_of(folder, kind, seed, **more)
    opener = MODULES[kind].PLANT.open
    assert opener is not None
    return opener(path)


def write_model(folder: Path, kind: str, seed: int = 1, *, more: str = "", **weights: Any) -> Path:
    """A model folder of the MKZ: the nominal one's actuators, noise and map, and a learned plant."""
    shutil.copytree(NOMINAL, folder)
    text = (NOMINAL / "model.toml").read_text(encoding="utf-8")
    head, rest = text.split("[plant]")
    params, tail = rest.split("[timing]")
    lines = params.split("[plant.params]")[1].splitlines()
    known = MODULES[kind].PLANT.defaults
    kept = [line for line in lines if line.split("=")[0].strip() in known]
    plant = "\n".join([f'[plant]\nkind = "{kind}"\n[plant.params]', *kept])
    (folder / "model.toml").write_text(f"{head}{plant}\n[timing]{tail}{more}", encoding="utf-8")
    if kind != "rule_based":
        file_of(folder, kind, seed, **weights)
    return folder
