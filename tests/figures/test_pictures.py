"""Each figure: it says what it shows, marks what it must, and leaves out what was not recorded."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tunefree_hil.figures import bars, jitter, scenario, style
from tunefree_hil.figures.tuning import history, scatter
from tunefree_hil.grade.score import FINISHED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LINES = {"manual, MRAC on": 0.48, "as shipped": 0.61, "rule-based": 0.55}
SCORES = {
    "manual, MRAC on": {"left_turn": 0.5, "u_turn": 10.0, "side_pass": 0.61},
    "tuned": {"left_turn": 0.3, "u_turn": 0.4, "side_pass": 0.7},
}


def drive(label: str, peak_m: float, rows: int = 400, replan: int = -1, outcome: str = "") -> scenario.DrivePicture:
    t = np.arange(rows) * 0.01
    error = peak_m * np.sin(t)
    columns = {
        "t_s": t,
        "ref_x_m": 5.0 * t,
        "ref_y_m": 0.2 * t * t,
        "x_m": 5.0 * t,
        "y_m": 0.2 * t * t + error,
        "lateral_error_m": error,
        "heading_error_rad": 0.1 * np.cos(t),
        "speed_mps": 5.0 + error,
        "ref_speed_mps": np.full(rows, 5.0),
        "out_steer_rad": np.sin(t),
        "replan": (np.arange(rows) == replan).astype(float),
    }
    return scenario.DrivePicture(label, columns, 0.5, outcome)


DRIVES = (drive("manual", 0.6, replan=130, outcome="left the lane", rows=300), drive("tuned", 0.12))


def points(dimensions: int, trials: int = 40) -> scatter.TrialPoints:
    chance = np.random.default_rng(dimensions)
    names = [f"group.p{i}_s" for i in range(dimensions)]
    values = {name: np.exp(chance.uniform(np.log(0.01), 0.0, trials)) for name in names}
    scores = 0.3 + sum((i + 1) * (np.log10(values[name]) + 1.0) ** 2 for i, name in enumerate(names))
    boxes = {name: scatter.ParameterBox(0.01, 1.0, True, "s") for name in names}
    return scatter.TrialPoints(values, list(scores), boxes, {name: 0.0 for name in names})  # type: ignore[arg-type]


DRAWN: dict[str, Callable[[], Figure]] = {
    "scenario": lambda: scenario.draw_scenario("side_pass", DRIVES),
    "history": lambda: history.draw_history([0.48, 2.0, 10.0, 0.4, 0.3], LINES),
    "one": lambda: scatter.draw_scatter(points(1)),
    "two": lambda: scatter.draw_scatter(points(2)),
    "eleven": lambda: scatter.draw_scatter(points(11)),
    "jitter": lambda: jitter.draw_jitter({"ecu": [1e-4, 2e-4, 3e-3], "controller": [3e-4] * 5}, 2e-3),
    "bars": lambda: bars.draw_bars(SCORES),
}


def texts(figure: Figure) -> Iterator[Any]:
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip():
            yield text


def title(figure: Figure) -> str:
    return figure.get_suptitle()


@pytest.mark.parametrize("name", DRAWN)
def test_a_picture_is_labelled_readable_and_whole(name: str) -> None:
    figure = DRAWN[name]()
    figure.canvas.draw()
    assert len(title(figure)) > 15
    width, height = figure.bbox.width, figure.bbox.height
    words = list(texts(figure))
    assert len(words) > 8
    for text in words:
        shown_px = text.get_fontsize() / 72.0 * figure.dpi * min(1.0, 1400.0 / width)
        assert shown_px >= 14.0, text.get_text()  # 7 pixels and more at half size
    for text in [figure._suptitle, *(axes.xaxis.label for axes in figure.axes)]:  # type: ignore[attr-defined]
        box = text.get_window_extent()
        assert box.x0 >= -1 and box.y0 >= -1 and box.x1 <= width + 1 and box.y1 <= height + 1, text.get_text()


@pytest.mark.parametrize("name", DRAWN)
def test_the_same_data_give_the_same_bytes(name: str, tmp_path: Path) -> None:
    files = [style.save(DRAWN[name](), tmp_path / f"{i}.png").read_bytes() for i in range(2)]
    assert files[0] == files[1]


def test_files_are_png_of_the_size_that_was_asked(tmp_path: Path) -> None:
    written = [
        style.save(scenario.draw_scenario("side_pass", DRIVES), tmp_path / "a.png"),
        style.save(history.draw_history([0.5, 0.4], LINES), tmp_path / "b.png"),
        style.save(scatter.draw_scatter(points(2)), tmp_path / "c.png"),
        style.save(jitter.draw_jitter({"ecu": [1e-4]}, 2e-3), tmp_path / "d.png"),
        style.save(bars.draw_bars(SCORES), tmp_path / "e.png"),
    ]
    assert sorted(path.name for path in tmp_path.iterdir()) == [path.name for path in written]
    for path in written:
        data = path.read_bytes()
        width, height = struct.unpack(">II", data[16:24])
        assert data[:8] == b"\x89PNG\r\n\x1a\n" and width > 900 and height > 400


def marks(axes: Axes, marker: str) -> list[tuple[float, float]]:
    found = [np.asarray(one.get_xydata()) for one in axes.get_lines() if one.get_marker() == marker]
    return [(float(x), float(y)) for one in found for x, y in one]


def test_only_a_drive_that_did_not_come_to_its_end_ended_early() -> None:
    ends = [scenario.DrivePicture("car", {}, outcome=outcome).early_end for outcome in ("", FINISHED, "left_lane")]
    assert ends == ["", "", "left_lane"]


def test_replans_and_early_ends_are_marked_on_every_panel() -> None:
    figure = scenario.draw_scenario("side_pass", DRIVES)
    path, *panels = figure.axes
    assert title(figure) == "side_pass: peak lateral error 0.60 m (manual, 1 re-plan), 0.12 m (tuned)"
    columns = DRIVES[0].columns
    assert marks(path, "v") == [(columns["x_m"][130], columns["y_m"][130])]
    assert marks(path, "X") == [(columns["x_m"][299], columns["y_m"][299])]
    for axes, panel in zip(panels, scenario.PANELS, strict=True):
        value = pytest.approx(float(columns[panel.column][130]) * panel.factor)
        assert marks(axes, "v") == [(pytest.approx(1.30), value)]
        assert marks(axes, "X")[0][0] == pytest.approx(2.99)
    assert [axes.get_ylabel().split("(")[1] for axes in panels] == ["m)", "°)", "km/h)", "°)"]
    assert "manual: left the lane" in [text.get_text() for text in texts(figure)]


def test_what_was_not_recorded_is_said_not_drawn() -> None:
    bare = {name: DRIVES[1].columns[name] for name in ("t_s", "lateral_error_m")}
    bare["speed_mps"] = np.full(400, np.nan)
    drives = [scenario.DrivePicture("car", bare), scenario.DrivePicture("empty", {"t_s": []})]
    figure = scenario.draw_scenario("log", drives)
    said = [text.get_text() for text in texts(figure) if "not recorded" in text.get_text()]
    assert len(said) == 5  # path, heading, speed, steering, and the title for the second drive
    assert not any("0.00" in text for text in said)


def test_a_slender_path_is_stretched_and_says_so() -> None:
    assert "drawn larger than x" in scenario.draw_scenario("a", [drive("tuned", 0.1, rows=2000)._replace(
        columns={"t_s": [0.0, 1.0], "x_m": [0.0, 100.0], "y_m": [0.0, 3.0]})]).axes[0].get_ylabel()  # fmt: skip
    square = scenario.draw_scenario(
        "b", [scenario.DrivePicture("tuned", {"t_s": [0, 1, 2], "x_m": [0, 20, 0], "y_m": [0, 9, 20]})]
    ).axes[0]
    assert square.get_ylabel() == "y (m)" and square.get_aspect() == 1.0


def test_history_shows_the_best_so_far_against_the_best_baseline() -> None:
    figure = DRAWN["history"]()
    axes = figure.axes[0]
    assert title(figure) == "Best of 5 trials: 0.3, 38 % below the best baseline (manual, MRAC on)"
    steps = {line.get_label(): np.asarray(line.get_ydata()) for line in axes.get_lines()}
    assert list(steps["best so far"]) == [0.48, 0.48, 0.48, 0.4, 0.3]
    assert marks(axes, "*") == [(5.0, 0.3)]
    assert all(steps[f"{name}: {style.number(score)}"][0] == score for name, score in LINES.items())
    worse = history.draw_history([0.6], {"manual": 0.5})
    assert "20 % above" in title(worse)
    assert history.draw_history([0.0, 1.0], {}).axes[0].get_yscale() == "linear"


def test_scatter_marks_best_and_manual_where_they_are() -> None:
    data = points(2)._replace(manual={"group.p0_s": 0.0, "group.p1_s": 0.5})
    axes = scatter.draw_scatter(data).axes[0]
    best = int(np.argmin(data.scores))
    assert marks(axes, "*") == [tuple(float(data.parameters[name][best]) for name in data.parameters)]
    assert marks(axes, "D") == [(0.01, 0.5)]  # outside the box: on its edge
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert axes.get_xlabel() == "group.p0_s (s)"
    shown = np.asarray(axes.collections[0].get_offsets())
    assert len(shown) == 40
    assert tuple(shown[-1]) == marks(axes, "*")[0]  # the best is drawn last, on top


def test_many_parameters_show_the_three_that_matter_and_all_in_parallel() -> None:
    data = points(11, trials=400)
    figure = scatter.draw_scatter(data)
    *planes, parallel, _ = figure.axes
    shown = {axes.get_xlabel() for axes in planes} | {axes.get_ylabel() for axes in planes}
    assert shown == {f"{name} (s)" for name in scatter.rank_parameters(data)[:3]}
    assert shown <= {f"group.p{i}_s (s)" for i in range(6, 11)}  # the heavier half of the bowl
    assert len(parallel.get_xticklabels()) == 11
    assert len(parallel.get_lines()) == 400 + 2


def test_weight_sees_slopes_and_valleys_but_not_noise() -> None:
    chance = np.random.default_rng(2)
    values, noise = chance.uniform(-1.0, 1.0, 300), chance.normal(size=300)
    scores = (values + 0.3 * noise, values**2 + 0.1 * noise)
    slope, valley = (scatter.variance_share(values, list(score)) for score in scores)
    assert slope > 0.6 and valley > 0.4
    assert scatter.variance_share(values, list(noise)) < 0.06
    assert scatter.variance_share(values, [1.0] * 300) >= 0.0


def test_jitter_counts_what_was_late() -> None:
    figure = DRAWN["jitter"]()
    assert title(figure) == "1 of 8 ticks later than 2 ms"
    (labels,) = [[text.get_text() for text in legend.get_texts()] for legend in figure.legends]
    assert any(label.startswith("ecu: median 0.2") and "worst 3 ms" in label for label in labels)
    assert title(jitter.draw_jitter({}, 2e-3)) == "No tick was timed"


def test_bars_cut_failures_and_say_so() -> None:
    figure = bars.draw_bars(SCORES)
    axes = figure.axes[0]
    assert title(figure) == "Tuned is better in 2 of 3 scenarios (median ratio 0.60)"
    lengths = sorted(bar.get_width() for bar in axes.patches)  # type: ignore[attr-defined]
    assert lengths == pytest.approx([0.3, 0.4, 0.5, 0.61, 0.7, 1.02 * 0.7])
    assert [text.get_text() for text in texts(figure) if "failed" in text.get_text()] == [" 10 ▸ failed"]
    assert axes.get_ylim()[0] > axes.get_ylim()[1]  # the first scenario is on top


def test_bars_of_nothing_but_failures() -> None:
    figure = bars.draw_bars({"manual": {"a": 10.0}, "as shipped": {"b": 10.0}})
    assert title(figure) == "Score of each scenario"
    assert [bar.get_width() for bar in figure.axes[0].patches] == [10.0, 10.0]  # type: ignore[attr-defined]
