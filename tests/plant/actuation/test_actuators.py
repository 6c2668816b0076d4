"""Step responses against their closed forms, and what an actuator never does."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.plant.drives import DT_S
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import run
from tunefree_hil.base.records import Command
from tunefree_hil.plant.actuation.actuators import ActuatorParams, actuator, actuators

STEP = [1.0] * 100


def response(params: ActuatorParams, inputs: list[float] = STEP) -> list[float]:
    """Output at the end of each tick."""
    return run(actuator(params), inputs, DT_S)


@pytest.mark.parametrize("dead_time_s", [0.0, 0.02, 0.1, 0.003, 0.0372])
def test_first_order_step_is_exact(dead_time_s: float) -> None:
    outputs = response(ActuatorParams(dead_time_s=dead_time_s, lag_s=0.08))
    for k, output in enumerate(outputs, start=1):
        since_s = k * DT_S - dead_time_s
        wanted = 1.0 - math.exp(-since_s / 0.08) if since_s > 0.0 else 0.0
        assert output == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize("damping", [0.4, 1.0, 1.7])
@pytest.mark.parametrize("dead_time_s", [0.0, 0.0372])
def test_second_order_step_is_exact(damping: float, dead_time_s: float) -> None:
    natural = 2.0 * math.pi * 3.0
    outputs = response(ActuatorParams(dead_time_s=dead_time_s, order=2, natural_hz=3.0, damping=damping))
    for k, output in enumerate(outputs, start=1):
        t = max(k * DT_S - dead_time_s, 0.0)
        if damping < 1.0:
            ring = natural * math.sqrt(1.0 - damping**2)
            fade = math.exp(-damping * natural * t)
            wanted = 1.0 - fade * (math.cos(ring * t) + damping * natural / ring * math.sin(ring * t))
        elif damping == 1.0:
            wanted = 1.0 - math.exp(-natural * t) * (1.0 + natural * t)
        else:
            slow, fast = (natural * (damping - s * math.sqrt(damping**2 - 1.0)) for s in (1.0, -1.0))
            wanted = 1.0 - (fast * math.exp(-slow * t) - slow * math.exp(-fast * t)) / (fast - slow)
        assert output == pytest.approx(wanted, abs=1e-9)


def test_dead_time_without_lag_is_a_shift() -> None:
    inputs = [float(k) for k in range(50)]
    whole = response(ActuatorParams(dead_time_s=0.05), inputs)
    assert whole[5:] == pytest.approx(inputs[:-5], abs=1e-12)
    part = response(ActuatorParams(dead_time_s=0.053), inputs)
    assert part[10] == pytest.approx(0.7 * 5.0 + 0.3 * 4.0)


def test_rate_limit_is_a_straight_line() -> None:
    outputs = response(ActuatorParams(lag_s=0.01, rate_limit=2.0))
    assert outputs[:40] == pytest.approx([0.02 * k for k in range(1, 41)])
    second = response(ActuatorParams(order=2, natural_hz=8.0, damping=1.0, rate_limit=2.0))
    steps = [later - sooner for sooner, later in itertools.pairwise(second)]
    assert max(steps) == pytest.approx(0.02) and second[-1] == pytest.approx(1.0, abs=0.05)


def test_dead_band_gain_and_offset_act_about_rest() -> None:
    params = ActuatorParams(dead_band=0.02, gain=2.0, offset=0.01, rest=0.15, initial=0.15)
    settled = {command: response(params, [command] * 3)[-1] for command in (0.15, 0.16, 0.25, 0.05)}
    assert settled == pytest.approx({0.15: 0.16, 0.16: 0.16, 0.25: 0.32, 0.05: 0.0})


def test_begins_where_it_was_held() -> None:
    outputs = response(ActuatorParams(dead_time_s=0.035, lag_s=0.1, rest=0.15, initial=0.15), [0.15] * 200)
    assert set(outputs) == {0.15}


@given(
    st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=60),
    st.floats(0.0, 0.08),
    st.floats(0.0, 0.3),
    st.floats(0.5, 50.0),
)
def test_first_order_stays_within_its_commands_and_its_rate(
    inputs: list[float], dead_s: float, lag_s: float, rate: float
) -> None:
    outputs = [0.0, *response(ActuatorParams(dead_time_s=dead_s, lag_s=lag_s, rate_limit=rate), inputs)]
    assert max(outputs) <= max(0.0, *inputs) + 1e-12 and min(outputs) >= min(0.0, *inputs) - 1e-12
    assert all(abs(b - a) <= rate * DT_S + 1e-12 for a, b in itertools.pairwise(outputs))


@given(st.lists(st.floats(-2.0, 2.0), min_size=2, max_size=40), st.floats(0.0, 0.05))
def test_linear_without_limits(inputs: list[float], dead_s: float) -> None:
    params = ActuatorParams(dead_time_s=dead_s, order=2, natural_hz=4.0, damping=0.7)
    double = response(params, [2.0 * x for x in inputs])
    assert double == pytest.approx([2.0 * y for y in response(params, inputs)], abs=1e-9)


def test_three_channels_do_not_mix() -> None:
    block = actuators(ActuatorParams(), ActuatorParams(lag_s=0.1), ActuatorParams(dead_time_s=0.02))
    out = run(block, [Command(0.3, 0.2, 1.0, 4.0)] * 4, DT_S)
    assert [row.throttle_frac for row in out] == pytest.approx([0.3] * 4)
    assert out[0].brake_frac == pytest.approx(0.2 * (1.0 - math.exp(-0.1)))
    assert [row.steer_rad for row in out] == pytest.approx([0.0, 0.0, 1.0, 1.0])
    assert {row.gear for row in out} == {4.0}


@pytest.mark.parametrize(
    "params",
    [
        ActuatorParams(dead_time_s=-0.1),
        ActuatorParams(lag_s=math.nan),
        ActuatorParams(rate_limit=0.0),
        ActuatorParams(order=3),
        ActuatorParams(order=2),
        ActuatorParams(order=2, natural_hz=2.0, damping=0.0),
    ],
)
def test_no_actuator(params: ActuatorParams) -> None:
    with pytest.raises(InputError) as caught:
        response(params)
    assert caught.value.key.startswith("actuators.") and caught.value.hint
