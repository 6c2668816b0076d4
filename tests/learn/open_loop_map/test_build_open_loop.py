"""The open-loop map of a model: both dead bands are in it, and the actuators that lie before the plant."""

from __future__ import annotations

import pytest

from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.control.calibration_map import from_triples, lookup
from tunefree_hil.learn.open_loop_map.build import PedalRange, arrays_from_triples, sample_plant_map, sweep_pedals
from tunefree_hil.plant.actuation.actuators import ActuatorParams
from tunefree_hil.plant.single_track import PLANT


def test_sweep_keeps_both_dead_bands() -> None:
    def accel_of(speed: float, throttle: float, brake: float) -> float:
        return -0.2 + 4.0 * max(0.0, throttle - 0.2) - 20.0 * max(0.0, brake - 0.18)

    triples = sweep_pedals(accel_of, PedalRange(0.15, 0.8), PedalRange(0.15, 0.5), (5.0,))
    accels, commands = [row[1] for row in triples], [row[2] for row in triples]
    assert accels == sorted(set(accels))
    assert commands == sorted(commands)
    own = from_triples([5.0] * len(accels), accels, commands)
    assert lookup(own, 5.0, -0.1) == pytest.approx(0.225, abs=1e-3)
    assert lookup(own, 5.0, -1.0) == pytest.approx(-0.22, abs=1e-3)
    assert lookup(own, 5.0, -0.21) == pytest.approx(-0.1805, abs=1e-3)


def test_commands_go_through_the_actuators() -> None:
    vehicle, params = load_vehicle("mkz_bywire"), dict(load_model("mkz_nominal").plant.params)
    weak = {"brake": ActuatorParams(gain=0.8, rest=0.15), "throttle": ActuatorParams(offset=0.01, rest=0.15)}
    plain, asked = (
        arrays_from_triples(sample_plant_map(PLANT, params, vehicle, channels)) for channels in (None, weak)
    )
    before, after = (from_triples(*(one[key].tolist() for key in one)) for one in (plain, asked))
    assert lookup(after, 5.0, -3.0) + 0.15 == pytest.approx((lookup(before, 5.0, -3.0) + 0.15) / 0.8, abs=0.003)
    assert lookup(after, 5.0, 1.0) == pytest.approx(lookup(before, 5.0, 1.0) - 0.01, abs=0.003)
