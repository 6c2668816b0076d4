"""The open-loop map: look-up rule, files, mistakes, and the nominal model's own map."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.open_loop_map import KEYS
from tunefree_hil.control.calibration_map import from_triples, load, lookup
from tunefree_hil.plant.vehicle import steady_accel

ROOT = Path(__file__).resolve().parents[2]
TWO = from_triples([0.0, 0.0, 10.0, 10.0, 10.0], [-1.0, 1.0, 2.0, -2.0, 0.0], [-0.2, 0.2, 0.6, -0.4, 0.1])


def tool():
    spec = importlib.util.spec_from_file_location("make_calibration", ROOT / "tools" / "make_calibration.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_look_up_rule():
    assert lookup(TWO, 0.0, 0.5) == pytest.approx(0.1)
    assert lookup(TWO, 10.0, 1.0) == pytest.approx(0.35)
    assert lookup(TWO, 5.0, 0.5) == pytest.approx(0.5 * (0.1 + 0.225))
    assert lookup(TWO, 10.0, 9.0) == 0.6  # held at the ends
    assert lookup(TWO, 99.0, -9.0) == -0.4
    assert lookup(TWO, -1.0, 9.0) == 0.2


def test_a_repeated_point_counts_as_the_last():
    again = from_triples([1.0, 1.0, 1.0], [0.0, 1.0, 1.0], [0.1, 0.5, 0.7])
    assert lookup(again, 1.0, 1.0) == 0.7


@given(st.floats(-1.0, 12.0), st.floats(-3.0, 3.0), st.floats(0.0, 0.5))
def test_more_acceleration_never_gives_less_command(speed, accel, more):
    assert lookup(TWO, speed, accel + more) >= lookup(TWO, speed, accel) - 1e-12


def test_single_speed_and_single_point():
    assert lookup(from_triples([3.0], [0.0], [0.3]), 8.0, 1.0) == 0.3


def test_files(tmp_path):
    path = tmp_path / "calibration.npz"
    with pytest.raises(InputError, match="no such file") as caught:
        load(path)
    assert caught.value.code == "no_calibration" and "tools/make_calibration" in caught.value.hint
    np.savez(path, speed_mps=[0.0, 0.0], accel_mps2=[0.0, 1.0], command_frac=[0.1])
    with pytest.raises(InputError, match="2, 2, 1 values") as caught:
        load(path)
    assert caught.value.code == "bad_calibration" and caught.value.file == str(path)
    np.savez(path, speed_mps=[0.0, 0.0], accel_mps2=[0.0, 1.0], command_frac=[0.1, 0.2])
    assert lookup(load(path), 0.0, 0.5) == pytest.approx(0.15)


def test_the_nominal_models_map_is_the_one_its_model_gives():
    make = tool()
    path = ROOT / "bench_configs" / "models" / "mkz_nominal" / "calibration.npz"
    stored = load(path)
    fresh = make.calibrate("mkz_nominal")
    with np.load(path) as archive:
        assert np.allclose(np.array(fresh).T, [archive[key] for key in KEYS], atol=1e-9)
    # Between its points the map is good to a few hundredths, driven by the model itself.
    model = make.load_model("mkz_nominal")
    plant, params = make.PLANTS[model.plant.kind], dict(model.plant.params)
    for speed in (0.7, 3.3, 7.7, 13.0, 24.0):
        for accel in (-5.0, -2.1, -0.6, 0.4, 0.9):
            command = lookup(stored, speed, accel)
            throttle, brake = (command, 0.15) if command > 0.0 else (0.15, -command)
            got = steady_accel(plant, params, speed, throttle, brake)
            if 0.15 < throttle < 0.79 or brake > 0.15:
                assert got == pytest.approx(accel, abs=0.05)
