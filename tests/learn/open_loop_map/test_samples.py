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
    Delay,
    find_delay,
    is_held,
    samples_of,
    track_of,
)

NONE = {pedal: Delay(0.0, True, "") for pedal in PEDALS}


@pytest.mark.parametrize(("dead_s", "lag_s"), [(0.02, 0.05), (0.06, 0.12), (0.15, 0.25)])
def test_the_delay_is_dead_time_and_half_a_step_of_the_lag(dead_s: float, lag_s: float) -> None:
    tracks = [track_of(pedal_drive(180.0, dead_s=dead_s, lag_s=lag_s), vehicle())]
    for pedal in PEDALS:
        delay = find_delay(tracks, pedal, vehicle())
        assert delay.found
        assert dead_s + math.log(2.0) * lag_s - 0.025 < delay.seconds < dead_s + lag_s + 0.025, pedal


def test_held_pedals_show_no_delay_and_the_data_sheet_is_taken() -> None:
    drive = some_drive()
    held = np.full(drive.ticks, 0.25)
    still = changed(drive, command__throttle_frac=held, command__brake_frac=np.full(drive.ticks, REST))
    delay = find_delay([track_of(still, vehicle())], THROTTLE, vehicle())
    assert not delay.found and "data sheet" in delay.words
    assert delay.seconds == pytest.approx(0.03 + 0.02)


def test_samples_lie_on_the_law() -> None:
    tracks = [track_of(some_drive(), vehicle())]
    delays = {pedal: find_delay(tracks, pedal, vehicle()) for pedal in PEDALS}
    samples = samples_of(tracks, delays, vehicle())

    def spread(given) -> float:
        throttle = np.where(given.pedal > 0, given.command_frac, REST)
        brake = np.where(given.pedal < 0, given.command_frac, REST)
        truth = [law(*one) for one in zip(given.speed_mps, throttle, brake, strict=True)]
        return float(np.sqrt(np.mean((given.accel_mps2 - truth) ** 2)))

    assert spread(samples) < 0.6 * spread(samples_of(tracks, NONE, vehicle())), "a delay that is left out costs"
    assert {-1.0, 0.0, 1.0} == set(np.unique(samples.pedal))
    coasting = samples.pedal == 0.0
    assert np.all(samples.command_frac[coasting] == REST)
    brakes = samples.of(BRAKE)
    assert len(brakes.pedal) == np.sum(samples.pedal <= 0.0)


def test_a_pedal_is_held_once_it_has_not_moved_for_a_while() -> None:
    duty = np.where(np.arange(300) < 150, 0.2, 0.4)
    held = is_held(duty, 0.01, 0.01)
    assert not held[140:190].any() and held[:139].all() and held[191:].all()
    assert is_held(duty, 0.3, 0.01).all()


def test_a_pedal_that_was_not_used_is_named() -> None:
    coasting = track_of(pedal_drive(120.0, brakes=False), vehicle())
    with pytest.raises(InputError, match="no braking in 120 s of logs") as caught:
        samples_of([coasting], NONE, vehicle())
    assert caught.value.code == "no_brake"
    drive = some_drive()
    pushed = changed(drive, command__throttle_frac=np.full(drive.ticks, REST))
    with pytest.raises(InputError, match="no throttle"):
        samples_of([track_of(pushed, vehicle())], NONE, vehicle())


def test_swapped_pedals_and_a_wrong_sign_are_named() -> None:
    drive = some_drive()
    throttle, brake = drive.fields["command.throttle_frac"], drive.fields["command.brake_frac"]
    swapped = changed(drive, command__throttle_frac=brake, command__brake_frac=throttle)
    with pytest.raises(InputError, match="swapped") as caught:
        samples_of([track_of(swapped, vehicle())], NONE, vehicle())
    assert caught.value.code == "swapped_pedals"
    odd = changed(
        drive, ins__accel_mps2=drive.fields["ins.accel_mps2"] + 60.0 * (brake - REST), report__accel_mps2=None
    )
    with pytest.raises(InputError, match="more brake accelerates"):
        samples_of([track_of(odd, vehicle())], NONE, vehicle())
