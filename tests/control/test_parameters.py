"""The parameter table, binary32 boxes, baselines."""

from __future__ import annotations

import math
import re
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.house import ROOT
from tunefree_hil.base.contracts import Tunable
from tunefree_hil.base.errors import InputError
from tunefree_hil.control import parameters as par

PAGE = ROOT / "docs" / "reference" / "controller.md"


def test_table_is_that_of_interfaces_7():
    assert [row.index for row in par.PARAMETERS] == list(range(16))
    assert par.NAMES == (
        "mrac.t_ref_s", "mrac.p", "lqr.q1", "lqr.q2", "lqr.q3", "lqr.q4", "station.kp", "speed.kp_low", "speed.ki_low",
        "speed.kp_high", "speed.ki_high", "mrac.enable", "riccati", "mrac.clamp_s", "mrac.gamma", "look_ahead_m",
    )  # fmt: skip
    boxes = [(row.tunable.low, row.tunable.high) for row in par.PARAMETERS[:11]]
    assert boxes == [
        (0.01, 0.26), (1e-4, 0.1), (0.01, 1), (0.001, 0.1), (0.01, 1), (0.001, 0.1), (0.01, 1), (0.1, 10), (0.01, 1),
        (0.1, 10), (0.01, 1),
    ]  # fmt: skip
    assert all(row.tunable.scale == "log" for row in par.PARAMETERS[:11])
    assert {name: len(names) for name, names in par.SETS.items()} == {"mrac": 2, "lateral": 6, "complete": 11}


def test_the_page_lists_the_table():
    rows = re.findall(
        r"^\| `([\w.]+)` \| (\S+) \| ([\d.]+?)(?:\.\.| or )(\S+) \| (\S+) \|", PAGE.read_text().split("## MPC")[0], re.M
    )
    table = [(*row.tunable[:2], *map(float, (row.tunable.low, row.tunable.high, row.manual))) for row in par.PARAMETERS]
    assert [(name, unit, *map(float, more)) for name, unit, *more in rows] == table


@given(st.floats(-1e30, 1e30))
def test_round32_is_what_a_frame_carries(value):
    assert par.round32(value) == struct.unpack("<f", struct.pack("<f", value))[0]
    assert par.round32(par.round32(value)) == par.round32(value)


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.floats(0.0, 1.0))
def test_rounding_a_point_never_leaves_the_box(low, width, share):
    high = low + width
    if high - low < 1e-6 * max(abs(low), abs(high)):
        return
    inner_low, inner_high = par.box32(low, high)
    assert low <= inner_low <= inner_high <= high
    assert par.round32(inner_low) == inner_low and par.round32(inner_high) == inner_high
    point = par.round32(inner_low + share * (inner_high - inner_low))
    assert inner_low <= point <= inner_high


def test_box32_takes_the_next_number_inward():
    low, high = par.box32(0.01, 0.26)
    assert low >= 0.01 and high <= 0.26
    assert math.nextafter(low, 0.0) < low  # a real step
    assert low - 0.01 < 1e-9 and 0.26 - high < 3e-8
    assert par.box32(0.0, 1.0) == (0.0, 1.0)
    assert par.box32(-0.3, -0.1)[0] >= -0.3
    assert par.box32(1e-50, 1.0)[0] > 0.0
    with pytest.raises(InputError, match="binary32"):
        par.box32(0.1, 0.1)


def test_baselines():
    assert set(par.BASELINES) == {"as_shipped", "mrac_on", "as_shipped_look_ahead", "mrac_on_look_ahead"}
    for values in par.BASELINES.values():
        assert par.check_complete(values) == values
        assert values["mrac.p"] * values["mrac.gamma"] == pytest.approx(1e-4)
        assert values["mrac.clamp_s"] == 0.08
        assert values["lqr.q2"] == values["lqr.q4"] == 0.0
    assert par.BASELINES["as_shipped"]["mrac.enable"] == 0.0
    assert par.BASELINES["mrac_on_look_ahead"]["look_ahead_m"] == 1.4224


def test_study_values():
    values = par.study_values()
    assert (values["mrac.enable"], values["mrac.clamp_s"], values["mrac.gamma"]) == (1.0, 0.01, 1.0)
    assert par.check_complete(values) == values


def test_incomplete_and_unknown_are_named():
    with pytest.raises(InputError, match=r"missing: mrac\.p; unknown: mrac\.q"):
        par.check_complete({**{k: v for k, v in par.study_values().items() if k != "mrac.p"}, "mrac.q": 1.0})
    with pytest.raises(InputError, match="not a number"):
        par.check_complete({**par.study_values(), "mrac.p": math.nan})
    assert par.check_complete({**par.study_values(), "mine.gain": 2.0}, ("mine.gain",))["mine.gain"] == 2.0


def test_by_index():
    values = par.by_index({0: 0.09, 11: 1.0, 16: 3.0})
    assert values == {"mrac.t_ref_s": 0.09, "mrac.enable": 1.0}
    assert par.by_index({0: 0.09, 16: 3.0, 17: 4.0}, ("mine.gain",)) == {"mrac.t_ref_s": 0.09, "mine.gain": 3.0}


def test_every_parameter_has_an_index_of_its_own():
    found = par.indices_of(("mine.gain", "mine.lag_s"))
    assert found == {**{row.tunable.name: row.index for row in par.PARAMETERS}, "mine.gain": 16, "mine.lag_s": 17}


def test_the_middle_of_a_box():
    assert par.middle_of(Tunable("a", "1", 0.1, 10.0)) == pytest.approx(1.0)
    assert par.middle_of(Tunable("a", "1", 0.0, 3.0, "linear")) == 1.5
    assert par.middle_of(Tunable("a", "1", 0.0, 1.0, "linear", choices=(1.0, 0.0))) == 1.0
