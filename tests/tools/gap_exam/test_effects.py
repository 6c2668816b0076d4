"""Every hidden effect is the identity where it is neutral, and has the size that its parameter says where it is not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.tools.gap_exam.drives_for_tests import TICK_S, hidden, runs, same_commands, shifted, softened, vehicle
from tools.gap_exam import catalogue, channels
from tools.gap_exam.catalogue import EFFECTS, OUTSIDE, kind_of
from tools.gap_exam.hidden import NOTHING, Hidden, hidden_of
from tools.gap_exam.simulate import (
    BRAKE_OUT,
    STEER_ECHO,
    STEER_OUT,
    THROTTLE_OUT,
)

pytestmark = pytest.mark.slow
OUTPUT = {"steer": STEER_OUT, "throttle": THROTTLE_OUT, "brake": BRAKE_OUT}
# Names and parameters as the workflow's catalogue has them
PARAMETERS = """steer_dead_time delay_s; steer_lag tau_s; steer_rate_limit rate_radps; steer_dead_band half_width_rad;
steer_friction level_rad; steer_saturation limit_rad; steer_gain gain_frac; steer_offset offset_rad;
steer_backlash width_rad;
throttle_dead_time delay_s; throttle_lag tau_s; throttle_rate_limit rate_per_s; throttle_dead_band half_width_frac;
throttle_gain gain_frac; powertrain_lag tau_s; power_limit power_w; brake_dead_time delay_s; brake_lag tau_s;
brake_dead_band half_width_frac; brake_gain gain_frac; brake_pressure_lag tau_s; brake_fade loss_per_mj;
brake_drag force_n;
payload mass_kg; front_stiffness gain_frac; rear_stiffness gain_frac; friction friction_frac; tyre_relaxation length_m;
rolling_resistance extra_frac; aero_drag drag_area_m2; grade grade_rad; head_wind wind_mps; side_wind force_n;
road_bank bank_rad; speed_scale scale_frac; yaw_rate_bias bias_radps; yaw_rate_scale scale_frac; yaw_rate_filter tau_s;
accel_bias bias_mps2; steer_report_offset offset_rad; report_latency delay_s; ins_latency delay_s"""


# --- the catalogue -----------------------------------------------------------------------------------------------


def test_names_and_parameters() -> None:
    wanted = dict(one.split() for one in PARAMETERS.split(";"))
    assert {name: kind.parameter for name, kind in EFFECTS.items()} == wanted and len(wanted) == 42
    assert len(OUTSIDE) == 8 and not OUTSIDE.keys() & EFFECTS.keys()


@pytest.mark.parametrize("name", [*EFFECTS, *OUTSIDE])
def test_neutral_is_the_identity(name: str) -> None:
    """Of the record that the loop reads, so of every number of the drive; sizes are on the right side of it."""
    neutral = catalogue.neutral(name)
    assert hidden_of({name: {kind_of(name).parameter: neutral}}) == NOTHING
    for size in (0.0, 0.5, 1.0):
        assert catalogue.value(name, size) != neutral
    assert catalogue.departure(name, catalogue.value(name, 0.9)) > 0.0


@pytest.mark.parametrize("name", [*EFFECTS, *OUTSIDE])
def test_something_changes_and_nothing_breaks(name: str) -> None:
    """Gross effects on the same commands: other numbers, and all of them finite."""
    params = {kind_of(name).parameter: catalogue.value(name, 0.9)}
    if kind_of(name).second:
        params[kind_of(name).second] = kind_of(name).second_range[0]
    if name == "frame_loss":
        return  # on its way to the unit: test_cases.py
    without, with_it = same_commands({name: params})
    assert np.isfinite(with_it.reports).all()
    assert np.abs(with_it.reports - without.reports).max() > 1e-4


# --- inside the actuators: between command and report -------------------------------------------------------------


@pytest.mark.parametrize("channel", OUTPUT)
@pytest.mark.parametrize("delay_s", [0.043, 0.2])
def test_dead_time(channel: str, delay_s: float) -> None:
    without, with_it = runs(**{f"{channel}_dead_time": delay_s})
    out = OUTPUT[channel]
    size = np.abs(without[:, out]).max()
    assert np.abs(with_it[:, out] - shifted(without[:, out], delay_s)).max() < 0.04 * size
    candidates = np.arange(0.0, 0.4, 0.001)
    off = [np.abs(with_it[:, out] - shifted(without[:, out], one)).mean() for one in candidates]
    assert abs(candidates[int(np.argmin(off))] - delay_s) < 0.003


@pytest.mark.parametrize("channel", OUTPUT)
def test_lag(channel: str) -> None:
    without, with_it = runs(**{f"{channel}_lag": 0.15})
    out = OUTPUT[channel]
    assert np.abs(with_it[:, out] - softened(without[:, out], 0.15)).max() < 0.02 * np.abs(without[:, out]).max()


@pytest.mark.parametrize(("name", "rate"), [("steer_rate_limit", 1.3), ("throttle_rate_limit", 0.3)])
def test_rate_limit(name: str, rate: float) -> None:
    _, with_it = runs(**{name: rate})
    steps = np.abs(np.diff(with_it[:, OUTPUT[name.split("_")[0]]])) / TICK_S
    assert steps.max() == pytest.approx(rate, rel=1e-3)


def test_saturation() -> None:
    without, with_it = runs(steer_saturation=0.6)
    assert np.abs(without[:, STEER_OUT]).max() > 1.0
    assert np.abs(with_it[:, STEER_OUT]).max() == pytest.approx(0.6)
    inside = np.abs(without[:, STEER_OUT]) < 0.6
    assert np.abs(with_it - without)[inside][:, STEER_OUT].max() < 1e-9


def test_steer_dead_band() -> None:
    """Where the command rests, the output is that much less, or nothing."""
    _, with_it = runs(steer_dead_band=0.1)
    echo, out = with_it[:, STEER_ECHO], with_it[:, STEER_OUT]
    rests = [k for k in range(120, len(echo)) if np.ptp(echo[k - 100 : k + 1]) < 1e-3]
    assert len(rests) > 20
    wanted = np.sign(echo[rests]) * np.maximum(np.abs(echo[rests]) - 0.1, 0.0)
    assert np.abs(out[rests] - wanted).max() < 4e-3


def test_steer_friction() -> None:
    """The positioner stands still until it is asked for more than the level, and then trails by it."""
    place, ups, downs = 0.0, [], []
    for wanted in np.concatenate([np.linspace(0, 1, 4000), np.linspace(1, -1, 8000), np.linspace(-1, 1, 8000)]):
        was, place = place, channels.stuck(place, wanted, 0.08)
        (ups if place > was else downs).append(wanted - place)
    assert np.median(ups) == pytest.approx(0.08, abs=2e-3)
    assert np.percentile(downs, 5) == pytest.approx(-0.08, abs=2e-3)
    without, with_it = runs(steer_friction=0.08)
    still = [np.mean(np.abs(np.diff(one[:, STEER_OUT])) < 1e-7) for one in (without, with_it)]
    assert still[1] > still[0] + 0.1


# --- behind the report ---------------------------------------------------------------------------------------------


BEHIND = """steer_gain steer_offset steer_backlash throttle_gain throttle_dead_band powertrain_lag brake_gain
brake_dead_band brake_pressure_lag brake_fade payload grade"""


@pytest.mark.parametrize("name", BEHIND.split())
def test_behind_the_report_no_report_of_an_actuator_shows_it(name: str) -> None:
    without, with_it = runs(**{name: catalogue.value(name, 0.8)})
    outs = [THROTTLE_OUT, BRAKE_OUT, STEER_OUT]
    assert np.array_equal(without[:, outs], with_it[:, outs])


def road_wheel(h: Hidden, angles: np.ndarray, speed: float = 8.0) -> np.ndarray:
    """Steering-wheel angle that the front wheels feel."""
    car, m, felt = vehicle().car, np.zeros(channels.SIZE), []
    for angle in angles:
        m[channels.STEER_OUT] = angle
        felt.append(channels.road_wheel(car, h, m, speed) * car.steer_ratio)
    return np.array(felt)


def test_steer_gain_offset_backlash() -> None:
    there = np.linspace(-1.0, 1.0, 201)
    assert np.allclose(road_wheel(hidden(steer_gain=1.2), there), 1.2 * there)
    assert np.allclose(road_wheel(hidden(steer_offset=-0.1), there), there - 0.1)
    loop = road_wheel(hidden(steer_backlash=0.3), np.concatenate([there, there[::-1], there]))
    up, down = loop[402:], loop[201:402][::-1]
    assert np.allclose((down - up)[31:-31], 0.3, atol=1e-9), "the loop is as wide as all of the play"


def push_n(h: Hidden, duty: float, speed: float, steps: int = 1) -> float:
    """Driving force without creep after some steps at a reported throttle."""
    m = np.zeros(channels.SIZE)
    m[channels.THROTTLE_OUT] = duty
    force = 0.0
    for _ in range(steps):
        force = channels.drive_n(vehicle().car, h, m, speed)
    return force


def test_throttle_behind_the_report() -> None:
    assert push_n(hidden(throttle_gain=0.8), 0.25, 6.0) == pytest.approx(push_n(NOTHING, 0.2, 6.0))
    assert push_n(hidden(throttle_dead_band=0.05), 0.25, 6.0) == pytest.approx(push_n(NOTHING, 0.2, 6.0))
    assert push_n(hidden(throttle_dead_band=0.05), 0.04, 6.0) == 0.0
    assert push_n(hidden(powertrain_lag=0.4), 0.25, 6.0, 400) == pytest.approx(
        (1.0 - math.exp(-1.0)) * push_n(NOTHING, 0.25, 6.0)
    )
    assert push_n(hidden(power_limit=9e3), 0.4, 10.0) == pytest.approx(900.0)
    assert push_n(hidden(power_limit=9e3), 0.05, 4.0) == pytest.approx(push_n(NOTHING, 0.05, 4.0))


def hold_n(h: Hidden, duty: float, steps: int = 1, braked_mj: float = 0.0) -> float:
    """Braking force after some steps at a reported duty above rest."""
    m = np.zeros(channels.SIZE)
    m[channels.BRAKE_OUT], m[channels.BRAKED_J] = duty, 1e6 * braked_mj
    force = 0.0
    for _ in range(steps):
        force = channels.brake_n(vehicle().car, h, m, 0.0, 1500.0)
    return force


def test_brake_behind_the_report() -> None:
    assert hold_n(hidden(brake_gain=0.7), 0.1) == pytest.approx(0.7 * hold_n(NOTHING, 0.1))
    assert hold_n(hidden(brake_dead_band=0.02), 0.1) == pytest.approx(hold_n(NOTHING, 0.08))
    assert hold_n(hidden(brake_dead_band=0.02), 0.015) == 0.0
    share = 1.0 - math.exp(-1.0)
    assert hold_n(hidden(brake_pressure_lag=0.3), 0.1, 300) == pytest.approx(share * hold_n(NOTHING, 0.1))
    assert hold_n(hidden(brake_drag=300.0), 0.1) == pytest.approx(300.0 + hold_n(NOTHING, 0.1))
    assert hold_n(hidden(brake_fade=0.2), 0.1, braked_mj=1.5) == pytest.approx(0.7 * hold_n(NOTHING, 0.1))
    assert hold_n(hidden(brake_fade=0.2), 0.1, braked_mj=9.0) == pytest.approx(0.3 * hold_n(NOTHING, 0.1)), "the floor"


def test_heat_of_the_brakes_is_force_times_way() -> None:
    m = np.zeros(channels.SIZE)
    m[channels.BRAKE_OUT] = 0.1
    for _ in range(1000):
        force = channels.brake_n(vehicle().car, NOTHING, m, 12.0, 1500.0)
    assert m[channels.BRAKED_J] == pytest.approx(force * 12.0)
