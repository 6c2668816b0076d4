"""Lateral LQR: published gains, steady cornering without error, signs, look-ahead, lead-lag."""

from __future__ import annotations

import math
import time

import pytest

from tunefree_hil.base.course import Tracking
from tunefree_hil.base.records import Ins, Measurement, Report
from tunefree_hil.control.contract import LeadLag, Settings, Setup, VehicleConstants
from tunefree_hil.control.follower import make_follower
from tunefree_hil.control.lateral import lqr
from tunefree_hil.control.parameters import BASELINES

MKZ = VehicleConstants()
SHIPPED_Q = (0.05, 0.0, 1.0, 0.0)
# docs/reference/apollo.md: speed, K of the shipped recursion, K converged, as printed.
PUBLISHED = [
    (1.0, (0.0517, 0.0003, 0.516, 0.0034), (0.2230, 0.0015, 1.223, 0.0082)),
    (2.0, (0.1074, 0.0014, 0.881, 0.0117), (0.2224, 0.0030, 1.225, 0.0163)),
    (4.0, (0.1741, 0.0046, 1.150, 0.0300), (0.2212, 0.0059, 1.237, 0.0321)),
    (8.0, (0.1637, 0.0086, 1.067, 0.0519), (0.1702, 0.0090, 1.086, 0.0527)),
    (12.0, (0.0952, 0.0075, 0.904, 0.0621), (0.0981, 0.0077, 0.917, 0.0630)),
    (20.0, (0.0681, 0.0087, 0.789, 0.0780), (0.0690, 0.0088, 0.798, 0.0790)),
]
DIGITS = (5.1e-5, 5.1e-5, 5.1e-4, 5.1e-5)  # half a unit of the last printed digit


def make(vehicle=MKZ, settings=None, **values):
    full = {**BASELINES["as_shipped"], **{key.replace("__", "."): value for key, value in values.items()}}
    return lqr.make(Setup(full, vehicle, None, settings or Settings(), 0.01))


def steer(block, speed_mps=5.0, **errors):
    fields = {
        "lateral_error_m": 0.0,
        "lateral_error_rate_mps": 0.0,
        "heading_error_rad": 0.0,
        "heading_error_rate_radps": 0.0,
        "ref_curvature_1pm": 0.0,
    }
    tracking = Tracking(**{**fields, **errors})
    measurement = Measurement(Report(speed_mps=speed_mps), Ins(speed_mps=speed_mps))
    return block.step(block.params, block.init(block.params, 0.01), (tracking, measurement), 0.01)[1]


def gains_at(speed_mps, *, shipped):
    return lqr.gain_rows((speed_mps,), SHIPPED_Q, MKZ, 0.01, shipped=shipped)[0]


@pytest.mark.parametrize(("speed", "shipped", "converged"), PUBLISHED)
def test_published_gains_in_both_modes(speed, shipped, converged):
    for expected, mode in ((shipped, True), (converged, False)):
        gains = gains_at(speed, shipped=mode)
        for got, printed, digit in zip(gains, expected, DIGITS, strict=True):
            assert abs(got - printed) <= digit


@pytest.mark.parametrize("mode", [0.0, 1.0])
def test_table_is_exact_at_nodes_and_close_between(mode):
    params = make(riccati=mode).params
    for speed in (1.0, 2.0, 4.0, 8.0, 12.0, 20.0):
        assert list(lqr.interpolate(params, speed)) == gains_at(speed, shipped=mode == 1.0)
    for low, high in zip(lqr.NODES_MPS, lqr.NODES_MPS[1:], strict=False):
        middle = 0.5 * (low + high)
        exact = gains_at(middle, shipped=mode == 1.0)
        between = lqr.interpolate(params, middle)
        assert abs(between.k1 - exact[0]) < 0.03 * exact[0]
        assert abs(between.k3 - exact[2]) < 0.03 * exact[2]
    assert lqr.interpolate(params, 90.0).k3 == params.k3[-1]
    assert lqr.interpolate(params, 0.0).k3 == params.k3[0]


def test_a_parameter_set_builds_fast():
    make()
    times = []
    for _ in range(3):
        began = time.perf_counter()
        make()
        times.append(time.perf_counter() - began)
    print(f"gain table: {1e3 * min(times):.1f} ms")  # the aim is 80 ms; timing never decides a test
    assert len(make().params.k1) == len(lqr.NODES_MPS)


def test_signs_left_of_the_path_steers_right():
    block = make(lqr__q2=0.05, lqr__q4=0.05)
    assert steer(block, lateral_error_m=0.1) < 0.0
    assert steer(block, lateral_error_rate_mps=0.1) < 0.0
    assert steer(block, heading_error_rad=0.1) < 0.0
    assert steer(block, heading_error_rate_radps=0.1) < 0.0
    assert steer(block, ref_curvature_1pm=0.05) > 0.0
    assert steer(block) == 0.0


def test_look_ahead_adds_to_both_errors():
    block, plain = make(look_ahead_m=1.4224), make()
    shifted = steer(plain, lateral_error_m=0.1 + 1.4224 * math.sin(0.05), heading_error_rad=0.05 - 0.02)
    ahead = steer(block, lateral_error_m=0.1, heading_error_rad=0.05, preview_heading_change_rad=0.02)
    assert ahead == pytest.approx(shifted, rel=1e-12)


def test_lead_lag_is_off_unless_asked_for_and_fades_below_3():
    plain, boosted = make(), make(settings=Settings(lead_lag=LeadLag(weight=1.0)))

    def boost(speed):
        return steer(boosted, speed, lateral_error_m=0.1) - steer(plain, speed, lateral_error_m=0.1)

    assert boost(1.0) == pytest.approx(-0.1 * 16.0)  # 1 rad of road wheel per metre
    assert boost(2.5) == pytest.approx(-0.05 * 16.0)
    assert boost(3.0) == boost(8.0) == 0.0


def test_ins_speed_stands_in_where_the_chassis_reports_none():
    block = lqr.make(Setup(BASELINES["as_shipped"], MKZ, None, Settings(), 0.01, frozenset({"report.speed_mps"})))
    tracking = Tracking(
        lateral_error_m=0.1,
        lateral_error_rate_mps=0.0,
        heading_error_rad=0.0,
        heading_error_rate_radps=0.0,
        ref_curvature_1pm=0.01,
    )
    seen = Measurement(Report(), Ins(speed_mps=5.0))
    _, wish = block.step(block.params, block.init(block.params, 0.01), (tracking, seen), 0.01)
    assert wish == steer(make(), lateral_error_m=0.1, ref_curvature_1pm=0.01)


class SingleTrack:
    """Linear single track at constant forward speed: side speed and yaw rate at the centre of mass, pose integrated."""

    def __init__(self, vehicle: VehicleConstants, speed_mps: float) -> None:
        self.vehicle, self.speed_mps = vehicle, speed_mps
        self.x_m, self.y_m, self.heading_rad = 0.0, 0.0, 0.0
        self.side_mps = self.yaw_radps = 0.0

    def ins(self) -> Ins:
        return Ins(self.x_m, self.y_m, self.heading_rad, self.speed_mps, 0.0, self.yaw_radps)

    def move(self, road_wheel_rad: float, dt_s: float, parts: int = 10) -> None:
        own, v = self.vehicle, self.speed_mps
        for _ in range(parts):
            step_s = dt_s / parts
            front_n = own.front_stiffness_n_per_rad * (
                road_wheel_rad - (self.side_mps + own.front_axle_m * self.yaw_radps) / v
            )
            rear_n = -own.rear_stiffness_n_per_rad * (self.side_mps - own.rear_axle_m * self.yaw_radps) / v
            self.side_mps += ((front_n + rear_n) / own.mass_kg - v * self.yaw_radps) * step_s
            turning_nm = own.front_axle_m * front_n - own.rear_axle_m * rear_n
            self.yaw_radps += turning_nm / own.yaw_inertia_kgm2 * step_s
            heading = self.heading_rad + 0.5 * self.yaw_radps * step_s
            rear_side_mps = self.side_mps - own.rear_axle_m * self.yaw_radps
            self.x_m += (v * math.cos(heading) - rear_side_mps * math.sin(heading)) * step_s
            self.y_m += (v * math.sin(heading) + rear_side_mps * math.cos(heading)) * step_s
            self.heading_rad += self.yaw_radps * step_s


UNDERSTEER = VehicleConstants(front_axle_m=1.2, front_stiffness_n_per_rad=9e4, rear_stiffness_n_per_rad=14e4)
OVERSTEER = VehicleConstants(front_axle_m=1.6, front_stiffness_n_per_rad=16e4, rear_stiffness_n_per_rad=15e4)


@pytest.mark.parametrize("vehicle", [MKZ, UNDERSTEER, OVERSTEER], ids=["neutral", "understeer", "oversteer"])
@pytest.mark.parametrize("speed", [4.0, 12.0])
@pytest.mark.parametrize("q2", [0.0, 0.1])
def test_no_lateral_error_in_steady_cornering(kit, vehicle, speed, q2):
    curvature = 2.0 / (speed * speed) if speed > 5.0 else 0.05
    course = kit.course(14.0, lambda t: speed, lambda station: curvature * min(1.0, max(0.0, (station - 5.0) / 10.0)))
    follower = make_follower(course, vehicle.rear_axle_m)
    block = make(vehicle, lqr__q2=q2)
    follow_state, state = follower.init(follower.params, 0.01), block.init(block.params, 0.01)
    car, worst = SingleTrack(vehicle, speed), 0.0
    for k in range(1300):  # the last metres of the path have the centre of mass beyond its end
        follow_state, tracking = follower.step(follower.params, follow_state, (k, car.ins()), 0.01)
        measurement = Measurement(Report(speed_mps=speed), car.ins())
        state, wish_rad = block.step(block.params, state, (tracking, measurement), 0.01)
        car.move(wish_rad / vehicle.steer_ratio, 0.01)
        worst = max(worst, abs(tracking.lateral_error_m)) if k > 1000 else 0.0
    assert tracking.ref_curvature_1pm == pytest.approx(curvature)
    assert worst < 0.004, f"{worst:.4f} m off in a steady bend"
