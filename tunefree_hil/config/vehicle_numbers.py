"""Ranges of the numeric keys of vehicle.toml's own tables.

The upper ends are far above any vehicle: they catch wrong units (percent for a share, milliseconds for seconds)
and numbers that would overflow where seconds are turned into ticks. Scale and period of a field are
checked in check_vehicle.py, and against the DBC in bus/dbc/check_vehicle.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from tunefree_hil.config.problem import ConfigProblem, Problems
from tunefree_hil.config.vehicle_schema import VehicleSpec


class Range(NamedTuple):
    """low <= value <= high; with `above` low itself is not allowed."""

    high: float
    meaning: str  # unit, or what the number is
    low: float = 0.0
    above: bool = False

    def slip(self, value: float) -> tuple[str, str] | None:
        """(what is wrong with the value, what to write instead), or None where it may stand."""
        hint = f"give a number {'above' if self.above else 'from'} {self.low:g} to {self.high:g} ({self.meaning})"
        if value < self.low or (self.above and value == self.low):
            return f"{value} is {'not above' if self.above else 'below'} {self.low:g}", hint
        return (f"{value} is above {self.high:g}", hint) if value > self.high else None


SHARE = Range(1.0, "a share of 1, not percent")
SOME_SHARE = Range(1.0, "a share of 1, not percent", above=True)
TIME_S = Range(60.0, "seconds")
# Table -> key -> range. In [latency] the keys are those of each actuator's table, 'top' is the top of the file.
RANGES: dict[str, dict[str, Range]] = {
    "top": {
        "bitrate": Range(2e7, "whole bit/s", above=True),
        "data_bitrate": Range(2e7, "whole bit/s", above=True),
        "tick_ms": Range(1e3, "whole milliseconds", above=True),
    },
    "ins_frame": {"latency_s": TIME_S},
    "latency": {"dead_time_s": TIME_S, "rise_time_s": TIME_S},
    "override": {
        "brake_frac": SHARE,
        "brake_s": TIME_S,
        "throttle_frac": SHARE,
        "throttle_s": TIME_S,
        "driver_frac": SHARE,
        "driver_s": TIME_S,
        "steer_nm": Range(1e4, "Nm at the steering wheel"),
        "steer_s": TIME_S,
    },
    "limits": {
        "steer_rad": Range(1e3, "rad at the steering wheel", above=True),
        "steer_rate_radps": Range(1e4, "rad/s at the steering wheel", above=True),
        "throttle_frac": SOME_SHARE,
        "brake_frac": SOME_SHARE,
        "lateral_accel_mps2": Range(1e3, "m/s2", above=True),
        "speed_mps": Range(1e3, "m/s", above=True),
        "reverse_mps": Range(1e3, "m/s, backwards counted positive"),
        "brake_rate_per_s": Range(1e6, "share of 1 a second; at 0 it would never brake", above=True),
        "watchdog_brake_frac": SHARE,
    },
    "nominal": {
        "mass_kg": Range(1e7, "kg", above=True),
        "wheelbase_m": Range(1e3, "m", above=True),
        "front_axle_m": Range(1e3, "m", above=True),
        "yaw_inertia_kgm2": Range(1e9, "kg m2", above=True),
        "steer_ratio": Range(1e3, "steering wheel angle per road wheel angle", above=True),
        "wheel_radius_m": Range(1e2, "m", above=True),
        "track_m": Range(1e3, "m", above=True),
        "front_stiffness_n_per_rad": Range(1e9, "N/rad, of the whole axle", above=True),
        "rear_stiffness_n_per_rad": Range(1e9, "N/rad, of the whole axle", above=True),
        "rest_pedal_frac": SHARE,
    },
}
MOST_ACCEL_MPS2 = 1e3
GLOBE_DEG = (90.0, 180.0)  # the largest latitude and longitude


class _Table(NamedTuple):
    """A table of vehicle.toml: what its keys are prefixed with, and their ranges."""

    prefix: str
    values: object
    ranges: dict[str, Range]


def check_numbers(spec: VehicleSpec) -> Problems:
    """Every number outside its range, or that contradicts another."""
    for table in _tables(spec):
        for name, allowed in table.ranges.items():
            value = getattr(table.values, name)
            slip = allowed.slip(value) if value is not None else None
            if slip:
                yield ConfigProblem(table.prefix + name, *slip)
    yield from _together(spec)
    low_high = spec.limits.accel_mps2
    if len(low_high) != 2 or not -MOST_ACCEL_MPS2 <= low_high[0] < 0.0 < low_high[1] <= MOST_ACCEL_MPS2:
        yield ConfigProblem(
            "limits.accel_mps2", f"expected [low, high] round 0, got {low_high}", "for example [-6.0, 2.0]"
        )
    origin = spec.ins_frame.origin
    if not isinstance(origin, str) and not _on_the_globe(origin):
        yield ConfigProblem("ins_frame.origin", f"{origin} is no [latitude, longitude]", 'give degrees, or "local"')


def _tables(spec: VehicleSpec) -> Iterator[_Table]:
    yield _Table("", spec, RANGES["top"])
    for name in ("ins_frame", "override", "limits", "nominal"):
        yield _Table(f"{name}.", getattr(spec, name), RANGES[name])
    for actuator, latency in spec.latency.items():
        yield _Table(f"latency.{actuator}.", latency, RANGES["latency"])


def _together(spec: VehicleSpec) -> Problems:
    """The numbers that must fit each other, where each could stand by itself."""
    wheelbase_m, front_m, rest = spec.nominal.wheelbase_m, spec.nominal.front_axle_m, spec.nominal.rest_pedal_frac
    if front_m is not None and wheelbase_m is not None and 0.0 < wheelbase_m <= front_m:
        message = f"{front_m:g} is not below wheelbase_m = {wheelbase_m:g}"
        yield ConfigProblem(
            "nominal.front_axle_m", message, "give the metres from the centre of mass to the front axle"
        )
    name = min(("throttle_frac", "brake_frac"), key=lambda name: getattr(spec.limits, name))
    limit = getattr(spec.limits, name)
    if 0.0 < limit <= rest <= 1.0:
        hint = "give the duty of a released pedal, below the limits of both pedals"
        yield ConfigProblem("nominal.rest_pedal_frac", f"{rest:g} is not below limits.{name} = {limit:g}", hint)


def _on_the_globe(origin: list[float]) -> bool:
    return len(origin) == 2 and all(abs(angle) <= most for angle, most in zip(origin, GLOBE_DEG, strict=True))
