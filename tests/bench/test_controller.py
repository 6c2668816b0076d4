"""The controller of a bench: constants, parameters within their boxes, the map, the Block for a drive."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from tests.bench.tiny import hash_of, write_bench
from tests.house import ROOT
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, ControllerFor, load, needed_messages, parameters_of, require_in_box
from tunefree_hil.bench.controller import calibration_of, constants_of
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.control.parameters import (
    BASELINES,
    NAMES,
    PARAMETERS,
    BoxChoice,
    box32,
    round32,
    tunable_in_box,
)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return load(write_bench(tmp_path))


def with_controller(folder: Path, text: str) -> Bench:
    return load(write_bench(folder, more=f"[controller]\n{text}\n"))


@pytest.mark.parametrize("row", PARAMETERS, ids=lambda row: row.tunable.name)
def test_the_edges_of_a_box_are_inside_and_beyond_is_not(row) -> None:
    """Of both boxes: a winner of a search in either can be pasted into a bench file."""
    name, published = row.tunable.name, row.tunable
    default = tunable_in_box(name, BoxChoice.DEFAULT)
    low, high = min(default.low, published.low), max(default.high, published.high)
    require_in_box(name, published.low)
    require_in_box(name, published.high)
    fixed = row.manual if row.fixed is None else row.fixed
    for value in (low, high, *box32(low, high), round32(low), round32(high), row.manual, fixed):
        require_in_box(name, value)
    for value in (low - 0.1 * (high - low) - 0.01, high * 1.01, math.nan, math.inf, -math.inf, 1e300):
        with pytest.raises(InputError) as caught:
            require_in_box(name, value, file="b.toml", key="k")
        error = caught.value
        assert (error.code, error.file, error.key) == ("outside_box", "b.toml", "k")
        assert name in error.message and error.hint.startswith("give ")


@pytest.mark.parametrize(("name", "value"), [("mrac.enable", 0.5), ("riccati", 2.0), ("mrac.t_ref_s", 0.0)])
def test_values_between_choices_or_below_the_box(name: str, value: float) -> None:
    with pytest.raises(InputError, match=name):
        require_in_box(name, value)


def test_the_shipped_zeros_are_named_in_the_hint() -> None:
    with pytest.raises(InputError) as caught:
        require_in_box("lqr.q2", 0.5)
    assert caught.value.hint == "give 1e-06 to 0.1, or 0 as shipped"
    with pytest.raises(InputError) as caught:
        require_in_box("mrac.enable", 0.5)
    assert caught.value.hint == "give 0 or 1"


@given(st.floats())
def test_a_users_own_parameter_has_no_published_box_but_must_be_sendable(value: float) -> None:
    """PARAM carries a binary32 number (docs/reference/bench_channel.md)."""
    if math.isfinite(value) and abs(value) < 3.4028234e38:
        require_in_box("own.gain", value)
        bc.encode(bc.Param(16, 17, value))
    else:
        with pytest.raises(InputError, match=r"own\.gain = .* cannot be sent"):
            require_in_box("own.gain", value)


@pytest.mark.parametrize(
    ("value", "choices", "key"),
    [(1e39, "[1.0, 2.0]", "controller.parameters.own.gain"), (None, "[1e39, 1.0]", "tune.parameters")],
)
def test_an_own_parameter_that_cannot_be_sent_is_named(
    tmp_path: Path, value: float | None, choices: str, key: str
) -> None:
    bench = with_controller(tmp_path, f'parameters = {{ "own.gain" = {value} }}' if value else "")
    Path(bench.file).write_text(
        Path(bench.file)
        .read_text()
        .replace('set = "mrac"', f'parameters = [{{ name = "own.gain", choices = {choices} }}]')
    )
    with pytest.raises(InputError, match="cannot be sent") as caught:
        parameters_of(load(bench.file))
    assert (caught.value.file, caught.value.key) == (bench.file, key)


def test_every_manual_baseline_may_be_given() -> None:
    for values in BASELINES.values():
        for name, value in values.items():
            require_in_box(name, value)


def test_the_vector_is_complete_binary32_and_in_order_of_say(tmp_path: Path) -> None:
    bench = with_controller(tmp_path, 'riccati = "apollo150"\nlook_ahead_m = 1.1\nparameters = { "lqr.q1" = 0.3 }')
    values = parameters_of(bench, {"lqr.q3": 0.7})
    assert set(values) == set(NAMES)
    assert values == {name: round32(value) for name, value in values.items()}
    assert (values["riccati"], values["look_ahead_m"]) == (1.0, round32(1.1))
    assert (values["lqr.q1"], values["lqr.q3"]) == (round32(0.3), round32(0.7))
    assert (values["mrac.enable"], values["mrac.clamp_s"]) == (1.0, round32(0.01)), "a study's fixed values"


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ('parameters = { "mrac.t_ref_s" = 0.0 }', "controller.parameters.mrac.t_ref_s"),
        ('parameters = { "speed.kp_low" = 11.0 }', "controller.parameters.speed.kp_low"),
        ("look_ahead_m = -1.0", "controller.look_ahead_m"),
    ],
)
def test_a_bench_file_outside_a_box_is_refused(tmp_path: Path, text: str, key: str) -> None:
    bench = with_controller(tmp_path, text)
    with pytest.raises(InputError) as caught:
        parameters_of(bench)
    assert (caught.value.file, caught.value.key) == (bench.file, key)


def test_a_missing_data_sheet_value_is_named(bench: Bench) -> None:
    vehicle = replace(bench.vehicle, nominal=replace(bench.vehicle.nominal, yaw_inertia_kgm2=None))
    with pytest.raises(InputError) as caught:
        constants_of(vehicle)
    assert caught.value.key == "nominal.yaw_inertia_kgm2" and caught.value.file.endswith("vehicle.toml")


def test_the_map_is_the_models_or_the_bench_files_own(tmp_path: Path) -> None:
    models = calibration_of(load(write_bench(tmp_path)))
    with np.load(ROOT / "bench_configs" / "models" / "mkz_nominal" / "calibration.npz") as archive:
        rows = {name: archive[name] for name in archive.files}
    np.savez(tmp_path / "own.npz", **{**rows, "command_frac": 0.5 * rows["command_frac"]})  # type: ignore[arg-type]
    own = calibration_of(with_controller(tmp_path, 'calibration = "own.npz"'))
    assert own != models
    with pytest.raises(InputError) as caught:
        calibration_of(with_controller(tmp_path, 'calibration = "nothing.npz"'))
    assert "nothing.npz" in str(caught.value)


def test_the_gain_table_is_kept_while_the_parameters_stay(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path, scenarios=("tiny", "other")))
    assign = ControllerFor(bench)
    values = dict(enumerate(parameters_of(bench).values()))
    first = assign(hash_of(tmp_path), values)
    second = assign(hash_of(tmp_path, "other"), values)
    assert (first.ticks, first.dt_s) == (200, 0.01)
    assert second.block.params[1] is first.block.params[1] and second.block.step is first.block.step
    changed = assign(hash_of(tmp_path), {**values, 2: 0.5})
    assert changed.block.params[1] is not first.block.params[1]


def test_what_the_controller_cannot_do_without(bench: Bench) -> None:
    assert needed_messages(bench.codec) == {
        "ins": [one.name for one in bench.codec.telemetry if one.name.startswith("INS_")],
        "chassis": ["STEERING_REPORT"],
    }
