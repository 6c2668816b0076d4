"""A window's free run is the plant's own: the same car, with what lies between the reported outputs and it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest

from tests.learn.made_drives import CHANNELS, DT_S, REST, made_drive, whole
from tunefree_hil.base.contracts import BodyChange, Effect, make_effect
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import GEAR_DRIVE, NAN, Command, Disturbance
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.effects import brake_dead_band, powertrain_lag, steer_offset
from tunefree_hil.effects._signals import SoftState, soft
from tunefree_hil.learn.drives.drive import DrivePart
from tunefree_hil.learn.physics.windows import (
    TARGETS,
    THROTTLE_HISTORY_S,
    FreeRunWindow,
    OutputCorrection,
    compute_errors,
    extract_windows,
    simulate_window,
)
from tunefree_hil.plant.data_sheet import DEFAULTS, constants_of
from tunefree_hil.plant.ports import Effects
from tunefree_hil.plant.single_track import PLANT
from tunefree_hil.plant.types import BodyInput, ChassisParams, Driver
from tunefree_hil.plant.vehicle import assemble, for_episode

VEHICLE = load_vehicle("mkz_bywire")
LAG_S = 0.3
CAR = ChassisParams(constants_of(DEFAULTS, BodyChange()))


class Driven(NamedTuple):
    """inputs [n, 4] as a Window has them; motion [n, 6]: TARGETS."""

    inputs: np.ndarray
    motion: np.ndarray


def effect(one: Effect, **values: float) -> Effects:
    """What a model folder with this effect puts on its car."""
    rest = 0.0 if one is steer_offset.EFFECT else REST
    return ((one.port, make_effect(one, values, rest=rest)),)


def script(time_s: float) -> Command:
    """Straight on: two ramps of the throttle, and brakes."""
    throttle = REST + 0.12 * abs(math.sin(0.9 * time_s)) if time_s % 9.0 < 6.0 else REST
    brake = REST + 0.05 if time_s % 9.0 > 7.0 else REST
    return Command(throttle, brake, 0.0, GEAR_DRIVE, NAN, NAN)


def driven(seconds: float, effects: Effects = ()) -> Driven:
    """The plant with the effect, tick by tick, without noise."""
    body = for_episode(
        assemble(PLANT, {}, CHANNELS, effects=effects, rest_frac=(REST, REST), dt_s=DT_S), Start(speed_mps=8.0)
    )
    state, rows, motions = body.block.init(body.block.params, DT_S), [], []
    for k in range(round(seconds / DT_S)):
        x = BodyInput(script(k * DT_S), Driver(), Disturbance())
        state, out = body.block.step(body.block.params, state, x, DT_S)
        act = out.actuation
        rows.append((act.throttle_frac, act.brake_frac, act.steer_rad, act.gear))
        motions.append([getattr(out.motion, name) for name in TARGETS])
    return Driven(np.array(rows), np.array(motions))


def window_at(drive: Driven, row: int, rows: int, back: int) -> FreeRunWindow:
    """A window of a drive from a row on, its throttle known `back` ticks before that."""
    x_m, y_m, heading, speed = (
        drive.motion[row, TARGETS.index(one)] for one in ("x_m", "y_m", "heading_rad", "speed_mps")
    )
    at = np.arange(1, rows)
    return FreeRunWindow(
        "made", row, drive.inputs[row : row + rows], drive.inputs[row - back : row + 1, 0],
        (x_m, y_m, heading, speed, drive.motion[row, TARGETS.index("yaw_rate_radps")]), at,
        drive.motion[row + at], DT_S,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("effects", "off"),
    [
        ((), OutputCorrection()),
        (effect(powertrain_lag.EFFECT, tau_s=LAG_S), OutputCorrection(throttle_lag_s=LAG_S)),
        (effect(brake_dead_band.EFFECT, half_width_frac=0.02), OutputCorrection(brake_frac=0.02)),
    ],
)
def test_a_free_run_is_the_plants_with_the_effect(effects: Effects, off: OutputCorrection) -> None:
    """From the tick on in which the car was put down: all of the past is known."""
    drive = driven(11.0, effects)
    window = window_at(drive, 400, 600, 400)
    assert np.ptp(window.inputs[:50, 0]) > 0.005, "the window starts in a ramp of the throttle"
    assert np.abs(simulate_window(CAR, window, off) - window.targets)[:, :4].max() < 1e-5
    if off != OutputCorrection():
        assert np.abs(simulate_window(CAR, window, OutputCorrection()) - window.targets)[:, 0].max() > 0.05


def test_two_seconds_of_throttle_are_enough_for_a_lag_and_none_is_not() -> None:
    drive = driven(11.0, effect(powertrain_lag.EFFECT, tau_s=LAG_S))
    off, missed = OutputCorrection(throttle_lag_s=LAG_S), []
    for back in (round(THROTTLE_HISTORY_S / DT_S), 0):
        window = window_at(drive, 400, 100, back)
        missed.append(float(np.abs(simulate_window(CAR, window, off) - window.targets)[:, 0].max()))
    assert missed[0] < 1e-4 and missed[1] > 30.0 * missed[0]


def test_a_steering_wheel_off_centre_turns_the_car() -> None:
    window = window_at(driven(11.0), 400, 100, 0)
    straight, turned = (
        simulate_window(CAR, window, OutputCorrection(steer_rad=one))[-1, TARGETS.index("yaw_rate_radps")]
        for one in (0.0, 0.1)
    )
    assert straight == pytest.approx(0.0, abs=1e-6) and turned > 0.01


def test_a_window_knows_the_throttle_before_it() -> None:
    """In a ramp, too: the lag's state there is that of the whole drive's throttle."""
    drive = made_drive(30.0, script=script, effects=effect(powertrain_lag.EFFECT, tau_s=LAG_S))
    first, *others = extract_windows([DrivePart(drive, 150, drive.n_rows)], VEHICLE).windows
    assert (
        len(first.throttle_history) <= round(THROTTLE_HISTORY_S / DT_S) + 1
        and first.throttle_history[-1] == first.inputs[0, 0]
    )
    assert others and all(len(one.throttle_history) == round(THROTTLE_HISTORY_S / DT_S) + 1 for one in others)
    one = max(others, key=lambda one: abs(one.throttle_history[-1] - one.throttle_history[-30]))
    assert abs(one.throttle_history[-1] - one.throttle_history[-30]) > 0.01
    throttle = np.interp(
        np.arange(drive.n_rows), np.flatnonzero(drive.fresh["report.throttle_frac"]),
        drive.fields["report.throttle_frac"][drive.fresh["report.throttle_frac"]],
    )  # fmt: skip
    assert one.throttle_history == pytest.approx(throttle[one.begin - len(one.throttle_history) + 1 : one.begin + 1])
    assert lagged(one.throttle_history) == pytest.approx(lagged(throttle[: one.begin + 1]), abs=1e-4)
    assert abs(lagged(one.throttle_history) - one.throttle_history[-1]) > 0.005, (
        "the push is not yet where the throttle is"
    )


def test_before_a_silence_the_throttle_is_not_known() -> None:
    drive = made_drive(30.0, script=script)
    at = extract_windows([whole(drive)], VEHICLE).windows[1].begin
    fresh = {name: came.copy() for name, came in drive.fresh.items()}
    fresh["report.throttle_frac"][at - 150 : at - 100] = False
    cut = extract_windows([whole(drive._replace(fresh=fresh))], VEHICLE).windows
    after = next(one for one in cut if one.begin > at - 110)
    assert len(after.throttle_history) == 1 and after.throttle_history[0] == after.inputs[0, 0], (
        "it begins where the throttle is heard again"
    )


def test_free_runs_with_the_lag_miss_less_of_a_car_that_has_it() -> None:
    some = extract_windows(
        [whole(made_drive(60.0, effects=effect(powertrain_lag.EFFECT, tau_s=LAG_S)))], VEHICLE
    ).windows
    with_it, without = (
        float(np.sqrt(np.nanmean(compute_errors(DEFAULTS, off, some)[:, :, 0] ** 2)))
        for off in (OutputCorrection(throttle_lag_s=LAG_S), OutputCorrection())
    )
    assert with_it < 0.03 and without > 3.0 * with_it


def lagged(throttle: np.ndarray) -> float:
    """The lag's output behind a throttle that had been at its first value for ever."""
    block = soft(LAG_S, float(throttle[0]))
    state: SoftState = block.init(block.params, DT_S)
    for one in throttle.tolist():
        state, _ = block.step(block.params, state, one, DT_S)
    return state.output
