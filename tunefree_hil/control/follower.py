"""The reference follower (docs/reference/grading.md): errors of the vehicle against the trajectory, and re-plans.

It runs in the controller at every tick and again wherever errors are computed from INS frames. Signs and points as
in docs/reference/files.md. Station always runs along the original path; the current trajectory is that path plus
the lateral and speed offsets of the last re-plan, so before the first re-plan both are the same.

The heading error's rate is yaw rate - kappa v_ref (docs/reference/apollo.md) with kappa at the projected point and
v_ref at this time, as for the columns of docs/reference/files.md; Apollo takes both at the projected point. Apollo uses
the nearest row of a table; here projections are continuous and times are interpolated between rows.

At the tick of a re-plan the errors are still against the old trajectory, which shows why it was re-planned; from the
next tick on they are against the new one.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.course import Course, Tracking
from tunefree_hil.base.kernel import Block, kernel
from tunefree_hil.base.maths import is_finite, wrap_rad
from tunefree_hil.base.records import NAN, Ins
from tunefree_hil.control.path import Path, ProjectedPoint, cell_of, heading_at, make_path, project
from tunefree_hil.control.schedule import (
    Blend,
    Schedule,
    lateral_blend,
    make_schedule,
    no_blend,
    plan_at,
    reference_at,
    row_at,
    station_at,
    time_of,
)

PREVIEW_S = 0.2  # docs/reference/apollo.md: preview window of 20 samples
MIN_ARC_SCALE = 0.01  # least 1 - kappa d in the speed along the path (docs/reference/apollo.md)
PREVIEW_SPEED_FLOOR_MPS = 0.1  # docs/reference/apollo.md
PREVIEW_COS_FLOOR = 0.1


class ReplanRules(NamedTuple):
    """Conditions and form of a re-plan (docs/reference/grading.md)."""

    lateral_m: float = 0.5
    station_m: float = 2.5
    blend_s: float = 3.0
    hold_off_s: float = 1.0
    blend_least_m: float = 6.0  # below 2 m/s: with less than half of full lock for an offset of 0.5 m


class FollowerParams(NamedTuple):
    """Tables and rules of a follower."""

    path: Path
    schedule: Schedule
    rules: ReplanRules
    rear_axle_m: float  # rear axle (INS point) to centre of mass
    look_ahead_m: float
    steer_preview_s: float = 0.0  # how much later the curvature for the steering feedforward is
    pedal_preview_s: float = PREVIEW_S  # the same of speed and acceleration for the pedals


class FollowerState(NamedTuple):
    """Cells of the last projections, and the current trajectory."""

    rear_cell: int
    mass_cell: int
    blend: Blend
    hold_until_s: float


class Lane(NamedTuple):
    """The current trajectory at the projection of the centre of mass, and the errors against it."""

    heading_rad: float
    curvature_1pm: float
    lateral_error_m: float
    heading_error_rad: float
    x_m: float
    y_m: float
    path_heading_error_rad: float


class PreviewTimes(NamedTuple):
    """How far ahead in time the reference is taken for the feedforward of the steering and of the pedals."""

    steer_s: float = 0.0
    pedal_s: float = PREVIEW_S


def make_follower(
    course: Course,
    rear_axle_m: float,
    look_ahead_m: float = 0.0,
    rules: ReplanRules | None = None,
    preview: PreviewTimes | None = None,
) -> Block:
    """Block: x = (tick, Ins) -> Tracking. An Ins with a number that is not finite gives a Tracking of NaN."""
    preview = preview or PreviewTimes()
    params = FollowerParams(
        make_path(course),
        make_schedule(course),
        rules or ReplanRules(),
        rear_axle_m,
        look_ahead_m,
        preview.steer_s,
        preview.pedal_s,
    )
    return Block(init, step, params)


def init(params: FollowerParams, dt_s: float) -> FollowerState:
    """At station 0, on the planned trajectory."""
    start = cell_of(params.path, 0.0)
    return FollowerState(start, start, no_blend(), 0.0)


@kernel
def step(params: FollowerParams, state: FollowerState, x: tuple[Any, Ins], dt_s: float) -> tuple[Any, Tracking]:
    """One tick: errors and previews, then a re-plan where it is due."""
    tick, ins = x
    if not is_finite(ins.x_m + ins.y_m + ins.heading_rad + ins.speed_mps):
        return state, undefined_tracking()
    time_s = tick * dt_s
    blend, rules, schedule = state.blend, params.rules, params.schedule
    cos, sin = math.cos(ins.heading_rad), math.sin(ins.heading_rad)
    mass_x_m = ins.x_m + params.rear_axle_m * cos
    mass_y_m = ins.y_m + params.rear_axle_m * sin
    rear_axle_projection = project(params.path, state.rear_cell, ins.x_m, ins.y_m)
    com_projection = project(params.path, state.mass_cell, mass_x_m, mass_y_m)
    lane = lane_at(blend, com_projection, mass_x_m, mass_y_m, ins.heading_rad)

    plan_s = time_s - blend.shift_s
    ref_speed_mps, ref_accel_mps2 = reference_at(schedule, blend, rules.blend_s, time_s)
    station_error_m = station_at(schedule, plan_s) + blend.station_m - rear_axle_projection.station_m
    path_speed_mps = speed_along(rear_axle_projection, ins)
    later_s = time_s + params.pedal_preview_s
    preview_speed_mps, preview_accel_mps2 = reference_at(schedule, blend, rules.blend_s, later_s)
    row, _ = row_at(schedule, plan_s)
    remaining_m = schedule.stop_station_m[row] + blend.station_m - rear_axle_projection.station_m
    turn_rad, ahead_1pm = look_ahead(params, blend, com_projection, lane, plan_s, ins.speed_mps)

    apart = abs(lane.lateral_error_m) > rules.lateral_m or abs(station_error_m) > rules.station_m
    replan = 0.0
    hold_until_s = state.hold_until_s
    if apart and time_s >= hold_until_s:
        replan = 1.0
        hold_until_s = time_s + rules.hold_off_s
        blend = anchor(params, com_projection, lane, rear_axle_projection.station_m, path_speed_mps, plan_s, time_s)
    blend = roll_on(schedule, blend, rules.blend_s, time_s, dt_s)

    tracking = Tracking(
        lane.x_m,
        lane.y_m,
        lane.heading_rad,
        ref_speed_mps,
        ref_accel_mps2,
        lane.curvature_1pm,
        station_error_m,
        ref_speed_mps - path_speed_mps,
        lane.lateral_error_m,
        ins.speed_mps * math.sin(lane.heading_error_rad),
        lane.heading_error_rad,
        ins.yaw_rate_radps - lane.curvature_1pm * ref_speed_mps,
        replan,
        preview_speed_mps,
        preview_accel_mps2,
        ahead_1pm,
        turn_rad,
        remaining_m,
        com_projection.lateral_m,
        lane.path_heading_error_rad,
    )
    return FollowerState(rear_axle_projection.cell, com_projection.cell, blend, hold_until_s), tracking


@kernel
def lane_at(blend: Blend, com_projection: ProjectedPoint, x_m: float, y_m: float, heading_rad: float) -> Lane:
    """The current trajectory beside the centre of mass. Errors: vehicle - reference, left positive."""
    path_heading_error_rad = wrap_rad(heading_rad - com_projection.heading_rad)
    offset_m, slope, bend_1pm = lateral_blend(blend, com_projection.station_m)
    lateral_m = com_projection.lateral_m - offset_m
    if offset_m == 0.0 and slope == 0.0 and bend_1pm == 0.0:
        ref_x_m, ref_y_m = x_m + lateral_m * com_projection.sin, y_m - lateral_m * com_projection.cos
        return Lane(
            com_projection.heading_rad,
            com_projection.curvature_1pm,
            lateral_m,
            path_heading_error_rad,
            ref_x_m,
            ref_y_m,
            path_heading_error_rad,
        )
    turn_rad, curvature_1pm = offset_curve(com_projection.curvature_1pm, offset_m, slope, bend_1pm)
    error_m = lateral_m * math.cos(turn_rad)
    heading = com_projection.heading_rad + turn_rad
    ref_x_m, ref_y_m = x_m + error_m * math.sin(heading), y_m - error_m * math.cos(heading)
    heading_error_rad = wrap_rad(path_heading_error_rad - turn_rad)
    return Lane(heading, curvature_1pm, error_m, heading_error_rad, ref_x_m, ref_y_m, path_heading_error_rad)


@kernel
def offset_curve(curvature_1pm: float, offset_m: float, slope: float, bend_1pm: float) -> tuple[float, float]:
    """(heading against the path, curvature) of a line at a varying offset from a path.

    The path's curvature is taken as constant over the blend: offset times its change is neglected.
    """
    arc_scale = max(1.0 - curvature_1pm * offset_m, MIN_ARC_SCALE)
    turn_rad = math.atan(slope / arc_scale)
    cos = math.cos(turn_rad)
    grown_1pm = (bend_1pm + curvature_1pm * slope * slope / arc_scale) * cos * cos / arc_scale
    return turn_rad, (grown_1pm + curvature_1pm) * cos / arc_scale


@kernel
def speed_along(rear_axle_projection: ProjectedPoint, ins: Ins) -> float:
    """Rate of the station: v cos(heading error) / (1 - kappa d) at the rear axle (docs/reference/apollo.md)."""
    arc_scale = max(1.0 - rear_axle_projection.curvature_1pm * rear_axle_projection.lateral_m, MIN_ARC_SCALE)
    return ins.speed_mps * math.cos(ins.heading_rad - rear_axle_projection.heading_rad) / arc_scale


@kernel
def look_ahead(
    params: FollowerParams, blend: Blend, com_projection: ProjectedPoint, lane: Lane, plan_s: float, speed_mps: float
) -> tuple[float, float]:
    """(heading change, curvature) of the trajectory at the look-ahead point (docs/reference/apollo.md).

    That point is the position of the plan in look_ahead / (max(|v|, 0.1) cos(heading error)) + steer_preview seconds.
    """
    if params.look_ahead_m == 0.0 and params.steer_preview_s == 0.0:
        return 0.0, lane.curvature_1pm
    pace_mps = abs(speed_mps)
    if pace_mps < PREVIEW_SPEED_FLOOR_MPS:
        pace_mps = PREVIEW_SPEED_FLOOR_MPS
    cos = math.cos(lane.heading_error_rad)
    if cos < PREVIEW_COS_FLOOR:
        cos = PREVIEW_COS_FLOOR
    later_s = plan_s + params.look_ahead_m / (pace_mps * cos) + params.steer_preview_s
    run_m = station_at(params.schedule, later_s) - station_at(params.schedule, plan_s)
    station_m = com_projection.station_m + run_m
    heading_rad, curvature_1pm = heading_at(params.path, station_m)
    offset_m, slope, bend_1pm = lateral_blend(blend, station_m)
    turn_rad, bent_1pm = offset_curve(curvature_1pm, offset_m, slope, bend_1pm)
    return heading_rad + turn_rad - lane.heading_rad, bent_1pm


@kernel
def anchor(
    params: FollowerParams,
    com_projection: ProjectedPoint,
    lane: Lane,
    station_m: float,
    speed_mps: float,
    plan_s: float,
    time_s: float,
) -> Blend:
    """A new trajectory from the measured pose and speed; the time of the plan is set to the vehicle's position."""
    schedule, rules = params.schedule, params.rules
    new_plan_s = time_of(schedule, plan_s, station_m)
    plan_speed_mps, _ = plan_at(schedule, new_plan_s)
    rolling_mps = speed_mps if speed_mps > 0.0 else 0.0
    length_m = rules.blend_s * rolling_mps
    if length_m < rules.blend_least_m:
        length_m = rules.blend_least_m
    arc_scale = max(1.0 - com_projection.curvature_1pm * com_projection.lateral_m, MIN_ARC_SCALE)
    cos = math.cos(lane.path_heading_error_rad)
    slope = 0.0  # across the path or backwards: only the offset
    if cos > PREVIEW_COS_FLOOR:
        slope = arc_scale * math.sin(lane.path_heading_error_rad) / cos
    return Blend(
        time_s - new_plan_s,
        time_s,
        rolling_mps - plan_speed_mps,
        station_m - station_at(schedule, new_plan_s),
        com_projection.station_m,
        length_m,
        com_projection.lateral_m,
        slope,
    )


@kernel
def roll_on(schedule: Schedule, blend: Blend, blend_s: float, time_s: float, dt_s: float) -> Blend:
    """The blend a tick later: the speed offset is integrated to the reference station."""
    if blend.speed_mps == 0.0 or time_s - blend.from_s >= blend_s:
        return blend
    plan_mps, _ = plan_at(schedule, time_s - blend.shift_s)
    reference_mps, _ = reference_at(schedule, blend, blend_s, time_s)
    return Blend(
        blend.shift_s,
        blend.from_s,
        blend.speed_mps,
        blend.station_m + (reference_mps - plan_mps) * dt_s,
        blend.from_station_m,
        blend.length_m,
        blend.lateral_m,
        blend.slope,
    )


@kernel
def undefined_tracking() -> Tracking:
    """A Tracking of NaN."""
    return Tracking(NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, 0.0, NAN, NAN, NAN, 0.0, NAN, NAN, NAN)
