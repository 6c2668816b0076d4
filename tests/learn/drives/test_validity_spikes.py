"""Spikes are removed, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.drives.validity import find_spikes, remove_spikes

TICKS = 4000
T = 0.01 * np.arange(TICKS)


def made(**fields: np.ndarray) -> Drive:
    named = {name.replace("__", "."): one for name, one in fields.items()}
    fresh = {name: np.ones(TICKS, dtype=bool) for name in named}
    return Drive("made", f"sha256:{1:064x}", 0.01, named, fresh, np.ones(TICKS, dtype=bool))


def speed(seed: int = 1) -> np.ndarray:
    return 8.0 + 3.0 * np.sin(0.5 * T) + 0.02 * np.random.default_rng(seed).standard_normal(TICKS)


def test_a_speed_of_nought_in_one_frame_is_left_out_and_the_one_before_it_held() -> None:
    values = speed()
    values[[700, 2500]] = 0.0
    drive, counts = remove_spikes(made(report__speed_mps=values))
    assert counts == {"report.speed_mps": 2}
    assert np.flatnonzero(~drive.fresh["report.speed_mps"]).tolist() == [700, 2500]
    assert drive.fields["report.speed_mps"][700] == values[699]


def test_a_drive_without_any_is_given_back_itself() -> None:
    drive = made(report__speed_mps=speed(), ins__heading_rad=(3.0 + 0.1 * T + np.pi) % (2.0 * np.pi) - np.pi)
    assert remove_spikes(drive) == (drive, {})


def test_commands_and_their_echoes_may_be_anything() -> None:
    pulse = 0.1 * np.sin(T)
    pulse[900] = 1.0
    drive = made(command__steer_rad=pulse, report__steer_command_rad=pulse, report__gear=np.where(T == 9.0, 3.0, 1.0))
    assert remove_spikes(drive)[1] == {}


def test_a_step_a_peak_and_a_rounded_signal_are_no_spikes() -> None:
    assert not find_spikes(np.where(T > 20.0, 5.0, 0.0)).any()
    assert not find_spikes(np.abs(np.sin(0.7 * T))).any()
    assert not find_spikes(np.round(2.0 * np.sin(0.3 * T), 1)).any()


def test_a_sensor_that_often_jumps_is_taken_as_it_is() -> None:
    values = speed()
    values[::50] += 5.0
    assert remove_spikes(made(report__speed_mps=values))[1] == {}


@pytest.mark.parametrize("values", [60, 99, 100, 400])
def test_a_short_signal_may_have_one_as_well(values: int) -> None:
    short = speed()[:values].copy()
    short[values // 2] = 0.0
    drive = made(report__speed_mps=np.concatenate([short, np.full(TICKS - values, np.nan)]))
    assert remove_spikes(drive)[1] == {"report.speed_mps": 1}


def test_a_tap_of_an_actuator_is_none_however_seldom_it_is_told() -> None:
    tap = np.interp(T % 4.0, [1.0, 1.05, 1.1, 1.2], [0.0, 0.0, 0.23, 0.0])
    for interval in (1, 2, 5, 10):
        drive = made(report__brake_frac=tap)
        fresh = np.arange(TICKS) % interval == 0
        assert remove_spikes(drive._replace(fresh={"report.brake_frac": fresh}))[1] == {}
    loose = 0.02 * np.random.default_rng(1).standard_normal(TICKS)
    loose[2000:2006] += [0.0, -4.56, 0.89, 2.32, -2.59, 3.79]  # a car begins to shake
    assert not find_spikes(loose).any()


def test_a_frame_without_a_number_stays_one() -> None:
    values = speed()
    values[700:702] = 40.0, np.nan
    cured, _ = remove_spikes(made(report__speed_mps=values))
    assert cured.fields["report.speed_mps"][700] == values[699] and np.isnan(cured.fields["report.speed_mps"][701])


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**6), st.floats(1e-3, 10.0), st.integers(1, 9))
def test_white_noise_has_none(seed: int, loud: float, digits: int) -> None:
    noise = loud * np.random.default_rng(seed).standard_normal(TICKS)
    assert not find_spikes(np.round(noise, digits)).any()


@pytest.mark.parametrize("interval", [1, 10])
def test_slow_signals_are_looked_at_value_by_value(interval: int) -> None:
    values = np.repeat(speed()[::interval], interval)
    fresh = np.arange(TICKS) % interval == 0
    values[1000 : 1000 + interval] = 0.0
    drive = made(report__speed_mps=values)._replace(fresh={"report.speed_mps": fresh})
    cured, counts = remove_spikes(drive)
    assert counts == {"report.speed_mps": 1}
    assert np.all(cured.fields["report.speed_mps"][1000 : 1000 + interval] == values[999])
