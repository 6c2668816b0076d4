"""The table [require] of a bench file: limits that a set of gains must keep on every road."""

from __future__ import annotations

from msgspec.structs import fields

from tunefree_hil.config.problem import ConfigProblem, Problems
from tunefree_hil.config.vehicle_schema import Spec

MAY_BE_ZERO = ("replans",)  # a count; no drive keeps 0 of a measured quantity


class RequireSpec(Spec, frozen=True, kw_only=True):
    """Limits by name; None: the default of the vehicle; inf: not required."""

    lateral_error_peak_m: float | None = None
    lateral_error_rms_m: float | None = None
    heading_error_peak_rad: float | None = None
    station_error_peak_m: float | None = None
    speed_error_peak_mps: float | None = None
    lateral_jerk_peak_mps3: float | None = None
    accel_jerk_peak_mps3: float | None = None
    steer_rate_peak_radps: float | None = None
    steer_oscillation_rad: float | None = None
    accel_oscillation_mps2: float | None = None
    pedal_oscillation_frac: float | None = None
    speed_oscillation_mps: float | None = None
    pedal_alternation_per_s: float | None = None
    replans: float | None = None


REQUIREMENTS: tuple[str, ...] = tuple(field.name for field in fields(RequireSpec))

_AFTER_START = "after the first 3 s, against the original path"
_SWING = "largest swing that is sustained, peak to peak"
REQUIRE_WORDS: dict[str, str] = {
    "lateral_error_peak_m": f"largest lateral error {_AFTER_START}, m",
    "lateral_error_rms_m": f"RMS lateral error {_AFTER_START}, m",
    "heading_error_peak_rad": f"largest heading error {_AFTER_START}, rad",
    "station_error_peak_m": f"largest station error {_AFTER_START}, m",
    "speed_error_peak_mps": f"largest speed error {_AFTER_START}, m/s",
    "lateral_jerk_peak_mps3": "largest lateral jerk over 0.5 s beyond what the path asks for, m/s3",
    "accel_jerk_peak_mps3": "largest longitudinal jerk over 0.5 s beyond what the plan asks for, m/s3",
    "steer_rate_peak_radps": "largest rate of the steering wheel command over 0.1 s, rad/s",
    "steer_oscillation_rad": f"{_SWING}, of the steering wheel as at 13 m/s, rad",
    "accel_oscillation_mps2": f"{_SWING}, of the acceleration, m/s2",
    "pedal_oscillation_frac": f"{_SWING}, of throttle and brake, duty",
    "speed_oscillation_mps": f"{_SWING}, of the speed, m/s",
    "pedal_alternation_per_s": "how often throttle and brake take turns, 1/s",
    "replans": "re-plans of a drive",
}


def check_require(spec: RequireSpec) -> Problems:
    """Limits that a drive could keep: above 0; 0 for a count. inf switches a requirement off."""
    for name in REQUIREMENTS:
        limit = getattr(spec, name)
        if limit is None or limit > 0.0 or (limit == 0.0 and name in MAY_BE_ZERO):
            continue
        wanted = "0 or more" if name in MAY_BE_ZERO else "a limit above 0"
        yield ConfigProblem(
            f"require.{name}", f"{limit:g}: no drive can keep that", f"give {wanted}; inf: it is not required"
        )
