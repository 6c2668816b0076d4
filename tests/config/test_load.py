"""Every file of the project loads, and every mistake says file, key, what was expected, and a way on."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.config import check
from tunefree_hil.config.find import available
from tunefree_hil.config.load import (
    SPECS,
    json_schema,
    load_bench,
    load_model,
    load_scenario,
    load_vehicle,
    load_weights,
)
from tunefree_hil.control.parameters import NAMES
from tunefree_hil.grade.score import SCORE_METRICS
from tunefree_hil.tune.space import resolve_space

LOADERS: dict[str, Callable[..., Any]] = {
    "vehicle": load_vehicle,
    "model": load_model,
    "scenario": load_scenario,
    "weights": load_weights,
    "bench": load_bench,
}
SCENARIO = """
schema = "tunefree.scenario/1"
name = "some"
start = { speed_mps = 5.0 }
speed = { t_s = [0.0, 10.0], value = [5.0, 6.0] }
curvature = { t_s = [0.0, 10.0], value = [0.0, 0.01] }
friction = { t_s = [0.0], value = [0.8] }
"""
WEIGHTS = """
schema = "tunefree.weights/1"
name = "some"
against = "original"
[metrics]
lateral_err_std = 3.0
speed_err_std = 1.0
"""
BENCH = """
schema = "tunefree.bench/1"
vehicle = "mkz_bywire"
model = "mkz_nominal"
scenarios = ["left_turn"]
[controller.parameters]
"lqr.q1" = 0.1
[tune]
trials = 10
[[tune.parameters]]
name = "station.kp"
low = 0.01
high = 1.0
[[effects]]
name = "steer_rate_limit"
params = { rate_radps = inf }
[[faults]]
channel = "brake"
kind = "driver_override"
from_tick = 10
to_tick = 20
"""
MODEL = """
schema = "tunefree.model/1"
vehicle = "mkz_bywire"
[actuators.steer]
dead_time_s = { value = 0.1, low = 0.09, high = 0.11 }
rate_limit = inf
[plant]
kind = "physics"
[noise]
"report.speed_mps" = 0.01
[valid]
speed_mps = [0.0, 10.0]
"""
PREVIEW = '[controller]\nlongitudinal = "pid_preview"\n[controller.parameters]\n'
TEXTS = {"scenario": SCENARIO, "weights": WEIGHTS, "bench": BENCH, "model": MODEL}


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """A file of a kind, with one thing replaced."""

    def make(kind: str, old: str = "", new: str = "") -> Path:
        assert old in TEXTS[kind]
        path = tmp_path / "file.toml"
        path.write_text(TEXTS[kind].replace(old, new, 1) if old else TEXTS[kind] + new)
        return path

    return make


@pytest.mark.parametrize("kind", LOADERS)
def test_all_our_files_load(kind: str) -> None:
    names = available(kind)
    for name in names:
        assert LOADERS[kind](name).schema == f"tunefree.{kind}/1"
    assert names or kind == "bench"


@pytest.mark.parametrize("kind", TEXTS)
def test_the_samples_load(kind: str, write: Callable[..., Path]) -> None:
    LOADERS[kind](write(kind))


MISTAKES = [
    ("scenario", "speed = {", "speeed = {", "speeed", "unknown key", "speed"),
    ("scenario", "speed_mps = 5.0 }", "speed_mp = 5.0 }", "start.speed_mp", "unknown key", "speed_mps"),
    ("scenario", 'name = "some"\n', "", "name", "missing", "text"),
    ("scenario", "t_s = [0.0, 10.0], value = [5.0, 6.0]", "t_s = [0.0, 10.0]", "speed.value", "missing", "list"),
    ("scenario", '"some"', "7", "name", "expected text, got a whole number (7)", ""),
    ("scenario", "[5.0, 6.0]", '[5.0, "6"]', "speed.value[1]", "expected a number, got text ('6')", ""),
    ("scenario", "[5.0, 6.0]", "[5.0, true]", "speed.value[1]", "expected a number", ""),
    ("scenario", "[5.0, 6.0]", "[5.0, nan]", "speed.value[1]", "finite", ""),
    ("scenario", "[5.0, 6.0]", "[5.0, inf]", "speed.value[1]", "finite", ""),
    ("scenario", "[5.0, 6.0]", "[5.0, 6.0, 7.0]", "speed", "2 times in t_s, 3 in value", "one value"),
    ("scenario", "[5.0, 6.0]", "[5.0, -0.1]", "speed.value", "below 0", "forwards"),
    ("scenario", "speed_mps = 5.0", "speed_mps = -5.0", "start.speed_mps", "below 0", "forwards"),
    (
        "scenario",
        "curvature = { t_s = [0.0, 10.0]",
        "curvature = { t_s = [0.0, 0.0]",
        "curvature.t_s[1]",
        "not above",
        "",
    ),
    ("scenario", "speed = { t_s = [0.0,", "speed = { t_s = [0.5,", "speed.t_s", "begins at 0.5", "0.0"),
    ("scenario", "value = [0.8]", "value = [0.0]", "friction.value", "not above 0", ""),
    ("scenario", "{ speed_mps = 5.0 }", "5.0", "start", "expected a table", ""),
    ("scenario", "scenario/1", "scenario/2", "schema", "tunefree.scenario/1", ""),
    ("scenario", 'name = "some"', 'name = "some"\nhash = "00"', "hash", "unknown key", ""),
    ("scenario", 'name = "some"', 'name = "some"\nnoise_seed = 70000', "noise_seed", "does not fit", "65535"),
    ("scenario", "[5.0, 6.0]", "[5.0, 1e308]", "speed.value", "1e+308 is beyond 1000", "unit"),
    ("scenario", "[0.0, 0.01]", "[0.0, -1e308]", "curvature.value", "beyond 1000", "unit"),
    ("scenario", "value = [0.8]", "value = [1e308]", "friction.value", "beyond 1000", "unit"),
    (
        "scenario",
        "friction = { t_s = [0.0], value = [0.8]",
        "grade = { t_s = [0.0], value = [2.0]",
        "grade.value",
        "beyond 1.5",
        "unit",
    ),
    (
        "scenario",
        "friction = { t_s = [0.0], value = [0.8]",
        "bank = { t_s = [0.0], value = [2.0]",
        "bank.value",
        "1.5",
        "",
    ),
    (
        "scenario",
        "friction = { t_s = [0.0], value = [0.8]",
        "bank = { t_s = [0.0], value = [nan]",
        "bank.value[0]",
        "fin",
        "",
    ),
    ("scenario", "friction = { t_s = [0.0], value = [0.8] }", "bank = [0.1]", "bank", "expected a table", ""),
    (
        "scenario",
        "friction = { t_s = [0.0]",
        "side_wind = { t_s = [0.0, 1.0]",
        "side_wind",
        "2 times in t_s",
        "one value",
    ),
    (
        "scenario",
        "friction = { t_s = [0.0], value = [0.8]",
        "side_wind = { t_s = [0.0], value = [inf]",
        "side_wind.value[0]",
        "finite",
        "",
    ),
    (
        "scenario",
        "friction = { t_s = [0.0], value = [0.8]",
        "side_wind = { t_s = [0.0], value = [1e308]",
        "side_wind.value",
        "beyond 1000",
        "unit",
    ),
    ("scenario", "speed_mps = 5.0", "lateral_m = -1e308", "start.lateral_m", "beyond", "unit"),
    ("scenario", "speed_mps = 5.0", "speed_mps = 1e308", "start.speed_mps", "beyond 1000", "unit"),
    ("scenario", "speed = { t_s = [0.0, 10.0]", "speed = { t_s = [0.0, 1e308]", "speed.t_s", "lasts 1e+308 s", "86400"),
    (
        "scenario",
        "speed = { t_s = [0.0, 10.0], value = [5.0, 6.0]",
        "speed = { t_s = [0.0, 86400.0], value = [5.0, 60.0]",
        "speed",
        "may be 5.184e+06 m",
        "long at most",
    ),
    ("weights", "3.0", "-0.3", "metrics.lateral_err_std", "below 0", "weights"),
    ("weights", "[metrics]", "largest_value = -1.0\n[metrics]", "largest_value", "below 0", "or 0"),
    ("weights", "3.0", "inf", "metrics.lateral_err_std", "finite", ""),
    ("weights", "= 3.0\nspeed_err_std = 1.0", "= 0.0", "metrics", "add up to 0", "a weight"),
    ("weights", "lateral_err_std", "lateral_er_std", "metrics.lateral_er_std", "no such metric", "lateral_err_std"),
    ("weights", '"original"', '"other"', "against", "'current', 'original'", ""),
    ("bench", '"lqr.q1"', '"lqr.q9"', "controller.parameters.lqr.q9", "no such parameter", "lqr.q"),
    ("bench", '"station.kp"', '"station.kpp"', "tune.parameters[0].name", "no parameter", "station.kp"),
    ("bench", "low = 0.01", "low = 1.5", "tune.parameters[0].low", "not below high", "low < high"),
    ("bench", "low = 0.01\nhigh = 1.0\n", "step = -1.0\n", "tune.parameters[0].step", "not above 0", "or none"),
    ("bench", "low = 0.01", "low = 0.0", "tune.parameters[0].low", "log scale", "linear"),
    ("bench", "trials = 10", "trials = 0", "tune.trials", "below 1", ""),
    ("bench", "trials = 10", 'set = "all"', "tune.set", "'complete'", ""),
    ("bench", "trials = 10", 'backend = "ecu"', "tune.backend", "'batch'", ""),
    ("bench", '["left_turn"]', "[]", "scenarios", "empty", ""),
    ("bench", "to_tick = 20", "to_tick = 10", "faults[0]", "to_tick 10", "<"),
    ("model", "low = 0.09", "low = 0.105", "actuators.steer.dead_time_s", "outside", ""),
    ("model", "value = 0.1,", "", "actuators.steer.dead_time_s.value", "missing", "a number"),
    ("model", "rate_limit = inf", "lag_s = inf", "actuators.steer.lag_s", "finite", ""),
    ("model", "rate_limit = inf", "lag_s = -0.1", "actuators.steer.lag_s", "below 0", ""),
    ("model", "rate_limit = inf", "order = 2", "actuators.steer.natural_hz", "order 2", ""),
    ("model", "[actuators.steer]", "[actuators.steering]", "actuators.steering", "no channel", "did you mean steer?"),
    ("model", "rate_limit = inf", "rate_limits = 3.0", "actuators.steer.rate_limits", "unknown key", "rate_limit"),
    ("model", "report.speed_mps", "report.sped_mps", "noise.report.sped_mps", "no such record field", "speed_mps"),
    ("model", "[0.0, 10.0]", "[10.0, 0.0]", "valid.speed_mps", "[low, high]", ""),
]


@pytest.mark.parametrize(("kind", "old", "new", "key", "words", "hint"), MISTAKES)
def test_a_mistake_names_its_key(
    kind: str, old: str, new: str, key: str, words: str, hint: str, write: Callable[..., Path]
) -> None:
    path = write(kind, old, new)
    with pytest.raises(InputError) as caught:
        LOADERS[kind](path)
    error = caught.value
    assert (error.file, error.key) == (str(path), key)
    assert words in error.message and hint in error.hint, str(error)


def test_parts_of_the_controller_have_parameters_of_their_own(write: Callable[..., Path]) -> None:
    """Of the group of the table too; which ones a part has is known where it is built."""
    assert (
        "speed.observer_radps"
        in load_bench(
            write("bench", '[controller.parameters]\n"lqr.q1"', f'{PREVIEW}"speed.observer_radps"')
        ).controller.parameters
    )
    with pytest.raises(InputError, match="no such parameter"):
        load_bench(write("bench", '"lqr.q1"', '"speed.observer_radps"'))


def test_what_is_no_toml_is_said_with_line_and_column(write: Callable[..., Path]) -> None:
    with pytest.raises(InputError, match="line 3, column 8"):
        load_scenario(write("scenario", 'name = "some"', "name = some"))


def test_a_file_of_other_bytes_is_said(tmp_path: Path) -> None:
    path = tmp_path / "file.toml"
    path.write_bytes(b"name = \xff\xfe")
    with pytest.raises(InputError, match="not UTF-8"):
        load_scenario(path)


def test_a_byte_order_mark_is_no_mistake(write: Callable[..., Path]) -> None:
    """As editors of Windows write it."""
    path = write("scenario")
    plain = load_scenario(path)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    marked = load_scenario(path)
    assert (marked.name, marked.speed, marked.curvature) == (plain.name, plain.speed, plain.curvature)


def test_several_mistakes_are_listed_together(write: Callable[..., Path]) -> None:
    with pytest.raises(InputError) as caught:
        load_scenario(write("scenario", "[5.0, 6.0]", "[-5.0, 6.0, 7.0]"))
    assert "2 things do not fit" in caught.value.message and "below 0" in caught.value.message


def test_a_controller_of_ones_own_has_parameters_of_its_own(write: Callable[..., Path]) -> None:
    own = '[controller]\nlateral = "my/idea.py:CONTROLLER"\n[controller.parameters]\n"idea.gain" = 1.0\n'
    bench = load_bench(write("bench", '[controller.parameters]\n"lqr.q1" = 0.1\n', own))
    assert bench.controller.parameters == {"idea.gain": 1.0}


def test_a_parameter_without_a_box_is_searched_in_the_one_it_has(write: Callable[..., Path]) -> None:
    """With a box it is searched in that one; what is none of ours has none that could be meant."""
    tune = load_bench(write("bench", "low = 0.01\nhigh = 1.0\n", "")).tune
    assert resolve_space("", tune.parameters).axes == (resolve_space("complete", []).axes[NAMES.index("station.kp")],)
    assert resolve_space("", load_bench(write("bench", "high = 1.0", "high = 0.5")).tune.parameters).axes[0].high == 0.5
    own = 'name = "pursuit.gain"\n'
    with pytest.raises(InputError, match="not below high"):
        load_bench(write("bench", 'name = "station.kp"\nlow = 0.01\nhigh = 1.0\n', own))


def test_limits_may_be_infinite(write: Callable[..., Path]) -> None:
    assert math.isinf(load_bench(write("bench")).effects[0].params["rate_radps"])


def test_a_scenarios_hash_is_that_of_its_bytes(repo: Path) -> None:
    spec = load_scenario("left_turn")
    assert spec.path == str(repo / "bench_configs" / "scenarios" / "left_turn.toml")
    assert spec.hash == hashlib.sha256(Path(spec.path).read_bytes()).hexdigest()


def test_a_vehicles_hash_changes_with_its_dbc(repo: Path, tmp_path: Path) -> None:
    for name in ("vehicle.toml", "vehicle.dbc"):
        (tmp_path / name).write_bytes((repo / "dbc" / "mkz_bywire" / name).read_bytes())
    first = load_vehicle(tmp_path)
    assert first.hash == load_vehicle("mkz_bywire").hash and first.folder == str(tmp_path.resolve())
    (tmp_path / "vehicle.dbc").write_text((tmp_path / "vehicle.dbc").read_text() + "\n")
    assert load_vehicle(tmp_path).hash != first.hash


def test_a_models_hash_changes_with_its_arrays(tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text(MODEL)
    first = load_model(tmp_path).hash
    (tmp_path / "calibration.npz").write_bytes(b"numbers")
    assert load_model(tmp_path).hash != first


@pytest.mark.parametrize("kind", SPECS)
def test_the_json_schema_is_json(kind: str) -> None:
    schema = json.loads(json.dumps(json_schema(kind), allow_nan=False))
    definition = schema["$defs"][SPECS[kind].__name__]
    assert definition["additionalProperties"] is False and "schema" in definition["required"]
    assert not {"hash", "folder", "path"} & definition["properties"].keys(), "the loader sets them"


def test_an_unknown_schema_names_those_there_are() -> None:
    with pytest.raises(InputError) as caught:
        json_schema("vehicles")
    assert "vehicle" in caught.value.hint


def test_the_names_of_parameters_are_those_of_the_controller() -> None:
    assert check.PARAMETERS == NAMES


def test_the_metrics_that_weights_may_name_are_those_that_are_computed() -> None:
    assert SCORE_METRICS == check.METRICS
