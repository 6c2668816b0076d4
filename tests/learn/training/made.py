"""What the training tests share: drives of a car that is not the physics it is taken for, and that physics."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from tests.learn.made_drives import made_drive, whole
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.config.schema import ModelSpec, VehicleSpec
from tunefree_hil.learn.evaluation.motion import MotionTrack, make_motion_track

REST = 0.15
TRUTH = {
    "drive_force_n": 5200.0,
    "brake_force_n_per_frac": 70000.0,
    "rolling_frac": 0.02,
    "front_stiffness_n_per_rad": 1.1e5,
}
ROOT = Path(__file__).resolve().parents[3]


@cache
def vehicle() -> VehicleSpec:
    return load_vehicle(ROOT / "dbc" / "mkz_bywire")


@cache
def physics() -> ModelSpec:
    """The nominal car: the physics that the hybrid starts from."""
    return load_model(ROOT / "bench_configs" / "models" / "mkz_nominal")


@cache
def track(seed: int, seconds: float = 40.0) -> MotionTrack:
    """A drive of the true car, whose constants are others."""
    return make_motion_track(whole(made_drive(seconds, seed=seed, params=TRUTH, name=f"made {seed}")), vehicle())
