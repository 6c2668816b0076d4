"""A scenario as tables: the plan by time, and the path by station. Built by episode/scenario.py."""

from __future__ import annotations

from typing import Any, NamedTuple

from tunefree_hil.base.records import NAN, Disturbance


class Course(NamedTuple):
    """The planned drive. All tables are made by `base.kernel.table`.

    By time, row k at k * dt_s, `ticks + 1` rows (look-ups beyond the end use the last row):
    station_m (path length driven), speed_mps, accel_mps2, and the road: grade_rad, friction_frac, bank_rad (left
    side up), side_wind_mps2 (force over the vehicle's mass, to the left).
    By station, row i at first_station_m + i * spacing_m: the path itself, extended straight at both ends so
    that every point of the vehicle has a projection. Station 0 is the position of the rear axle at t = 0.
    """

    dt_s: float
    ticks: int
    station_m: Any
    speed_mps: Any
    accel_mps2: Any
    grade_rad: Any
    friction_frac: Any
    bank_rad: Any
    side_wind_mps2: Any
    first_station_m: float
    spacing_m: float
    path_x_m: Any
    path_y_m: Any
    path_heading_rad: Any  # continuous, not wrapped
    path_curvature_1pm: Any

    def road_at(self, tick: int) -> Disturbance:
        """The road under the vehicle at a tick."""
        return Disturbance(
            float(self.grade_rad[tick]),
            float(self.friction_frac[tick]),
            float(self.bank_rad[tick]),
            float(self.side_wind_mps2[tick]),
        )


class Start(NamedTuple):
    """Start of the vehicle at tick 0: centre of the rear axle, rolling at speed_mps in drive gear."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    speed_mps: float = 0.0


class Tracking(NamedTuple):
    """Output of the reference follower at one tick; the columns of the same names in docs/reference/files.md.

    ref_x/y/heading/curvature: the point of the current trajectory nearest to the centre of mass. ref_speed/accel: the
    current trajectory at this time. Lateral and heading error: vehicle - reference, at the centre of mass, left
    positive. Station and speed error: reference - vehicle, at the rear axle, positive = behind. `path_*`: the same
    errors against the original path, independent of re-plans.
    """

    ref_x_m: float = NAN
    ref_y_m: float = NAN
    ref_heading_rad: float = NAN
    ref_speed_mps: float = NAN
    ref_accel_mps2: float = NAN
    ref_curvature_1pm: float = NAN
    station_error_m: float = NAN
    speed_error_mps: float = NAN
    lateral_error_m: float = NAN
    lateral_error_rate_mps: float = NAN
    heading_error_rad: float = NAN
    heading_error_rate_radps: float = NAN
    replan: float = 0.0  # 1 at the tick at which the trajectory was re-anchored
    preview_speed_mps: float = NAN
    preview_accel_mps2: float = NAN
    preview_curvature_1pm: float = NAN  # at the look-ahead point
    preview_heading_change_rad: float = 0.0  # heading of the look-ahead point minus heading of the nearest point
    path_remaining_m: float = NAN
    path_lateral_error_m: float = NAN
    path_heading_error_rad: float = NAN
