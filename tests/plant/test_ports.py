"""Where an effect sits in an assembled car: before the actuator, on its output, behind its report."""

from __future__ import annotations

import numpy as np
import pytest

from tests.plant.drives import CHANNELS, DT_S, REST, command, drive, rest_of
from tunefree_hil.base.contracts import Effect, make_effect
from tunefree_hil.gap.model.graph import load_catalogue
from tunefree_hil.plant.actuation.actuators import ActuatorParams
from tunefree_hil.plant.single_track import PLANT
from tunefree_hil.plant.vehicle import Body, assemble

LAG_S, RATE = 0.2, 0.5
STEP_RAD = 1.0


def car(name: str, **params: float) -> Body:
    """A car whose motors have a lag, with an effect."""
    effect: Effect = load_catalogue()[name]
    made = make_effect(effect, params, rest=rest_of(effect.port))
    channels = CHANNELS | {
        "steer": ActuatorParams(lag_s=LAG_S),
        "throttle": ActuatorParams(lag_s=LAG_S, rest=REST, initial=REST),
    }
    return assemble(PLANT, {}, channels, effects=[(effect.port, made)], rest_frac=(REST, REST), dt_s=DT_S)


def reported(body: Body, field: str, size: float) -> np.ndarray:
    """What is reported of a step at once."""
    asked = command(steer=size) if field == "steer_rad" else command(throttle=REST + size)
    return np.array([getattr(out.measurement.report, field) for out in drive(body, lambda _: asked, 4.0)])


@pytest.mark.parametrize(
    ("name", "params", "field", "size"),
    [
        ("steer_rate_limit", {"rate_radps": RATE}, "steer_rad", STEP_RAD),
        ("throttle_rate_limit", {"rate_per_s": RATE}, "throttle_frac", 0.6),
    ],
)
def test_a_rate_limit_is_behind_the_lag_ramps_from_the_first_tick_and_shows_in_the_report(
    name: str, params: dict[str, float], field: str, size: float
) -> None:
    said = reported(car(name, **params), field, size)
    slopes = np.diff(said) / DT_S
    assert slopes[2] == pytest.approx(RATE) and slopes.max() <= RATE * (1.0 + 1e-9)
    assert said[-1] - said[0] == pytest.approx(size, abs=1e-3)


def test_a_gain_behind_the_report_does_not_show_in_it() -> None:
    assert reported(car("steer_gain", gain_frac=2.0), "steer_rad", STEP_RAD)[-1] == pytest.approx(STEP_RAD, abs=1e-6)


def test_a_dead_time_is_before_the_lag() -> None:
    plain, late = (reported(car("steer_dead_time", delay_s=delay_s), "steer_rad", STEP_RAD) for delay_s in (0.0, 0.1))
    assert np.allclose(late[10:], plain[:-10], atol=1e-12) and not late[:10].any()
