"""Samples of the map: the delay is the car's, and pedals that are missing, swapped or dead are named."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.learn.made_pedals import REST, changed, law, pedal_drive, some_drive, vehicle
from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.open_loop_map.samples import (
    BRAKE,
    PEDALS,
    THROTTLE,
    ActuationDelay,
    identify_delay,
    is_pedal_held,
    make_pedal_track,
    make_samples,
)

NONE = {pedal: ActuationDelay(0.0, True, "") for pedal in PEDALS}


@pytest.mark.parametrize(("dead_s", "lag_s"), [(0.02, 0.05), (0.06, 0.12), (0.15, 0.25)])
def test_the_delay_is_dead_time_and_half_a_step_of_the_lag(dead_s: float, lag_s: float) -> None:
    tracks = [make_pedal_track(pedal_drive(180.0, dead_s=dead_s, lag_s=lag_s), vehicle())]
    for pedal in PEDALS:
        delay = identify_delay(tracks, pedal, vehicle())
        assert delay.is_identified
        assert dead_s + math.log(2.0) * lag_s - 0.025 < delay.seconds < dead_s + lag_s + 0.025, pedal


def test_held_pedals_show_no_delay_and_the_data_sheet_is_taken() -> None:
    drive = some_drive()
    held = np.full(drive.n_rows, 0.25)
    still = changed(drive, command__throttle_frac=held, command__brake_frac=np.full(drive.n_rows, REST))
    delay = identify_delay([make_pedal_track(still, vehicle())], THROTTLE, vehicle())
    assert not delay.is_identified and "data sheet" in delay.note
    assert delay.seconds == pytest.approx(0.03 + 0.02)


def test_samples_lie_on_the_law() -> None:
    tracks = [make_pedal_track(some_drive(), vehicle())]
    delays = {pedal: identify_delay(tracks, pedal, vehicle()) for pedal in PEDALS}
    samples = make_samples(tracks, delays, vehicle())

    def spread(given) -> float:
        throttle = np.where(given.pedal > 0, given.command_frac, REST)
        brake = np.where(given.pedal < 0, given.command_frac, REST)
        truth = [law(*one) for one in zip(given.speed_mps, throttle, brake, strict=True)]
        return float(np.sqrt(np.mean((given.accel_mps2 - truth) ** 2)))

    assert spread(samples) < 0.6 * spread(make_samples(tracks, NONE, vehicle())), "a delay that is left out costs"
    assert {-1.0, 0.0, 1.0} == set(np.unique(samples.pedal))
    coasting = samples.pedal == 0.0
    assert np.all(samples.command_frac[coasting] == REST)
    brakes = samples.select_pedal(BRAKE)
    assert len(brakes.pedal) == np.sum(samples.pedal <= 0.0)


def test_a_pedal_is_held_once_it_has_not_moved_for_a_while() -> None:
    duty = np.where(np.arange(300) < 150, 0.2, 0.4)
    held = is_pedal_held(duty, 0.01, 0.01)
    assert not held[140:190].any() and held[:139].all() and held[191:].all()
    assert is_pedal_held(duty, 0.3, 0.01).all()


def test_a_pedal_that_was_not_used_is_named() -> None:
    coasting = make_pedal_track(pedal_drive(120.0, brakes=False), vehicle())
    with pytest.raises(InputError, match="no braking in 120 s of logs") as caught:
        make_samples([coasting], NONE, vehicle())
    assert caught.value.code == "no_brake"
    drive = some_drive()
    pushed = changed(drive, command__throttle_frac=np.full(drive.n_rows, REST))
    with pytest.raises(InputError, match="no throttle"):
        make_samples([make_pedal_track(pushed, vehicle())], NONE, vehicle())


def test_swapped_pedals_and_a_wrong_sign_are_named() -> None:
    drive = some_drive()
    throttle, brake = drive.fields["command.throttle_frac"], drive.fields["command.brake_frac"]
    swapped = changed(drive, command__throttle_frac=brake, command__brake_frac=throttle)
    with pytest.raises(InputError, match="swapped") as caught:
        make_samples([make_pedal_track(swapped, vehicle())], NONE, vehicle())
    assert caught.value.code == "swapped_pedals"
    odd = changed(
        drive, ins__accel_mps2=drive.fields["ins.accel_mps2"] + 60.0 * (brake - REST), report__accel_mps2=None
    )
    with pytest.raises(InputError, match="more brake accelerates"):
        make_samples([make_pedal_track(odd, vehicle())], NONE, vehicle())
