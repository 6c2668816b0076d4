"""What sustains is found with its amplitude, frequency and place; what the road asks for or what dies out is not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tunefree_hil.grade.oscillation.detection import find_oscillations
from tunefree_hil.grade.oscillation.report import (
    CRITERIA,
    DrivePlace,
    OscillationFinding,
    OscillationReport,
    OscillationSignal,
    findings_as_data,
    oscillation_text,
)

DT_S = 0.01
RATIO, WHEELBASE_M, UNDERSTEER = 16.0, 2.8, 0.004
STEER = OscillationSignal.STEER_MEASURED
Columns = dict[str, Any]


def drive(at_mps: float = 18.0, **columns: Any) -> Columns:
    """A straight drive at constant speed, with these columns instead."""
    t = times()
    known: Columns = {name: np.zeros(len(t)) for name in ("ref_accel_mps2", "ref_curvature_1pm", "out_steer_rad")}
    known |= {"ref_speed_mps": np.full(len(t), at_mps), "speed_mps": np.full(len(t), at_mps)}
    return known | columns


def times() -> Any:
    """30 s."""
    return np.arange(3000) * DT_S


def sine(t: Any, frequency_hz: float, range_: float, phase: float = 0.0) -> Any:
    """Peak to peak `range_`."""
    return 0.5 * range_ * np.sin(2.0 * math.pi * frequency_hz * t + phase)


def found(columns: Columns, signal: OscillationSignal = STEER, **options: Any) -> OscillationFinding | None:
    report = find_oscillations(columns, DT_S, **options)
    return next((finding for finding in report.findings if finding.signal is signal), None)


def ratio(columns: Columns, signal: OscillationSignal = STEER) -> float:
    return find_oscillations(columns, DT_S).ratio_of(signal)


def slalom(t: Any, speed_mps: float, frequency_hz: float = 0.6, lateral_mps2: float = 3.0) -> Any:
    """Curvature of a slalom that begins on a straight."""
    return np.clip(t, 0.0, 1.0) * lateral_mps2 / speed_mps**2 * np.sin(2.0 * math.pi * frequency_hz * t)


def steered(curvature: Any, speed_mps: float, gain: float, dead_time_s: float, lag_s: float) -> Any:
    """The wheel of a car that follows with a gain error, a dead time and a lag."""
    late = round(dead_time_s / DT_S)
    asked = gain * RATIO * (WHEELBASE_M + UNDERSTEER * speed_mps**2) * np.concatenate([np.zeros(late), curvature])
    wheel, value = np.empty(len(curvature)), 0.0
    for k in range(len(curvature)):
        value += (asked[k] - value) * DT_S / lag_s
        wheel[k] = value
    return wheel


@given(
    st.floats(0.55, 4.5),
    st.floats(0.01, 3.0),
    st.floats(0.0, 6.0),
    st.sampled_from([*OscillationSignal][1:6]),
)
@settings(deadline=None, max_examples=40)
def test_a_sine_is_found(frequency_hz: float, range_: float, phase: float, signal: OscillationSignal) -> None:
    column = {
        OscillationSignal.STEER_MEASURED: "out_steer_rad",
        OscillationSignal.ACCEL: "accel_mps2",
        OscillationSignal.THROTTLE: "cmd_throttle_frac",
        OscillationSignal.BRAKE: "cmd_brake_frac",
        OscillationSignal.SPEED: "speed_mps",
    }[signal]
    offset = 18.0 if signal is OscillationSignal.SPEED else 0.2
    one = found(drive(**{column: offset + sine(times(), frequency_hz, range_, phase)}), signal)
    assert one is not None
    assert one.amplitude == pytest.approx(range_, rel=0.05)
    assert one.frequency_hz == pytest.approx(frequency_hz, rel=0.05)
    assert CRITERIA.start_s <= one.from_s < CRITERIA.start_s + 1.0 and one.to_s > 27.5
    assert one.place is DrivePlace.STRAIGHT and one.speed_mps == pytest.approx(18.0)


@pytest.mark.parametrize(("until_s", "is_found"), [(3.0, False), (9.0, True)])
def test_what_the_start_leaves_is_no_oscillation_and_what_goes_on_is(until_s: float, is_found: bool) -> None:
    t = times()
    one = found(drive(out_steer_rad=np.where(t < until_s, sine(t, 1.4, 0.5), 0.0)))
    assert (one is not None and one.amplitude > 0.4) == is_found


def test_a_part_of_the_drive_is_named() -> None:
    t = times()
    part = np.where((t > 8.0) & (t < 15.0), sine(t, 1.4, 0.5), 0.0)
    one = found(drive(out_steer_rad=part))
    assert one is not None and one.amplitude == pytest.approx(0.5, rel=0.1)
    assert one.from_s == pytest.approx(8.0, abs=0.7) and one.to_s == pytest.approx(15.0, abs=0.7)


@pytest.mark.parametrize("outside_hz", [0.1, 0.2, 12.0, 25.0])
def test_outside_of_the_band_is_none(outside_hz: float) -> None:
    assert ratio(drive(out_steer_rad=sine(times(), outside_hz, 1.0))) < 0.3


def test_a_slow_swing_does_not_hide_or_enlarge_a_fast_one() -> None:
    one = found(drive(out_steer_rad=sine(times(), 0.1, 6.0) + sine(times(), 1.5, 0.2)))
    assert one is not None and one.amplitude == pytest.approx(0.2, rel=0.1)
    assert one.frequency_hz == pytest.approx(1.5, rel=0.05)


@given(st.integers(0, 200))
@settings(deadline=None, max_examples=25)
def test_noise_is_none(seed: int) -> None:
    chance = np.random.default_rng(seed)
    noisy = drive(
        out_steer_rad=np.round(chance.normal(0.0, 0.009, 3000) / 0.0017) * 0.0017,
        accel_mps2=chance.normal(0.0, 0.1, 3000),
        cmd_throttle_frac=0.3 + chance.normal(0.0, 0.02, 3000),
        speed_mps=18.0 + chance.normal(0.0, 0.03, 3000),
    )
    assert find_oscillations(noisy, DT_S).worst_ratio < 0.7


@pytest.mark.parametrize("damping", [0.2, 0.3, 0.7])
def test_what_dies_out_is_none(damping: float) -> None:
    """A step of 20 deg of wheel (an offset that is steered out), which rings."""
    t = times()
    since = np.maximum(t - 5.0, 0.0)
    angular = 2.0 * math.pi
    wheel = np.where(t > 5.0, 0.35 * np.exp(-damping * angular * since) * np.cos(angular * since), 0.0)
    assert ratio(drive(out_steer_rad=wheel)) < 1.0
    steady = np.where(t > 5.0, 0.35 * np.cos(angular * since), 0.0)
    assert ratio(drive(out_steer_rad=steady)) > 10.0


@given(st.floats(0.3, 3.0), st.floats(0.05, 0.5), st.booleans())
@settings(deadline=None, max_examples=25)
def test_one_pulse_or_one_cycle_is_none(width_s: float, edge_s: float, goes_back: bool) -> None:
    """The high-pass makes six half cycles of a pulse of 2 s: the signal itself does not turn there."""
    turns_s = [0.0, 12.0, 12.0 + edge_s, 12.0 + edge_s + width_s, 12.0 + 2.0 * edge_s + width_s]
    heights = [0.0, 0.0, 1.0, 1.0, 0.0]
    if goes_back:
        turns_s += [turns_s[-1] + edge_s, turns_s[-1] + edge_s + width_s, turns_s[-1] + 2.0 * edge_s + width_s]
        heights += [-1.0, -1.0, 0.0]
    assert ratio(drive(out_steer_rad=5.0 * CRITERIA.steer_rad * np.interp(times(), turns_s, heights))) < 1.0


@given(st.floats(0.6, 3.0), st.floats(0.06, 1.0), st.floats(0.2, 5.0), st.floats(-0.2, 0.2))
@settings(deadline=None, max_examples=25)
def test_scale_and_shift(frequency_hz: float, range_: float, factor: float, offset: float) -> None:
    wheel = sine(times(), frequency_hz, range_)
    plain, scaled = ratio(drive(out_steer_rad=wheel)), ratio(drive(out_steer_rad=factor * wheel))
    assert scaled == pytest.approx(factor * plain, rel=1e-3)
    assert ratio(drive(out_steer_rad=wheel + offset)) == pytest.approx(plain, rel=1e-3)
    later = np.concatenate([np.zeros(137), wheel[:-137]])
    assert ratio(drive(out_steer_rad=later)) == pytest.approx(plain, rel=0.02)


@given(st.floats(0.7, 3.0), st.floats(0.05, 0.18), st.floats(6.0, 20.0))
@settings(deadline=None, max_examples=25)
def test_a_sine_beyond_the_limit_is_caught_on_a_smooth_drive(
    frequency_hz: float, slow_hz: float, speed_mps: float
) -> None:
    t = times()
    curvature = slalom(t, speed_mps, slow_hz, 1.0)
    wheel = steered(curvature, speed_mps, 1.2, 0.2, 0.2)
    smooth = drive(at_mps=speed_mps, ref_curvature_1pm=curvature, out_steer_rad=wheel)
    limit = CRITERIA.steer_rad * max(1.0, (CRITERIA.steer_speed_mps / speed_mps) ** 2)
    assert ratio(smooth) < 0.5
    assert ratio({**smooth, "out_steer_rad": wheel + sine(t, frequency_hz, 2.0 * limit)}) > 1.0


def test_an_uneven_swing_is_found() -> None:
    """0.5 Hz, 0.9 s to one side and 1.1 s to the other, as a wheel swings that runs to its stops."""
    t = times()
    wheel = np.interp(t % 2.0, [0.0, 0.9, 2.0], [-0.3, 0.3, -0.3])
    assert ratio(drive(out_steer_rad=wheel)) > 5.0


def test_two_cycles_are_enough_in_a_drive_that_ends_early() -> None:
    t = times()
    wheel = np.where(t > 1.0, sine(t, 0.7, 1.0), 0.0)
    early = {name: column[:430] for name, column in drive(out_steer_rad=wheel).items()}
    assert ratio(early) > 5.0
    dying = np.where(t > 1.0, wheel * np.exp(-2.0 * (t - 1.0)), 0.0)
    assert ratio({**early, "out_steer_rad": 0.3 * dying[:430]}) < 1.0
    two_cycles = np.where((t > 10.0) & (t < 12.5), sine(t - 10.0, 0.8, 1.0), 0.0)
    assert ratio(drive(out_steer_rad=two_cycles)) < 0.5


def test_a_short_drive_is_not_explained_by_a_manoeuvre_at_its_end() -> None:
    """The wheel swings by 200 deg from the beginning, the road begins to turn after 2 s, and the drive ends."""
    t = times()[:350]
    curvature = np.where(t > 2.0, -0.01 * np.sin(2.0 * math.pi * 0.15 * (t - 2.0)), 0.0)
    columns = {name: column[:350] for name, column in drive(at_mps=10.0).items()}
    assert ratio({**columns, "ref_curvature_1pm": curvature, "out_steer_rad": sine(t, 0.8, 3.5)}) > 5.0


def test_growth_is_found() -> None:
    t = times()
    wheel = np.where(t > 10.0, 0.02 * np.exp(0.15 * (t - 10.0)) * np.sin(2.0 * math.pi * 1.3 * t), 0.0)
    one = found(drive(out_steer_rad=wheel))
    assert one is not None and one.ratio > 5.0
    assert one.frequency_hz == pytest.approx(1.3, rel=0.05)
    assert one.to_s > 29.0


@pytest.mark.parametrize(("gain", "dead_time_s", "lag_s"), [(1.0, 0.1, 0.1), (1.4, 0.1, 0.3), (0.6, 0.3, 0.2)])
@pytest.mark.parametrize("speed_mps", [6.0, 12.0, 20.0])
def test_a_slalom_that_is_followed_is_none(speed_mps: float, gain: float, dead_time_s: float, lag_s: float) -> None:
    t = times()
    curvature = slalom(t, speed_mps)
    wheel = steered(curvature, speed_mps, gain, dead_time_s, lag_s)
    driven = drive(at_mps=speed_mps, ref_curvature_1pm=curvature, out_steer_rad=wheel)
    assert ratio(driven) < 0.5
    unexplained = {**driven, "ref_curvature_1pm": np.zeros(len(t))}
    assert speed_mps < 12.0 or ratio(unexplained) > 1.0, "the wheel does swing"


@pytest.mark.parametrize("speed_mps", [12.0, 20.0])
@pytest.mark.parametrize("frequency_hz", [0.9, 1.7])
def test_a_limit_cycle_in_a_slalom_is_found(speed_mps: float, frequency_hz: float) -> None:
    t = times()
    curvature = slalom(t, speed_mps)
    wheel = steered(curvature, speed_mps, 1.2, 0.2, 0.2) + sine(t, frequency_hz, 0.35)
    one = found(drive(at_mps=speed_mps, ref_curvature_1pm=curvature, out_steer_rad=wheel))
    assert one is not None and one.ratio > 1.5
    assert one.amplitude == pytest.approx(0.35, rel=0.25)
    assert one.frequency_hz == pytest.approx(frequency_hz, rel=0.05)
    assert one.place is DrivePlace.IN_TURN


def test_the_same_wheel_matters_more_at_speed() -> None:
    wheel = sine(times(), 1.2, 2.0 * CRITERIA.steer_rad)
    at = [ratio(drive(at_mps=speed, out_steer_rad=wheel)) for speed in (0.0, 6.0, 13.0, 30.0)]
    assert at[0] == pytest.approx(2.0 * CRITERIA.steer_rad / CRITERIA.max_steer_rad, rel=0.1)
    assert at[1] == pytest.approx(2.0 * (6.0 / 13.0) ** 2, rel=0.1)
    assert at[2] == pytest.approx(2.0, rel=0.1) and at[3] == pytest.approx(2.0, rel=0.1)


def test_at_rest_is_a_place() -> None:
    one = found(drive(at_mps=0.0, out_steer_rad=sine(times(), 2.0, 1.0)))
    assert one is not None and one.place is DrivePlace.AT_REST and one.ratio > 1.0


@given(st.floats(0.001, 1.0), st.floats(0.6, 4.0))
@settings(deadline=None, max_examples=25)
def test_the_ratio_is_continuous(range_: float, frequency_hz: float) -> None:
    chance = np.random.default_rng(1)
    wheel = sine(times(), frequency_hz, range_) + chance.normal(0.0, 0.01, 3000)
    before, after = ratio(drive(out_steer_rad=wheel)), ratio(drive(out_steer_rad=1.001 * wheel))
    assert after == pytest.approx(1.001 * before, rel=1e-3)


def pedals(t: Any, period_s: float) -> Columns:
    """Throttle and brake in turn, `period_s` for both, of 30 % above a rest of 15 %."""
    first = np.floor(2.0 * t / period_s) % 2.0 == 0.0
    return {"cmd_throttle_frac": np.where(first, 0.45, 0.15), "cmd_brake_frac": np.where(first, 0.15, 0.45)}


def test_alternating_pedals_are_found() -> None:
    t = times()
    signal = OscillationSignal.PEDAL_ALTERNATION
    one = found(drive(**pedals(t, 1.0)), signal, rest_pedal_frac=0.15)
    assert one is not None and one.amplitude == pytest.approx(2.0, rel=0.05)
    throttle = found(drive(**pedals(t, 1.0)), OscillationSignal.THROTTLE)
    assert throttle is not None and throttle.ratio > 2.0, "30 % of duty once a second"
    slow = found(drive(**pedals(t, 6.0)), signal, rest_pedal_frac=0.15)
    assert slow is not None and slow.ratio == pytest.approx(0.67, rel=0.05), "below its limit it has a value too"
    asked = np.where(np.floor(2.0 * t / 6.0) % 2.0 == 0.0, 1.0, -1.0)
    assert found(drive(ref_accel_mps2=asked, **pedals(t, 6.0)), signal, rest_pedal_frac=0.15) is None
    assert found(drive(**pedals(t, 1.0)), signal, rest_pedal_frac=0.44) is None, "both at rest"


def test_gaps_and_missing_columns() -> None:
    wheel = sine(times(), 1.3, 0.5)
    whole = found(drive(out_steer_rad=wheel))
    gappy = wheel.copy()
    gappy[:30] = np.nan
    gappy[700:703] = np.nan
    one = found(drive(out_steer_rad=gappy))
    assert whole is not None and one is not None and one.amplitude == pytest.approx(whole.amplitude, rel=0.05)
    assert found({"out_steer_rad": wheel}) is not None, "without any reference"
    assert find_oscillations({"x_m": wheel}, DT_S) == OscillationReport()
    assert find_oscillations({"out_steer_rad": wheel[:250]}, DT_S) == OscillationReport()
    assert find_oscillations({"out_steer_rad": np.full(3000, np.nan)}, DT_S) == OscillationReport()


@pytest.mark.parametrize("dt_s", [0.02, 0.01, 0.005])
def test_other_ticks(dt_s: float) -> None:
    t = np.arange(round(20.0 / dt_s)) * dt_s
    report = find_oscillations({"out_steer_rad": sine(t, 2.5, 0.4)}, dt_s)
    assert report.findings[0].amplitude == pytest.approx(0.4, rel=0.1)
    assert report.findings[0].frequency_hz == pytest.approx(2.5, rel=0.05)


def test_report() -> None:
    t = times()
    quiet = find_oscillations(drive(), DT_S)
    assert quiet.worst is None and quiet.worst_ratio == 0.0 and not quiet.is_oscillating
    shaking = find_oscillations(drive(out_steer_rad=sine(t, 1.7, 1.0), accel_mps2=sine(t, 1.0, 0.3)), DT_S)
    assert shaking.is_oscillating and shaking.worst is not None and shaking.worst.signal is STEER
    assert shaking.ratio_of(OscillationSignal.ACCEL) == pytest.approx(0.6, rel=0.1)
    plain = findings_as_data(shaking)
    assert [entry["signal"] for entry in plain] == ["steer_measured", "accel"]
    assert plain[0]["place"] == "straight" and plain[0]["ratio"] == shaking.worst_ratio


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, "steering wheel swings 58 deg at 1.7 Hz from 3.2 to 14.0 s, straight, at 18 m/s"),
        ({"place": DrivePlace.AT_REST}, "steering wheel swings 58 deg at 1.7 Hz from 3.2 to 14.0 s, at rest"),
        (
            {"signal": OscillationSignal.THROTTLE, "amplitude": 0.5, "place": DrivePlace.IN_TURN},
            "throttle swings 50 % duty at 1.7 Hz from 3.2 to 14.0 s, in a turn, at 18 m/s",
        ),
        (
            {"signal": OscillationSignal.PEDAL_ALTERNATION, "amplitude": 2.6},
            "throttle and brake alternate 2.6 times a second from 3.2 to 14.0 s, straight, at 18 m/s",
        ),
        (
            {"amplitude": math.radians(123.4)},
            "steering wheel swings 123 deg at 1.7 Hz from 3.2 to 14.0 s, straight, at 18 m/s",
        ),
    ],
)
def test_text(changes: Any, text: str) -> None:
    one = OscillationFinding(STEER, math.radians(58.0), 0.05, "rad", 1.7, 3.2, 14.0, DrivePlace.STRAIGHT, 18.0)
    assert oscillation_text(one._replace(**changes)) == text


def test_a_swing_of_the_explanation_alone_is_no_oscillation() -> None:
    """A plan that brakes in short steps, and a throttle that is closed meanwhile and opened once afterwards."""
    t = times()
    accel = np.where((t > 5.0) & (t < 8.0), -0.8 - 0.7 * np.sign(np.sin(2.0 * math.pi * t)), 0.0)
    throttle = np.where(t < 5.0, 0.9, np.where(t < 8.0, 0.0, 0.35 + 0.3 * np.exp(-((t - 8.7) ** 2) / 0.2)))
    one = found(drive(cmd_throttle_frac=throttle, ref_accel_mps2=accel), OscillationSignal.THROTTLE)
    assert one is None or one.ratio < 0.5
