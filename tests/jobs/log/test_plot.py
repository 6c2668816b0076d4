"""log plot: names are found or corrected, values are SI, silences stay open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.episode.candump import read_candump
from tunefree_hil.figures.signals import Series, broken_at_gaps, draw_signals
from tunefree_hil.jobs.log.options import LogPlotOptions
from tunefree_hil.jobs.log.plot import collect_series, plot, resolve_signals, signal_unit

GAP = Series("a", "m/s", np.array([0.0, 0.1, 0.2, 1.2, 1.3]), np.array([1.0, 2.0, 3.0, 4.0, 5.0]), 0.3)


@pytest.fixture(scope="module")
def codec() -> Codec:
    return Codec(load_vehicle("rav4_2017"))


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Speeds of 36 and 72 km/h with a silence between them."""
    frames = [(0.024 * k, 3600 if k < 10 else 7200) for k in (*range(10), *range(50, 60))]
    lines = [f"({time_s:.6f}) can0 0B4#0000000000{raw:04X}00\n" for time_s, raw in frames]
    path = tmp_path / "a.log"
    path.write_text("".join(lines))
    return path


def test_values_are_those_of_the_frames(log: Path, codec: Codec) -> None:
    found = collect_series(read_candump(log), codec, ["report.speed_mps", "SPEED.SPEED"])
    assert found["report.speed_mps"][1] == pytest.approx([10.0] * 10 + [20.0] * 10)
    assert found["SPEED.SPEED"][1] == pytest.approx([36.0] * 10 + [72.0] * 10)
    assert found["SPEED.SPEED"][0][-1] == pytest.approx(0.024 * 59)


def test_names(codec: Codec) -> None:
    assert resolve_signals("speed_mps", codec) == ["report.speed_mps"]
    assert resolve_signals("STEER_FRACTION", codec) == ["STEER_ANGLE_SENSOR.STEER_FRACTION"]
    assert {"SPEED.CHECKSUM", "ACC_CONTROL.CHECKSUM"} < set(resolve_signals("CHECKSUM", codec)), "all that have one"
    with pytest.raises(InputError) as caught:
        resolve_signals("report.sped_mps", codec)
    assert caught.value.hint == "did you mean report.speed_mps?"


def test_units_of_fields_and_signals() -> None:
    assert signal_unit("report.yaw_rate_radps", {}) == "rad/s" and signal_unit("report.accel_mps2", {}) == "m/s²"
    assert signal_unit("SPEED.SPEED", {"SPEED.SPEED": "km/h"}) == "km/h" and signal_unit("report.gear", {}) == ""


def test_no_line_crosses_a_silence() -> None:
    times, values = broken_at_gaps(GAP)
    assert np.isnan(values[3]) and 0.2 < times[3] < 1.2 and len(values) == 6
    assert values[~np.isnan(values)].tolist() == GAP.values.tolist()


def test_a_panel_a_unit_and_shaded_silences() -> None:
    other = GAP._replace(name="b", unit="rad")
    figure = draw_signals("title", [GAP, GAP._replace(name="c"), other])
    assert [axes.get_ylabel() for axes in figure.axes] == ["m/s", "rad"]
    assert len(figure.axes[0].lines) == 2 and len(figure.axes[0].patches) == 2, "a line a signal, a shade a silence"
    assert "time (s)" in figure.axes[-1].get_xlabel()


def test_the_picture(log: Path, tmp_path: Path) -> None:
    events = list(plot(LogPlotOptions(log, ["report.speed_mps", "steer_rad"], "rav4_2017", tmp_path / "a.png")))
    assert [event.message for event in events if event.kind == "warning"] == [
        "report.steer_rad does not occur in this log"
    ]
    assert events[-1].data["values"] == {"report.speed_mps": 20, "report.steer_rad": 0}
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"


def test_nothing_to_draw(log: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="none of the signals"):
        list(plot(LogPlotOptions(log, ["steer_rad"], "rav4_2017", tmp_path / "a.png")))
    assert not (tmp_path / "a.png").exists()
