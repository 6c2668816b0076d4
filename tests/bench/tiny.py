"""A bench of a few seconds in a folder of its own, for the tests of bench, nodes and jobs."""

from __future__ import annotations

import hashlib
from pathlib import Path

SCENARIO = """schema = "tunefree.scenario/1"
name = "{name}"
noise_seed = 3
start = {{ lateral_m = 0.1, speed_mps = 5.0 }}
speed = {{ t_s = [0.0, {duration_s}], value = [5.0, {speed}] }}
curvature = {{ t_s = [0.0, 0.5, 1.0], value = [0.0, 0.0, {curvature}] }}
"""
BENCH = """schema = "tunefree.bench/1"
vehicle = "mkz_bywire"
model = "mkz_nominal"
verify_model = "mkz_nominal"
scenarios = [{scenarios}]
verify_scenarios = [{scenarios}]
seed = 1
{more}
[tune]
set = "mrac"
trials = 3
sampler = "random"
slower = 1.0
"""


def write_scenario(folder: Path, name: str = "tiny", duration_s: float = 2.0, curvature: float = 0.02) -> Path:
    """A gentle bend of `duration_s` at 5 m/s, in `folder`/scenarios."""
    path = folder / "scenarios" / f"{name}.toml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(SCENARIO.format(name=name, duration_s=duration_s, speed=5.0, curvature=curvature))
    return path


def write_bench(
    folder: Path, *, duration_s: float = 2.0, more: str = "", scenarios: tuple[str, ...] = ("tiny",)
) -> Path:
    """A bench file in `folder` that drives these scenarios; `more`: further lines of TOML before [tune]."""
    for name in scenarios:
        write_scenario(folder, name, duration_s)
    path = folder / "b.toml"
    path.write_text(BENCH.format(scenarios=", ".join(f'"{name}"' for name in scenarios), more=more))
    return path


def hash_of(folder: Path, name: str = "tiny") -> bytes:
    """What EPISODE carries of a scenario."""
    return hashlib.sha256((folder / "scenarios" / f"{name}.toml").read_bytes()).digest()[:6]
