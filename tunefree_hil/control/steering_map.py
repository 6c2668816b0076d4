"""The steering map: steady wheel angle and steady heading error over speed and curvature.

In steady cornering with curvature kappa and lateral acceleration a = v^2 kappa

    wheel angle    = offset + dead zone + ratio (length kappa + length_3 kappa^3 + understeer a + understeer_3 a^3)
    heading error  = -rear axle distance kappa + rear slip a            (at the centre of mass; minus its side-slip)

The linear terms are those of the single-track model (Rajamani, Vehicle Dynamics and Control, 2nd ed., 3.1: wheelbase
and understeer gradient); the cubic ones are linkage and full lock (length_3) and the tyres' saturation (understeer_3).
Beyond the curvature and the lateral acceleration that the data covered, the map goes on with its slope there.
"""

from __future__ import annotations

from typing import NamedTuple

from tunefree_hil.base.kernel import kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.control.contract import VehicleConstants

GEOMETRY_BOUND_1PM = 0.2  # a radius of 5 m, beyond which the third order is not enough
SPAN_PER_DEAD_ZONE = 2.0  # the dead zone is made up for over this many of its own half widths, not in a step


class SteeringMap(NamedTuple):
    """Coefficients of the map. Wheel angles are of the steering wheel, left positive.

    Args:
        steer_ratio: steering-wheel angle over road-wheel angle.
        offset_rad: wheel angle with which the vehicle drives straight on.
        dead_zone_rad: half width of the wheel angles that do not turn the vehicle.
        length_m: road-wheel angle per curvature at standstill.
        length_cubic_m3: its growth with curvature squared.
        understeer_s2pm: road-wheel angle per lateral acceleration.
        understeer_cubic_s6pm3: its growth with lateral acceleration squared.
        rear_axle_m: heading error per curvature at standstill, sign changed: centre of mass to rear axle.
        rear_slip_s2pm: heading error per lateral acceleration.
        curvature_bound_1pm, lateral_accel_bound_mps2: what the data covered.
    """

    steer_ratio: float
    offset_rad: float
    dead_zone_rad: float
    length_m: float
    length_cubic_m3: float
    understeer_s2pm: float
    understeer_cubic_s6pm3: float
    rear_axle_m: float
    rear_slip_s2pm: float
    curvature_bound_1pm: float
    lateral_accel_bound_mps2: float


def data_sheet_map(vehicle: VehicleConstants) -> SteeringMap:
    """The map of the data sheet's wheelbase and axle stiffness (eq. 3 of the paper): linear, without offset."""
    length_m = vehicle.wheelbase_m
    rear_slip = vehicle.front_axle_m * vehicle.mass_kg / (vehicle.rear_stiffness_n_per_rad * length_m)
    front_slip = vehicle.rear_axle_m * vehicle.mass_kg / (vehicle.front_stiffness_n_per_rad * length_m)
    return SteeringMap(
        steer_ratio=vehicle.steer_ratio,
        offset_rad=0.0,
        dead_zone_rad=0.0,
        length_m=length_m,
        length_cubic_m3=0.0,
        understeer_s2pm=front_slip - rear_slip,
        understeer_cubic_s6pm3=0.0,
        rear_axle_m=vehicle.rear_axle_m,
        rear_slip_s2pm=rear_slip,
        curvature_bound_1pm=0.0,
        lateral_accel_bound_mps2=0.0,
    )


def with_geometry(steering: SteeringMap) -> SteeringMap:
    """The map with the cubic term of a wheel that turns about its axle: tan(angle) = L / sqrt(R^2 - lr^2).

    To third order in curvature that is L kappa + (L lr^2 / 2 - L^3 / 3) kappa^3; within 1 % up to a radius of 5 m.
    """
    length_m, rear_m = steering.length_m, steering.rear_axle_m
    cubic = 0.5 * length_m * rear_m * rear_m - length_m * length_m * length_m / 3.0
    return steering._replace(length_cubic_m3=cubic, curvature_bound_1pm=GEOMETRY_BOUND_1PM)


def stiffness_of(steering: SteeringMap, vehicle: VehicleConstants) -> tuple[float, float]:
    """(front, rear) axle stiffness in N/rad of the single-track model which has this map's linear terms.

    The data sheet's where the map gives no positive stiffness (a rear axle that steers with the front one).
    """
    rear_slip, front_slip = steering.rear_slip_s2pm, steering.rear_slip_s2pm + steering.understeer_s2pm
    if rear_slip <= 0.0 or front_slip <= 0.0:
        return vehicle.front_stiffness_n_per_rad, vehicle.rear_stiffness_n_per_rad
    load = vehicle.mass_kg / vehicle.wheelbase_m
    return vehicle.rear_axle_m * load / front_slip, vehicle.front_axle_m * load / rear_slip


@kernel
def odd_cubic(x: float, slope: float, cubic: float, bound: float) -> float:
    """slope x + cubic x^3 up to |x| = bound, then straight on with the slope there."""
    inside = clamp(x, -bound, bound)
    square = inside * inside
    return inside * (slope + cubic * square) + (x - inside) * (slope + 3.0 * cubic * square)


@kernel
def steady_road_wheel_rad(steering: SteeringMap, speed_mps: float, curvature_1pm: float) -> float:
    """Road-wheel angle of steady cornering, without offset and dead zone."""
    turning = odd_cubic(curvature_1pm, steering.length_m, steering.length_cubic_m3, steering.curvature_bound_1pm)
    return turning + steady_slip_rad(steering, speed_mps * speed_mps * curvature_1pm)


@kernel
def steady_slip_rad(steering: SteeringMap, lateral_accel_mps2: float) -> float:
    """The share of the road-wheel angle that understeer asks for; negative with oversteer."""
    return odd_cubic(
        lateral_accel_mps2, steering.understeer_s2pm, steering.understeer_cubic_s6pm3, steering.lateral_accel_bound_mps2
    )


@kernel
def wheel_rad(steering: SteeringMap, road_wheel_rad: float) -> float:
    """Steering-wheel angle for a wanted road-wheel angle: ratio, dead zone and offset."""
    angle_rad = road_wheel_rad * steering.steer_ratio
    zone_rad = steering.dead_zone_rad
    if zone_rad > 0.0:
        angle_rad += zone_rad * clamp(angle_rad / (SPAN_PER_DEAD_ZONE * zone_rad), -1.0, 1.0)
    return angle_rad + steering.offset_rad
