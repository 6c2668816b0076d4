"""Checks that a vehicle.toml has all that a drive needs. A folder for reading logs may lack it."""

from __future__ import annotations

from pathlib import Path

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.problem import ConfigProblem, Problems
from tunefree_hil.config.schema import VehicleSpec

# Group -> fields, and their purpose. The controller commands pedals and a steering wheel angle, and follows
# the path by the INS.
FIELDS = {
    "command": (("throttle_frac", "brake_frac", "steer_rad"), "the controller commands it"),
    "ins": (("x_m", "y_m", "heading_rad", "speed_mps", "yaw_rate_radps"), "the controller follows the path by it"),
}
NOMINAL = (
    "mass_kg",
    "wheelbase_m",
    "front_axle_m",
    "yaw_inertia_kgm2",
    "steer_ratio",
    "front_stiffness_n_per_rad",
    "rear_stiffness_n_per_rad",
)


def check_drive(spec: VehicleSpec) -> list[InputError]:
    """Everything that is missing, each with key and hint; an empty list means that a bench can drive it."""
    file = str(Path(spec.folder) / "vehicle.toml")
    return [
        InputError(message, code="not_drivable", file=file, key=key, hint=hint)
        for key, message, hint in (*_fields(spec), *_nominal(spec))
    ]


def _fields(spec: VehicleSpec) -> Problems:
    for group, (names, purpose) in FIELDS.items():
        for name in names:
            if name not in getattr(spec, group):
                hint = f"map [{group}.{name}]; without it the folder is good for reading logs only"
                yield ConfigProblem(f"{group}.{name}", f"the vehicle does not have it, and {purpose}", hint)


def _nominal(spec: VehicleSpec) -> Problems:
    for name in NOMINAL:
        if getattr(spec.nominal, name) is None:
            yield ConfigProblem(
                f"nominal.{name}", "the controller needs this data-sheet value", "add it, and to `assumed` if it is"
            )
