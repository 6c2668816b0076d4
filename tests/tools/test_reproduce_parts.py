"""Parts of the reproduction: what they read from models, choose and compute, and what their pictures show."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.house import ROOT
from tools.measures import table5
from tools.measures._mrac_cells import OFF, TUNED
from tools.reproduction import fig8, fig9, fig10, models, table1, table3
from tools.reproduction.figures.errors import ErrorPanel, draw_errors
from tools.reproduction.figures.open_loop import draw_open_loop
from tools.reproduction.figures.planes import WinnerPoint, draw_winners
from tools.reproduction.figures.side_pass import BACK_M, FRONT_M, SIDE_M, Frame, Trace, draw_side_pass, outline_of
from tools.reproduction.searches import SearchResult, SearchSetting
from tunefree_hil.bench import load
from tunefree_hil.bench.batch import Driven
from tunefree_hil.config.load import load_model
from tunefree_hil.episode.recording import Recording
from tunefree_hil.figures.learning.map import MapPicture
from tunefree_hil.figures.style import save
from tunefree_hil.figures.tuning.scatter import ParameterBox
from tunefree_hil.plant import paper
from tunefree_hil.plant.learned.weights_file import PlantFile, cell_of
from tunefree_hil.tune.sampling.records import RECORDS
from tunefree_hil.tune.space import Axis, Space, resolve_space
from tunefree_hil.tune.trial import Trial

STEER = str(ROOT / "bench_configs" / "mkz_steer.toml")
COMPLETE = str(ROOT / "bench_configs" / "mkz_complete.toml")
RELATIVE_TPE = ("tpe_relative", "tpe_cma")
SPACE = Space((Axis("mrac.t_ref_s", 0.01, 0.25, True), Axis("mrac.p", 1e-4, 0.1, True)))


def trial(slot: int, score: float, t_ref_s: float = 0.05, p: float = 0.001) -> Trial:
    return Trial(slot, slot, {"mrac.t_ref_s": t_ref_s, "mrac.p": p}, score, {})


def test_there_are_eight_settings_of_both_surrogates_and_no_two_share_a_seed() -> None:
    settings = fig8.settings(3)
    assert len(settings) == 8 == len({setting.seed for setting in settings})
    assert {setting.is_gaussian for setting in settings} == {True, False}
    assert fig8.SearchSetting("mrac", fig8.SHOWN_IN_B, 200, settings[5].seed) in settings
    quick = fig8.settings(3, is_quick=True)
    assert all(one.trials < other.trials for one, other in zip(quick, settings, strict=True))
    assert len({setting.seed for setting in fig10.settings(1)}) == len(fig10.SIZES)


def test_the_spread_is_against_the_best_winner() -> None:
    results = [
        SearchResult(SearchSetting("mrac", "random", 2, 1), [trial(0, 3.0), trial(1, score)]) for score in (0.2, 0.206)
    ]
    searched = fig8.Searched(results, {}, 0.21, SPACE, [])
    assert searched.spreads_percent == pytest.approx([0.0, 3.0])


@given(st.lists(st.tuples(st.floats(0.01, 0.25), st.floats(1e-4, 0.1), st.floats(0.1, 10.0)), min_size=4, max_size=40))
def test_the_area_of_the_best_trials_is_a_share_of_the_box(rows: list[tuple[float, float, float]]) -> None:
    trials = [{"mrac.t_ref_s": x, "mrac.p": y, "score": score} for x, y, score in rows]
    assert 0.0 <= fig8.best_area_share(trials, SPACE) <= 1.0 + 1e-9


def test_the_area_counts_only_the_best_tenth_on_the_scale_of_the_box() -> None:
    corners = [{"mrac.t_ref_s": x, "mrac.p": y, "score": 1.0} for x in (0.01, 0.25) for y in (1e-4, 0.1)]
    near = [{"mrac.t_ref_s": x, "mrac.p": y, "score": 0.1} for x, y in ((0.05, 1e-3), (0.1, 1e-2))]
    assert fig8.best_area_share([*near, *corners * 4], SPACE) == pytest.approx(
        math.log(2.0) / math.log(25.0) * math.log(10.0) / math.log(1000.0)
    )
    assert fig8.best_area_share(corners[::3], SPACE) == pytest.approx(1.0)


def test_a_slower_vehicle_has_only_another_steering(tmp_path: Path) -> None:
    bench = load(STEER)
    vehicle = load_model(bench.spec.verify_model, STEER)
    slow = load_model(fig9.write_vehicle(bench, tmp_path / "slow", fig9.SteeringActuator(0.15, 0.12)))
    params = dict(vehicle.plant.params)
    assert slow.plant.params == params | {"steer_dead_time_s": 0.15, "steer_lag_s": 0.12}
    assert load_model(fig9.write_vehicle(bench, tmp_path / "same", None)).plant.params == params


@pytest.mark.parametrize(
    ("replans", "row"), [([0.0, 0.0, 0.0, 0.0], 1), ([0.0, 0.0, 1.0, 0.0], 2), ([math.nan] * 4, 1)]
)
def test_midway_is_where_the_path_is_planned_anew_else_the_largest_error(replans: list[float], row: int) -> None:
    columns = {"replan": np.array(replans), "lateral_error_m": np.array([0.1, -0.4, 0.3, math.nan])}
    driven = Driven(None, 4, "", Recording(columns, 0.01))
    assert fig9.midway_row(driven) == row


def test_percent_and_improvement_are_those_of_table_iv() -> None:
    rows = {
        OFF: {"lateral_peak": 0.5583, "lateral_rms_harsh": 0.3931},
        TUNED: {"lateral_peak": 0.22245, "lateral_rms_harsh": 0.2401},
    }
    pair = fig9.Pair("road", fig9.SteeringActuator(0.1, 0.1), {}, {}, rows, {})
    for metric, paper_pair in fig9.PAPER.items():
        assert fig9.percent_of(rows[OFF], metric) == pytest.approx(paper_pair.without)
        assert fig9.improvement_percent(pair, metric) == pytest.approx(paper_pair.improvement, abs=0.02)


def test_physics_of_a_learned_plant_are_a_folder_of_their_own(tmp_path: Path) -> None:
    learned = models.default_plant()
    models.copy_physics(learned, tmp_path / "physics")
    found = load_model(tmp_path / "physics")
    assert found.plant.kind == "physics" and not found.effects
    assert found.plant.params == learned.plant.params and found.actuators == learned.actuators


def test_the_layout_of_the_default_plant_is_read_from_its_arrays() -> None:
    layout = table1.layout_of(models.default_plant())
    assert layout.units == 8 and layout.outputs == 2 and layout.text == f"{layout.inputs}-8-2"


def test_the_activation_is_seen_in_what_the_plant_does(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    arrays = {
        "w_in": rng.normal(size=(32, 5)), "w_rec": rng.normal(size=(32, 8)), "bias": np.zeros(32),
        "w_out": rng.normal(size=(2, 8)), "b_out": np.zeros(2), "mean": np.zeros(5), "scale": np.ones(5),
        "bound": np.ones(2),
    }  # fmt: skip
    net = cell_of(PlantFile("paper", (), arrays))
    assert table1.activation_of(net) == "ReLU"
    step = paper.step_cell
    monkeypatch.setattr(paper, "step_cell", lambda net, cell, relu: step(net, cell, False))
    assert table1.activation_of(net) == "tanh"


@pytest.mark.parametrize("setup", table5.SETUPS)
def test_a_setup_is_a_bench_file_of_its_own(tmp_path: Path, setup: table5.Setup) -> None:
    path = tmp_path / "bench.toml"
    path.write_text(table5.bench_text(COMPLETE, setup, table5.Sizes(scenarios=("side_pass",))), encoding="utf-8")
    bench = load(path)
    assert list(bench.spec.scenarios) == ["side_pass"]
    assert len(resolve_space(bench.spec.tune.set, bench.spec.tune.parameters).axes) == setup.parameters


def test_the_options_of_table_iii_are_counted_from_the_samplers() -> None:
    times = [table3.SamplerTime(record, 0.1) for record in RECORDS]
    assert table3.has_all_options(times)
    assert not table3.has_all_options([entry for entry in times if entry.record.name != "gp_me"])
    assert not table3.has_all_options([entry for entry in times if entry.record.name not in RELATIVE_TPE])


@given(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-4.0, 4.0))
def test_the_outline_turns_with_the_vehicle(x_m: float, y_m: float, heading_rad: float) -> None:
    corners = outline_of(x_m, y_m, heading_rad)
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
    assert sides == pytest.approx([2.0 * SIDE_M, FRONT_M + BACK_M] * 2)
    front = corners[:2].mean(axis=0)
    assert front == pytest.approx((x_m + FRONT_M * math.cos(heading_rad), y_m + FRONT_M * math.sin(heading_rad)))


def test_the_side_pass_says_its_peaks(tmp_path: Path) -> None:
    time_s = np.linspace(0.0, 10.0, 200)
    x_m, y_m = 5.0 * time_s, np.sin(time_s)
    traces = {
        OFF: Trace(time_s, x_m, y_m, np.zeros(200), 0.6 * np.sin(time_s), 1.4),
        TUNED: Trace(time_s, x_m, y_m, np.zeros(200), 0.1 * np.sin(time_s), 1.4),
    }
    frames = [Frame("(a)", OFF, 0), Frame("(b)", OFF, 90), Frame("(c)", TUNED, 90)]
    figure = draw_side_pass(traces, frames, (x_m, y_m), (OFF, TUNED))
    assert "0.60 m without, 0.10 m with" in figure.get_suptitle() and len(figure.axes) == 4
    assert save(figure, tmp_path / "a.png").stat().st_size > 20_000


def test_six_panels_count_those_that_are_better(tmp_path: Path) -> None:
    time_s = np.linspace(0.0, 5.0, 100)
    wave = np.sin(time_s)
    panels = [ErrorPanel("Case", "speed error", "m/s", (time_s, wave), (time_s, 0.5 * wave))] * 5
    panels.append(ErrorPanel("Case", "speed error", "m/s", (time_s, wave), (time_s, 2.0 * wave)))
    figure = draw_errors(panels)
    assert "5 of 6" in figure.get_suptitle() and len(figure.axes) == 6
    assert figure.axes[5].get_title(loc="left").startswith("(f) Case")
    assert panels[0].rms_tuned == pytest.approx(0.5 * panels[0].rms_manual)


def test_winners_and_the_manual_set_are_in_both_planes() -> None:
    points = [WinnerPoint("gp_ei, 50 trials", 0.05, 0.001, 0.2, True), WinnerPoint("tpe", 0.08, 0.002, 0.21, False)]
    manual = WinnerPoint("manual", 0.09, 1e-4, 0.22, False)
    box = ParameterBox(1e-4, 0.1, True)
    figure = draw_winners(points, manual, (("t", ParameterBox(0.01, 0.26, True, "s")), ("p", box)), "Winners")
    for axes in figure.axes[:2]:
        places = {tuple(np.asarray(line.get_xydata(), dtype=float)[0]) for line in axes.lines}
        assert {(0.05, 0.001), (0.08, 0.002), (0.09, 1e-4)} <= places
    assert figure.axes[0].get_xlabel() == "t (s)"


def test_the_braking_surface_begins_at_the_pedal_at_rest(tmp_path: Path) -> None:
    command = np.array([-0.4, -0.3, -0.2, 0.0, 0.2, 0.4])
    accel = np.tile(np.array([-3.0, -2.0, -1.0, 0.0, 1.0, 2.0]), (4, 1))
    picture = MapPicture(
        np.array([1.0, 5.0]), np.array([-0.3, 0.3]), np.array([-2.0, 1.5]), np.array([0.0, 5.0, 10.0, 15.0]), command,
        accel, np.ones((4, 6)), 0.15,
    )  # fmt: skip
    figure = draw_open_loop(picture)
    low, high = figure.axes[2].get_xlim()
    assert 0.1 < low < 0.15 and 0.4 < high < 0.45
    assert "-3" in figure.get_suptitle() and save(figure, tmp_path / "a.png").stat().st_size > 20_000
