"""MRAC over actuators: the drift that it meets, what adaptation is compared with, and the sentence about it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.house import ROOT
from tools.measures import _steering_drift, mrac
from tools.measures._drift import read_gains
from tools.measures._mrac_cells import ALONE, DRIFTS, FIXED, LAWS, OFF, PLAIN, ROBUST, TUNED, Cell, work_cell
from tools.measures.figures.adaptation import draw_adaptation
from tunefree_hil.base.contracts import make_effect
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load
from tunefree_hil.control.build import PartNames, load_parts, own_values
from tunefree_hil.control.inner import mrac as plain_law
from tunefree_hil.control.inner import mrac_robust as robust_law
from tunefree_hil.tune.space import resolve_space

STEER = str(ROOT / "bench_configs" / "mkz_steer.toml")
DT_S = 0.01
OVER_S = 2.0


def drifted(inputs: Any, **params: float) -> np.ndarray:
    block = make_effect(_steering_drift.EFFECT, {"over_s": OVER_S, **params})
    state, outputs = block.init(block.params, DT_S), []
    for x in inputs:
        state, y = block.step(block.params, state, float(x), DT_S)
        outputs.append(y)
    return np.array(outputs)


def test_without_a_change_the_drift_is_the_identity() -> None:
    inputs = np.random.default_rng(1).normal(size=300)
    assert np.array_equal(drifted(inputs), inputs)


def test_a_gain_drifts_to_its_end_and_stays_there() -> None:
    found = drifted(np.ones(500), gain_change=-0.2)
    assert found[0] == 1.0 and found[100] == pytest.approx(0.9) and found[-1] == pytest.approx(0.8)


@pytest.mark.parametrize("delay_s", [0.05, 0.055])
def test_a_dead_time_grows_to_its_end(delay_s: float) -> None:
    ramp = np.arange(600) * DT_S
    late_s = ramp - drifted(ramp, delay_s=delay_s)
    assert late_s[110] == pytest.approx(0.55 * delay_s, abs=1e-9)
    assert late_s[-1] == pytest.approx(delay_s, abs=1e-9)


def test_a_lag_grows_to_its_end() -> None:
    step = np.where(np.arange(1000) < 500, 0.0, 1.0)  # after the drift
    found = drifted(step, lag_s=0.1)
    assert found[499] == 0.0 and found[509] == pytest.approx(1.0 - math.exp(-1.0), rel=1e-6)
    early = drifted(np.where(np.arange(100) < 20, 0.0, 1.0), lag_s=0.1)
    assert early[29] > 0.9, "hardly any lag at the start"


@pytest.mark.parametrize("wrong", [{"delay_s": -0.1}, {"lag_s": math.nan}, {"over_s": 0.0}])
def test_a_drift_that_is_none_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError) as refused:
        drifted([0.0], **wrong)
    assert refused.value.key in wrong


def test_p_stays_in_the_published_box_and_both_laws_have_it() -> None:
    axes = {axis.name: (axis.low, axis.high) for axis in resolve_space("mrac", []).axes}
    assert axes["mrac.p"] == pytest.approx((1e-4, 0.1))
    for law in LAWS:
        assert "mrac.p" in {tunable.name for tunable in load_parts(PartNames(inner=law))[2].tunables}
    assert own_values(PartNames(inner=ROBUST)) and not own_values(PartNames(inner=PLAIN))


def row(tuned: float, alone: float) -> dict[str, Any]:
    peaks = {OFF: 0.4, FIXED: 0.3, ALONE: alone, TUNED: tuned}
    return {
        label: {"lateral_peak": peak, "lateral_rms_harsh": peak, "score": peak, "outcome": "finished"}
        for label, peak in peaks.items()
    }


def cells(tuned: dict[str, list[float]]) -> list[dict[str, Any]]:
    """Three actuators; p = 0 with its own T_ref reaches 0.2."""
    return [
        {"dead_time_s": 0.1, "lag_s": 0.1 + i, "law": law, "drifts": {name: row(tuned[law][i], 0.2) for name in DRIFTS}}
        for law in LAWS
        for i in range(3)
    ]


def test_adaptation_is_judged_against_a_reference_model_that_was_searched_as_long() -> None:
    found = mrac.compare_adaptation(cells({PLAIN: [0.25, 0.2, 0.1], ROBUST: [0.1, 0.15, 0.3]}))
    plain, robust = found[PLAIN]["lag"], found[ROBUST]["lag"]
    assert plain["tuned_of_p0_tuned"] == pytest.approx([0.5, 1.0, 1.25]) and plain["lower_peak"] == 1
    assert plain["tuned_of_p0"][1] == pytest.approx(2.0 / 3.0), "it is below p = 0 at the T_ref of the search with p"
    assert (plain["adds"], robust["adds"]) == (False, True)
    assert robust["tuned_of_off"] == pytest.approx([0.25, 0.375, 0.75])
    words = mrac.adaptation_verdict(found)
    assert words.startswith(f"{PLAIN}: adaptation adds nothing over p = 0 with: constant, dead time, lag, gain.")
    assert words.endswith(f"{ROBUST}: adaptation lowers the peak with: constant, dead time, lag, gain")


def test_less_than_the_least_gain_is_nothing() -> None:
    found = mrac.compare_adaptation(cells({PLAIN: [0.197] * 3, ROBUST: [0.195] * 3}))
    assert (found[PLAIN]["gain"]["adds"], found[ROBUST]["gain"]["adds"]) == (False, True)


def test_the_gains_of_both_laws_are_read() -> None:
    robust = robust_law.MracRobustState(0.0, 0.25, 0.75, 0.0, (), (), (), 0, 0.0)
    assert read_gains(robust) == (0.25, 0.75)
    assert "gains" in plain_law.MracState._fields


def test_the_picture_has_a_dot_for_each_actuator() -> None:
    figure = draw_adaptation({"plain, lag": [1.2, 1.0, 1.4], "robust, lag": [0.5, 0.8, 0.6]})
    assert figure.get_suptitle() == "Lateral peak with adaptation over that without, median: plain 1.20, robust 0.60"
    dots = [line for line in figure.axes[0].lines if line.get_marker() not in ("None", "", None)]
    assert [len(np.asarray(line.get_xdata())) for line in dots] == [3, 3]


@pytest.mark.compiled
@pytest.mark.parametrize("law", LAWS)
def test_a_cell_is_tuned_once(tmp_path: Path, law: str) -> None:
    job = Cell(STEER, str(tmp_path), 0.10, 0.17, 2, 1, law, ("constant", "gain"))
    first = work_cell(job)
    assert list(first["drifts"]) == ["constant", "gain"]
    for found in first["drifts"].values():
        assert found[TUNED] != found[FIXED], "p acts"
        assert found[TUNED] != found[OFF], "and so does the reference model"
    assert first["drifts"]["gain"][OFF] != first["drifts"]["constant"][OFF]
    assert work_cell(job) == first
    assert len(next(tmp_path.glob("*.jsonl")).read_text().splitlines()) == 1
    assert load(STEER).spec.controller.inner == PLAIN
